"""One connection: the record of its messages, BrowseNext, and the faults that concern answers.

Private parts of asyncua 2.1 are overridden here and nowhere else: it offers no other place where every service passes.
"""

from __future__ import annotations

import asyncio
from contextvars import ContextVar
from functools import partial
from typing import Any

from asyncua import ua
from asyncua.common.connection import MessageChunk, TransportLimits
from asyncua.common.utils import Buffer, ServiceError
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.server.binary_server_asyncio import OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import SessionState
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import struct_from_binary, struct_to_binary, uatcp_to_binary

from pytest_otmcp.wire.framing import Framer
from pytest_otmcp.wire.opcua import chunk_length

from ..network import Link
from ..peer import process_of
from .certificates import told_of, unsealed
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
# The session records these services itself: it knows which nodes they are about, and so which fault applies.
_WITH_NODES = frozenset(
    {"Read", "Write", "Browse", "BrowseNext", "TranslateBrowsePaths", "Call", "CreateMonitoredItems"}
)

_request: ContextVar[list[bytes]] = ContextVar("request")
"""Chunks of the message that is processed."""

_ON_A_CHANNEL = (ua.MessageType.SecureMessage, ua.MessageType.SecureClose)

_WITHOUT_SESSION = frozenset({"CreateSession", "GetEndpoints", "FindServers"})
_OF_ANY_SESSION = frozenset({"ActivateSession", "CloseSession", "RegisterServer", "RegisterServer2"})
"""Services that the library itself looks after where a connection has no session."""


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
        self._chunks: list[bytes] = []
        self._genuine = self._connection._receive
        self._connection._receive = self._opened
        device.connections.add(self)

    def _opened(self, chunk: MessageChunk) -> Any:
        """Take a chunk whose seal has been opened: the journal has it as it would be without one."""
        if self._chunks and self._connection.security_policy.Mode != ua.MessageSecurityMode.None_:
            self._chunks[-1] = unsealed(chunk)
        return self._genuine(chunk)

    def open_secure_channel(self, algohdr: Any, seqhdr: Any, body: Buffer) -> None:
        self._exchange("OpenSecureChannel", seqhdr.RequestId, self._taken()).asked()
        super().open_secure_channel(algohdr, seqhdr, body)
        if (handshake := told_of(self._connection.security_policy)) is not None:
            self._device.journal.event(
                connection=self._number,
                direction="in",
                kind="tls_open",
                certificate=self._device.certificate,
                **handshake,
            )

    async def process(self, header: Any, body: Buffer) -> bool:
        # The messages of the connection protocol below (Hello, Acknowledge) are left out: they are no services.
        if header.MessageType != ua.MessageType.Hello:
            self._chunks.append(body._data[: header.packet_size])
        if header.MessageType in _ON_A_CHANNEL and not self._is_of_the_channel(header.ChannelId):
            # The library takes the token 0 of a client that is about to open its channel, and loses its own by that.
            return self._ended(ua.StatusCodes.BadTcpSecureChannelUnknown)
        try:
            return bool(await super().process(header, body))
        except ua.UaError:
            # The library is silent, and answers nothing on this connection from then on.
            return self._ended(ua.StatusCodes.BadSecurityChecksFailed)
        finally:
            # It has no answer, so nothing else records it.
            if header.MessageType == ua.MessageType.SecureClose:
                self._exchange("CloseSecureChannel", 0, self._taken()).asked()

    def _is_of_the_channel(self, number: int) -> bool:
        connection = self._connection
        return bool(connection.is_open()) and number == connection.security_token.ChannelId

    def _ended(self, code: int) -> bool:
        """Tell the client why the connection ends (OPC 10000-6, sections 6.7.2.4 and 7.1.2.5); return False, which ends it."""
        self._exchange("", 0, self._taken()).asked()
        self._transport.write(uatcp_to_binary(ua.MessageType.Error, ua.ErrorMessage(Error=ua.StatusCode(code))))
        return False

    def _taken(self) -> list[bytes]:
        """Return the chunks of the message that has arrived."""
        taken, self._chunks = self._chunks, []
        return taken

    def _exchange(self, service: str, request_id: int, chunks: list[bytes]) -> Exchange:
        return Exchange(self._device, self._number, service, request_id, chunks)

    async def process_message(self, seqhdr: Any, body: Buffer) -> bool:
        chunks = self._taken()
        if not self._device.faults:
            return await self._processed(seqhdr, body, chunks)
        # A call that a fault delays must not delay the next one.
        task = asyncio.create_task(self._process_late(seqhdr, body, chunks))
        self._late.add(task)
        task.add_done_callback(self._late.discard)
        return True

    async def _process_late(self, seqhdr: Any, body: Buffer, chunks: list[bytes]) -> None:
        if not await self._processed(seqhdr, body, chunks):
            self._transport.close()

    async def _processed(self, seqhdr: Any, body: Buffer, chunks: list[bytes]) -> bool:
        _request.set(chunks)
        try:
            return await super().process_message(seqhdr, body) is not False
        finally:
            # What the library cannot read has arrived all the same.
            self._exchange("", seqhdr.RequestId, chunks).asked()

    async def _process_message(self, typeid: ua.NodeId, requesthdr: Any, seqhdr: Any, body: Buffer) -> bool:
        service = _SERVICES.get(typeid.Identifier, typeid.to_string())
        exchange = self._exchange(service, seqhdr.RequestId, _request.get())
        closed = self.session is not None and self.session.state is SessionState.Closed
        none = self.session is None and service not in _OF_ANY_SESSION
        if service not in _WITHOUT_SESSION and (closed or none):
            # The library serves a session that is closed; without one it refuses as to another user, and closes the connection.
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
            said: dict[str, Any] = {"drip_s": rule.manner.drip_s} if rule.manner.drip_s else {}
            for again in ({}, {"duplicate": True}) if rule.manner.duplicate else ({},):
                message, plain = self._encoded(requesthandle, seqhdr, response, msgtype)
                if rule.manner.mangle is None:
                    exchange.answered(plain, seqhdr.RequestId, **said, **again)
                with self._transport.sending(rule.manner):
                    self._transport.write(message)

    def _encoded(
        self, requesthandle: int, seqhdr: Any, response: Any, msgtype: ua.MessageType = ua.MessageType.SecureMessage
    ) -> tuple[bytes, bytes]:
        """Return the bytes of an answer, and what they would be without a seal."""
        response.ResponseHeader.RequestHandle = requesthandle
        connection, body, request_id = self._connection, struct_to_binary(response), seqhdr.RequestId
        sent = connection._sequence_number
        message: bytes = connection.message_to_binary(body, message_type=msgtype, request_id=request_id)
        if connection.security_policy.Mode == ua.MessageSecurityMode.None_:
            return message, message
        chunks = MessageChunk.message_to_chunks(
            SecurityPolicyNone(),
            body,
            connection._limits.max_send_buffer,
            message_type=msgtype,
            channel_id=connection.security_token.ChannelId,
            request_id=request_id,
            token_id=connection.security_token.TokenId,
        )
        for number, chunk in enumerate(chunks, sent + 1):
            chunk.SequenceHeader.SequenceNumber = number
        return message, b"".join(chunk.to_binary() for chunk in chunks)

    def _notify(self, requesthandle: int, seqhdr: Any, response: ua.PublishResponse) -> None:
        if self._transport.carries():
            nodes = self._nodes(response.Parameters)
            message, plain = self._encoded(requesthandle, seqhdr, response)
            # One without values keeps the subscription alive.
            for chunk in Framer(chunk_length).feed(plain) if nodes else ():
                self._device.journal.frame(chunk, connection=self._number, direction="out", nodes=nodes)
            self._transport.write(message)

    def _nodes(self, result: ua.PublishResult) -> list[dict[str, str]]:
        """Return the nodes whose values a notification has: its bytes have only the numbers that the client gave them."""
        return [
            {"node_id": self.session.monitored[result.SubscriptionId, item.ClientHandle], "attribute": "Value"}
            for data in result.NotificationMessage.NotificationData or []
            for item in getattr(data, "MonitoredItems", None) or []
            if (result.SubscriptionId, item.ClientHandle) in self.session.monitored
        ]

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
    """A connection with a number."""

    def __init__(self, *, device: DeviceState, **parts: Any) -> None:
        super().__init__(**parts)
        self._device = device
        self._number: int

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, Link)
        self._number = transport.number
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
