"""The UDP socket to the devices.

By default bacpypes3 sends a request again three times, each after three seconds, and reports silence as an abort of the peer. Here its
retries are 0, and :func:`~..core.repeat_once` decides: a question is sent a second time, with a new invoke id, a write is sent once and waited
for as long. bacpypes3 forgets an answer whose data it cannot decode (0.0.110: its error has no invoke id), hands over answers about another
object, and as a ``NormalApplication`` lets anybody write to its own objects: :class:`_Client` has no objects to offer.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable
from typing import Any

from bacpypes3.apdu import (
    APDU,
    AbortPDU,
    ConfirmedRequestPDU,
    ErrorPDU,
    IAmRequest,
    RejectPDU,
    WhoIsRequest,
)
from bacpypes3.app import Application
from bacpypes3.appservice import ABORTED, ApplicationServiceAccessPoint
from bacpypes3.comm import bind
from bacpypes3.ipv4.link import NormalLinkLayer
from bacpypes3.local.device import DeviceObject
from bacpypes3.netservice import NetworkServiceAccessPoint, NetworkServiceElement
from bacpypes3.pdu import Address, IPv4Address

from ..core import AdapterError, Call, Lost, repeat_once, resolve
from .refusals import refusal

__all__ = ["Link"]

# It logs each datagram that it cannot decode with a traceback: whoever may send datagrams could fill a disk.
logging.getLogger("bacpypes3").setLevel(logging.CRITICAL)

_TRANSMISSIONS = 2
"""How often a question is sent; a write is sent once, and waited for as long."""
_OWN_INSTANCE = 4194302
_VENDOR = 999
_FORGETTING_MS = 10_000
"""Milliseconds after which the library would give a request up, which is given up here before."""


class _Unreadable(Exception):
    """The data of an answer cannot be decoded."""


class _Client(Application):  # type: ignore[misc]  # the library is not typed
    """An application that asks and offers nothing: requests of others are refused as services that it does not have."""

    def __init__(self, local: IPv4Address, heard: Callable[[IAmRequest], None]) -> None:
        super().__init__()
        own = DeviceObject(
            objectIdentifier=("device", _OWN_INSTANCE), objectName="otmcp-adapter", vendorIdentifier=_VENDOR
        )
        own.numberOfApduRetries = 0
        own.apduTimeout = _FORGETTING_MS
        self._heard = heard
        self.waiting: dict[asyncio.Future[Any], Address] = {}
        self.asap = ApplicationServiceAccessPoint(own, self.device_info_cache)
        self.nsap = NetworkServiceAccessPoint()
        self.nse = NetworkServiceElement()
        bind(self.nse, self.nsap)
        bind(self, self.asap, self.nsap)
        self.link = NormalLinkLayer(local)
        self.nsap.bind(self.link, address=local)

    async def do_IAmRequest(self, apdu: IAmRequest) -> None:
        """Take an I-Am; the library calls the method of this name."""
        self._heard(apdu)

    async def confirmation(self, apdu: APDU) -> None:
        """Take an answer. What stands for an undecodable one has no invoke id: it is the only one that is waited for, or unknown."""
        if apdu.apduInvokeID is not None:
            await super().confirmation(apdu)
            return
        concerned = [one for one, asked in self.waiting.items() if asked == apdu.pduSource and not one.done()]
        if len(concerned) == 1:
            concerned[0].set_exception(_Unreadable())

    def forget(self, request: ConfirmedRequestPDU) -> None:
        """Give a request up, also where the library keeps it: when its time was over there, it would end the next one with its invoke id."""
        for transaction in list(self.asap.clientTransactions):
            if (transaction.invokeID, transaction.pdu_address) == (request.apduInvokeID, request.pduDestination):
                transaction.set_state(ABORTED)


class Link:
    """One UDP socket for all devices.

    Args:
        host, port: where devices are asked who they are.
        timeout_s: seconds to wait for an answer, over all transmissions of the request.
    """

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self._host = host
        self._port = port
        self._timeout_s = timeout_s
        self._opening = asyncio.Lock()
        self._client: _Client | None = None
        self._target: Address | None = None
        self._addresses: dict[int, Address] = {}
        self._listeners: list[Callable[[IAmRequest], None]] = []
        self._generation = 0
        self._answers = False

    # -- requests ---------------------------------------------------------------------------------------------

    async def ask(self, call: Call, device: int | None, make: Callable[[Address], ConfirmedRequestPDU]) -> Any:
        """Ask a device something that changes nothing, and return its answer; silence is asked a second time.

        Args:
            device: instance of the device object; None for the configured address, whichever device is there.
            make: makes a request to an address; each transmission has a request, and an invoke id, of its own.

        Raises:
            AdapterError: silence, a refusal, or an answer that cannot be read.
        """
        return await self._exchange(call, device, make, changes_state=False)

    async def command(self, call: Call, device: int, make: Callable[[Address], ConfirmedRequestPDU]) -> Any:
        """Send a write, once, and return its acknowledgement.

        Raises:
            AdapterError: see :meth:`ask`; after silence only the device knows whether it was executed.
        """
        return await self._exchange(call, device, make, changes_state=True)

    async def _exchange(
        self,
        call: Call,
        device: int | None,
        make: Callable[[Address], ConfirmedRequestPDU],
        *,
        changes_state: bool,
    ) -> Any:
        client, target = await self._opened()
        address = target if device is None else await self._address_of(call, device)
        self._using(call)
        silence = AdapterError("timeout", f"the device did not answer within {self._timeout_s:g} s")

        async def transmission() -> Any:
            request = make(address)
            call.sending(changes_state=changes_state)
            pending = client.request(request)
            client.waiting[pending] = address
            call.trace.setdefault("invoke_ids", []).append(request.apduInvokeID)
            try:
                async with asyncio.timeout(self._timeout_s if changes_state else self._timeout_s / _TRANSMISSIONS):
                    return await pending
            except TimeoutError:
                raise Lost(silence) from None
            finally:
                del client.waiting[pending]
                client.forget(request)

        try:
            answer = await repeat_once(call, transmission)
        except AdapterError as error:
            if error is silence:
                if device is not None:
                    # It may have moved: the next call asks again where it is.
                    self._addresses.pop(device, None)
                self._silent(call)
            raise
        except (ErrorPDU, RejectPDU, AbortPDU) as error:
            self._answered(call)
            raise refusal(call, error) from None
        except _Unreadable:
            self._answered(call)
            raise AdapterError("protocol_error", "what the device answered cannot be read") from None
        self._answered(call)
        return answer

    # -- finding devices --------------------------------------------------------------------------------------

    async def discover(self, call: Call, seconds: float) -> list[IAmRequest]:
        """Ask all devices at the configured address who they are, and return what they say within this time."""
        found: dict[int, IAmRequest] = {}

        def heard(apdu: IAmRequest) -> None:
            found[apdu.iAmDeviceIdentifier[1]] = apdu

        await self._who_is(call, heard, lambda: asyncio.sleep(seconds))
        if found:
            self._answered(call)
        return [found[instance] for instance in sorted(found)]

    async def _address_of(self, call: Call, device: int) -> Address:
        if device in self._addresses:
            return self._addresses[device]
        found: asyncio.Future[Address] = asyncio.get_running_loop().create_future()

        def heard(apdu: IAmRequest) -> None:
            if apdu.iAmDeviceIdentifier[1] == device and not found.done():
                found.set_result(apdu.pduSource)

        for _ in range(_TRANSMISSIONS):
            try:
                async with asyncio.timeout(self._timeout_s / _TRANSMISSIONS):
                    await self._who_is(call, heard, lambda: asyncio.shield(found), device)
                break
            except TimeoutError:
                continue
        if not found.done():
            self._silent(call)
            raise AdapterError("timeout", f"no device {device} answered a Who-Is within {self._timeout_s:g} s")
        self._answered(call)
        return self._addresses.setdefault(device, found.result())

    async def _who_is(
        self,
        call: Call,
        heard: Callable[[IAmRequest], None],
        wait: Callable[[], Awaitable[Any]],
        device: int | None = None,
    ) -> None:
        client, target = await self._opened()
        self._using(call)
        request = WhoIsRequest(destination=target)
        if device is not None:
            request.deviceInstanceRangeLowLimit = request.deviceInstanceRangeHighLimit = device
        self._listeners.append(heard)
        try:
            call.sending(changes_state=False)
            client.request(request)
            await wait()
        finally:
            self._listeners.remove(heard)

    def _heard(self, apdu: IAmRequest) -> None:
        for listener in list(self._listeners):
            listener(apdu)

    # -- the socket -------------------------------------------------------------------------------------------

    def _using(self, call: Call) -> None:
        # A later request of the same call does not take back that the first one found the device again.
        if not call.attempts:
            call.connection(generation=self._generation + (not self._answers), fresh=not self._answers)

    def _answered(self, call: Call) -> None:
        if not self._answers:
            self._answers = True
            self._generation += 1
        call.answered()

    def _silent(self, call: Call) -> None:
        self._answers = False
        call.disconnected()

    async def _opened(self) -> tuple[_Client, Address]:
        async with self._opening:
            if self._client is None or self._target is None:
                host = await resolve(self._host, self._port, socket.SOCK_DGRAM)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    # The system says from which of its addresses the device can be reached; nothing is sent.
                    probe.connect((host, self._port))
                    own = probe.getsockname()[0]
                self._target = IPv4Address(f"{host}:{self._port}")
                self._client = _Client(IPv4Address(f"{own}:0"), self._heard)
            return self._client, self._target

    async def close(self) -> None:
        """Close the socket."""
        if self._client is not None:
            self._client.link.close()
