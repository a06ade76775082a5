"""One connection: the journal entries of its messages, BrowseNext, and the faults that concern answers.

Private parts of asyncua 2.1 are overridden here and nowhere else: it offers no other place where every service passes.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import Buffer, ServiceError
from asyncua.server.binary_server_asyncio import OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import SessionState
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import struct_from_binary

from ..network import Link
from ..peer import process_of
from .exchange import Exchange, current
from .state import DeviceState

__all__ = ["PlantProtocol"]

_SUFFIX = "Request_Encoding_DefaultBinary"
_NAMES = {"TranslateBrowsePathsToNodeIds": "TranslateBrowsePaths"}
_SERVICES = {
    number: _NAMES.get(name.removesuffix(_SUFFIX), name.removesuffix(_SUFFIX))
    for name, number in vars(ua.ObjectIds).items()
    if name.endswith(_SUFFIX)
}
# The session journals these services itself, with the nodes that they are about.
_WITH_NODES = frozenset(
    {"Read", "Write", "Browse", "BrowseNext", "TranslateBrowsePaths", "Call", "CreateMonitoredItems"}
)

_WITHOUT_SESSION = frozenset({"CreateSession", "GetEndpoints", "FindServers"})


class _Processor(UaProcessor):  # type: ignore[misc]
    def __init__(
        self,
        internal_server: InternalServer,
        transport: Link,
        limits: TransportLimits,
        device: DeviceState,
        number: int,
    ) -> None:
        super().__init__(internal_server, transport, limits)
        self._device = device
        self._number = number
        self._late: set[asyncio.Task[None]] = set()
        device.connections.add(self)

    def open_secure_channel(self, algohdr: Any, seqhdr: Any, body: Buffer) -> None:
        Exchange(self._device, self._number, "OpenSecureChannel", 0).asked()
        super().open_secure_channel(algohdr, seqhdr, body)

    async def process(self, header: Any, body: Buffer) -> bool:
        if header.MessageType == ua.MessageType.SecureClose:
            Exchange(self._device, self._number, "CloseSecureChannel", 0).asked()
        return bool(await super().process(header, body))

    async def process_message(self, seqhdr: Any, body: Buffer) -> bool:
        if not self._device.faults:
            return bool(await super().process_message(seqhdr, body))
        # A call that a fault delays must not delay the next one.
        task = asyncio.create_task(self._process_late(seqhdr, body))
        self._late.add(task)
        task.add_done_callback(self._late.discard)
        return True

    async def _process_late(self, seqhdr: Any, body: Buffer) -> None:
        if not await super().process_message(seqhdr, body):
            self._transport.close()

    async def _process_message(self, typeid: ua.NodeId, requesthdr: Any, seqhdr: Any, body: Buffer) -> bool:
        service = _SERVICES.get(typeid.Identifier, typeid.to_string())
        exchange = Exchange(self._device, self._number, service, requesthdr.RequestHandle)
        if self.session is not None and self.session.state is SessionState.Closed and service not in _WITHOUT_SESSION:
            # The library serves a session that is closed.
            exchange.asked(())
            raise ServiceError(ua.StatusCodes.BadSessionIdInvalid)
        if service not in _WITH_NODES:
            exchange.asked(())
            await exchange.suffer()
        if service != "BrowseNext":
            processed = bool(await super()._process_message(typeid, requesthdr, seqhdr, body))
            if service == "ActivateSession":
                self._device.cut_off.discard(self.session)
            return processed
        if self.session is None or not self.session.is_activated():
            raise ServiceError(ua.StatusCodes.BadSessionNotActivated)
        self.session.touch()
        response = ua.BrowseNextResponse()
        response.Parameters.Results = await self.session.browse_next(struct_from_binary(ua.BrowseNextParameters, body))
        self.send_response(requesthdr.RequestHandle, seqhdr, response)
        return True

    def send_response(
        self, requesthandle: int, seqhdr: Any, response: Any, msgtype: ua.MessageType = ua.MessageType.SecureMessage
    ) -> None:
        exchange = current()
        # A notification is sent when a value changes, not while a request is handled: it belongs to no exchange.
        if isinstance(response, ua.PublishResponse):
            self._device.notify(
                response.Parameters.NotificationMessage, partial(self._notify, requesthandle, seqhdr, response)
            )
            return
        rule = exchange.rule
        if self.session is not None and (
            rule.manner.half_open or rule.reset or rule.close or _without_channel(response)
        ):
            self._device.cut_off.add(self.session)
        if rule.manner.half_open:
            self._transport.die()
        elif rule.reset:
            self._transport.reset()
        elif rule.close:
            self._transport.close()
        elif not rule.drop and self._transport.carries():
            facts = {"drip_s": rule.manner.drip_s} if rule.manner.drip_s else {}
            for again in ({}, {"duplicate": True}) if rule.manner.duplicate else ({},):
                if rule.manner.mangle is None:
                    exchange.answered(response.ResponseHeader.ServiceResult, **facts, **again)
                with self._transport.sending(rule.manner):
                    super().send_response(requesthandle, seqhdr, response, msgtype)

    def _notify(self, requesthandle: int, seqhdr: Any, response: ua.PublishResponse) -> None:
        if self._transport.carries():
            self._notified(response.Parameters)
            super().send_response(requesthandle, seqhdr, response)

    def _notified(self, result: ua.PublishResult) -> None:
        """Journal the nodes whose values a notification has; one without values keeps the subscription alive."""
        nodes = [
            {"node_id": self.session.monitored[result.SubscriptionId, item.ClientHandle], "attribute": "Value"}
            for data in result.NotificationMessage.NotificationData or []
            for item in getattr(data, "MonitoredItems", None) or []
            if (result.SubscriptionId, item.ClientHandle) in self.session.monitored
        ]
        if nodes:
            self._device.journal.event(connection=self._number, direction="out", kind="Publish", nodes=nodes)

    async def close(self) -> None:
        self._device.connections.discard(self)
        for task in list(self._late):
            task.cancel()
        await super().close()


def _without_channel(response: Any) -> bool:
    """Tell whether an answer says that the device does not know the connection's secure channel."""
    code = response.ResponseHeader.ServiceResult.value
    return bool(code == ua.StatusCodes.BadSecureChannelIdInvalid)


class PlantProtocol(OPCUAProtocol):  # type: ignore[misc]
    """A connection with a number, 1 for the device's first."""

    def __init__(self, *, device: DeviceState, number: int, **parts: Any) -> None:
        super().__init__(**parts)
        self._device = device
        self._number = number

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, Link)
        transport.number = self._number
        self._device.journal.connected(self._number, process_of(transport))
        super().connection_made(transport)
        if self.transport is None:
            # The library has refused it: there are as many connections as it serves at a time.
            return
        self.processor = _Processor(self.iserver, transport, self.limits, self._device, self._number)
        self.processor.set_policies(self.policies)

    def connection_lost(self, ex: BaseException | None) -> None:
        self._device.journal.event(connection=self._number, direction="in", kind="DISCONNECTED")
        super().connection_lost(ex)
