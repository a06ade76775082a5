"""The sockets: one for frames of an interface, one for remote procedure calls. Neither has a connection.

A question that is not answered is sent a second time, and is the same question then; a write is sent once, and waited for as long.
"""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from ..core import AdapterError, BadReply, Call, Lost, repeat_once
from .refusals import refusal
from .wire import ETHERTYPE, Answer, Discovered, Request, acknowledged, dcp, dcp_answer, rpc_answer

__all__ = ["PORT", "Network", "Station"]

PORT = 34964
"""UDP port of devices, and of controllers while they have relations with cyclic data."""
_TRANSMISSIONS = 2
_CYCLIC = range(0x80, 0xFC)
"""First bytes of identifiers of cyclic frames."""
_MOST = 65536

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Station:
    """A station that has identified itself."""

    mac: bytes
    name: bytes
    ip: str
    vendor: int
    device: int
    maker: bytes


class Network:
    """The network at one interface.

    Args:
        interface: its name.
        timeout_s: seconds to wait for an answer, over all transmissions of a request.

    Attributes:
        cyclic: takes the source and the payload of cyclic frames.
        ready: takes a request of a device, and returns the blocks of the answer; None for no answer.
    """

    def __init__(self, interface: str, timeout_s: float) -> None:
        self.interface = interface
        self.timeout_s = timeout_s
        self.cyclic: Callable[[bytes, bytes], None] = lambda source, payload: None
        self.ready: Callable[[Answer], bytes | None] = lambda asked: None
        self.mac = b""
        self._frames: socket.socket | None = None
        self._calls: socket.socket | None = None
        self._port: socket.socket | None = None
        self._xid = 0
        self._discovering: dict[int, Callable[[Discovered], None]] = {}
        self._calling: dict[bytes, tuple[str, asyncio.Future[Answer]]] = {}
        self._generation = 0
        self._answers = False

    # -- DCP --------------------------------------------------------------------------------------------------

    async def discover(
        self, call: Call, options: tuple[tuple[int, int], bytes], service: int, to: bytes, wait_s: float
    ) -> list[Discovered]:
        """Ask stations, and return what comes within this time."""
        found: list[Discovered] = []
        await self._ask(call, (options,), service, to, found.append, lambda: asyncio.sleep(wait_s), changes_state=False)
        if found:
            self._answered(call)
        return found

    async def ask(
        self,
        call: Call,
        to: bytes,
        service: int,
        *options: tuple[tuple[int, int], bytes],
        changes_state: bool = False,
    ) -> Discovered:
        """Ask stations, and return the first answer.

        Raises:
            AdapterError: none came.
        """
        transmissions = 1 if changes_state else _TRANSMISSIONS
        heard: asyncio.Future[Discovered] = asyncio.get_running_loop().create_future()

        def take(found: Discovered) -> None:
            if not heard.done():
                heard.set_result(found)

        async def transmission() -> Discovered:
            try:
                async with asyncio.timeout(self.timeout_s / transmissions):
                    await self._ask(
                        call, options, service, to, take, lambda: asyncio.shield(heard), changes_state=changes_state
                    )
            except TimeoutError:
                raise Lost(self._silence()) from None
            return heard.result()

        return await self._performed(call, transmission)

    async def _ask(
        self,
        call: Call,
        options: tuple[tuple[tuple[int, int], bytes], ...],
        service: int,
        to: bytes,
        take: Callable[[Discovered], None],
        wait: Callable[[], Awaitable[Any]],
        *,
        changes_state: bool,
    ) -> None:
        self._open(call)
        self._xid = (self._xid + 1) & 0xFFFFFFFF
        xid = self._xid
        self._discovering[xid] = take
        try:
            call.sending(changes_state=changes_state)
            self.send(to, dcp(service, xid, *options))
            await wait()
        finally:
            del self._discovering[xid]

    def send(self, to: bytes, payload: bytes) -> None:
        """Send a frame.

        Raises:
            AdapterError: it cannot be sent.
        """
        assert self._frames is not None
        frame = to + self.mac + ETHERTYPE.to_bytes(2) + payload
        try:
            self._frames.send(frame.ljust(60, b"\0"))
        except OSError as error:
            raise AdapterError("connection_lost", f"the interface {self.interface} takes no frame: {error}") from None

    # -- remote procedure calls -------------------------------------------------------------------------------

    async def call(
        self, call: Call, station: Station, operation: int, blocks: bytes, *, changes_state: bool = False
    ) -> bytes:
        """Call a device, and return its results.

        Raises:
            AdapterError: silence, a refusal, or an answer that cannot be read.
        """
        self._open(call)
        request = Request(operation, blocks, station.vendor, station.device)
        transmissions = 1 if changes_state else _TRANSMISSIONS
        waiting: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()

        async def transmission() -> Answer:
            call.sending(changes_state=changes_state)
            self.send_call(request, station)
            try:
                async with asyncio.timeout(self.timeout_s / transmissions):
                    return await asyncio.shield(waiting)
            except TimeoutError:
                raise Lost(self._silence()) from None

        self._calling[request.activity] = station.ip, waiting
        try:
            answer = await self._performed(call, transmission)
        finally:
            del self._calling[request.activity]
            waiting.cancel()
        if answer.refused is not None:
            raise AdapterError(
                "unsupported_operation",
                f"the device answers with {answer.refused}",
                outcome="rejected" if call.writes else None,
            )
        if answer.status:
            raise refusal(call, answer.status)
        return answer.blocks

    def send_call(self, request: Request, station: Station) -> None:
        """Send a call once, and wait for nothing."""
        assert self._calls is not None
        try:
            self._calls.sendto(request.encoded(), (station.ip, PORT))
        except OSError as error:
            raise AdapterError(
                "connect_failed", f"no way to {station.ip}: {error.strerror}", outcome="not_sent"
            ) from None

    async def _performed(self, call: Call, transmission: Callable[[], Awaitable[T]]) -> T:
        try:
            found = await repeat_once(call, transmission)
        except AdapterError:
            self._answers = False
            call.disconnected()
            raise
        except BadReply as error:
            raise AdapterError("protocol_error", f"the answer is not the one to the request: {error}") from None
        self._answered(call)
        return found

    def _silence(self) -> AdapterError:
        return AdapterError("timeout", f"no answer came within {self.timeout_s:g} s")

    def _answered(self, call: Call) -> None:
        if not self._answers:
            self._answers = True
            self._generation += 1
        call.answered()

    # -- the sockets ------------------------------------------------------------------------------------------

    def _open(self, call: Call) -> None:
        if self._frames is None or self._calls is None:
            try:
                frames = socket.socket(
                    socket.AF_PACKET, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.htons(ETHERTYPE)
                )
                frames.bind((self.interface, ETHERTYPE))
            except OSError as error:
                call.disconnected()
                why = "packet sockets need CAP_NET_RAW" if error.errno == errno.EPERM else str(error.strerror)
                message = f"the interface {self.interface} cannot be opened: {why}"
                raise AdapterError("connect_failed", message, outcome="not_sent") from None
            self._frames, self.mac = frames, frames.getsockname()[4]
            self._calls = self._datagrams(0)
            asyncio.get_running_loop().add_reader(frames, self._readable)
        # A later request of the same call does not take back that the first one found the device again.
        if not call.attempts:
            call.connection(generation=self._generation + (not self._answers), fresh=not self._answers)

    def listen(self) -> None:
        """Take the requests of devices.

        Raises:
            AdapterError: another program does.
        """
        if self._port is None:
            try:
                self._port = self._datagrams(PORT)
            except OSError as error:
                message = f"UDP port {PORT} cannot be had ({error.strerror}); is another controller running here?"
                raise AdapterError("config_error", message, outcome="not_sent") from None

    def _datagrams(self, port: int) -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        try:
            made.bind(("", port))
        except OSError:
            made.close()
            raise
        asyncio.get_running_loop().add_reader(made, self._called, made)
        return made

    def _readable(self) -> None:
        assert self._frames is not None
        try:
            frame, address = self._frames.recvfrom(_MOST)
        except OSError:
            return
        if address[2] == socket.PACKET_OUTGOING or len(frame) < 16:
            return
        if frame[14] in _CYCLIC:
            self.cyclic(frame[6:12], frame[14:])
        elif (found := dcp_answer(frame)) is not None and found.xid in self._discovering:
            self._discovering[found.xid](found)

    def _called(self, made: socket.socket) -> None:
        try:
            data, address = made.recvfrom(_MOST)
        except OSError:
            return
        try:
            answer = rpc_answer(data)
        except BadReply as fault:
            # It answers the only call that waits for this device, or none that is known.
            waiting = [one for ip, one in self._calling.values() if ip == address[0] and not one.done()]
            if len(waiting) == 1:
                waiting[0].set_exception(fault)
            return
        if answer.asks:
            blocks = self.ready(answer)
            if blocks is not None:
                made.sendto(acknowledged(answer, blocks), address)
        elif answer.activity in self._calling and not self._calling[answer.activity][1].done():
            self._calling[answer.activity][1].set_result(answer)

    def close(self) -> None:
        """Close the sockets."""
        for made in (self._frames, self._calls, self._port):
            if made is not None:
                asyncio.get_running_loop().remove_reader(made)
                made.close()
        self._frames = self._calls = self._port = None
