"""The connection to the controller.

pylogix waits with blocking sockets, and for ever when a controller closes the connection within an answer; it neither looks at the
sequence count of an answer nor lets a call end at its deadline, and it sends what does not fit as several requests. So its frames are
used here without its sockets.
"""

from __future__ import annotations

import asyncio
import secrets
import ssl
import struct

from pylogix import PLC

from ..core import AdapterError, BadReply, Call, DeviceLink
from .connection import SEND_RR_DATA, Connection, Refused, answer, next_frame
from .refusals import encapsulation_refusal, open_refusal, refusal
from .wire import (
    FORWARD_OPEN,
    HEADER,
    LARGE_FORWARD_OPEN,
    REGISTER,
    SOME_FAILED,
    SUCCESS,
    Reply,
    parts_of,
    reply_of,
    unconnected_message,
)

__all__ = ["Link"]

_SIZES = {LARGE_FORWARD_OPEN: 4002, FORWARD_OPEN: 504}
"""Service that opens a connection, and the bytes of a message on it."""
_NOT_SO_LARGE = ((0x08, None), (0x01, 0x0109))
"""Status with which a controller refuses large connections."""
_SEQUENCE = 2
"""Bytes of the sequence count, which belongs to the size of a message."""
_FAREWELL_S = 0.5


class Link(DeviceLink[Connection]):
    """One connection at a time to a controller.

    Args:
        host, port: address of the device that the controller is reached by.
        slot: of the controller in its chassis.
        timeout_s: seconds for connecting, and for each exchange.
        tls: as of :class:`~..core.DeviceLink`.

    Attributes:
        builder: pylogix's controller, which builds paths and requests; it is never connected.
    """

    peer = "controller"
    failures = (EOFError, Refused)

    def __init__(self, host: str, port: int, slot: int, timeout_s: float, tls: ssl.SSLContext | None = None) -> None:
        super().__init__(host, port, timeout_s, tls)
        self.builder = PLC(host, slot, port=port)
        self._frames = self.builder.conn
        self._frames.Socket.close()
        self._frames.msg_socket.close()
        # A controller knows a connection by its serial numbers, and pylogix's originator is always 42.
        self._frames._originator_serial = secrets.randbits(32)
        self._slot = slot

    @property
    def size(self) -> int:
        """Largest message that the connection carries; that which is asked for as long as there is none."""
        return _SIZES[LARGE_FORWARD_OPEN] if self._connection is None else self._connection.size

    async def exchange(
        self, call: Call, request: bytes, *, tag: str | None = None, changes_state: bool = True
    ) -> Reply:
        """Send a request and return its answer, after checking that it is the answer to this request.

        Args:
            tag: the first one that the request is about.
            changes_state: False for a question of a writing tool.

        Raises:
            AdapterError: no connection, no answer, or another answer than the request's.
        """
        facts = {"service": request[0], **({} if tag is None else {"tag": tag})}
        return await self.perform(call, lambda connection: self._sent(connection, call, request, facts, changes_state))

    async def ask(self, call: Call, request: bytes, *, tag: str | None = None, changes_state: bool = True) -> Reply:
        """Send a request and return its answer, which is a success.

        Raises:
            AdapterError: as for :meth:`exchange`, or a refusal.
        """
        reply = await self.exchange(call, request, tag=tag, changes_state=changes_state)
        if reply.status != SUCCESS:
            raise refusal(call, reply.status, reply.extended)
        return reply

    async def ask_for_several(
        self, call: Call, request: bytes, *, tag: str | None = None, changes_state: bool = True
    ) -> list[Reply]:
        """Send a request that has several in itself and return the answer to each, which may be a refusal.

        Raises:
            AdapterError: as for :meth:`exchange`, or a refusal of the whole.
        """
        reply = await self.exchange(call, request, tag=tag, changes_state=changes_state)
        if reply.status not in (SUCCESS, SOME_FAILED):
            raise refusal(call, reply.status, reply.extended)
        try:
            return parts_of(request, reply)
        except BadReply as fault:
            raise AdapterError("protocol_error", f"the answer is not the one to the request: {fault}") from None

    async def _sent(
        self, connection: Connection, call: Call, request: bytes, facts: dict[str, object], changes_state: bool
    ) -> Reply:
        if len(request) + _SEQUENCE > connection.size:
            message = f"the connection takes messages of up to {connection.size} bytes; ask for less at once"
            raise AdapterError("limit_exceeded", message, outcome="not_sent" if call.writes else "not_applicable")
        frame = self._frames._build_eip_header(request)
        (sequence,) = struct.unpack_from("<H", frame, HEADER + 20)
        call.sending(changes_state=changes_state)
        call.trace.update(facts)
        call.trace.setdefault("sequences", []).append(sequence)
        connection.used = asyncio.get_running_loop().time()
        async with asyncio.timeout(self._timeout_s):
            return reply_of(request[0], await answer(connection, frame, sequence))

    def _explained(self, call: Call, connection: Connection, error: Exception) -> Exception:
        if isinstance(error, Refused):
            call.answered()
            return encapsulation_refusal(call, error.status)
        return super()._explained(call, connection, error)

    # -- connecting ---------------------------------------------------------------------------------------

    async def _open(self) -> Connection:
        connection = Connection(*await asyncio.open_connection(self._host, self._port, **self._security))
        try:
            await self._register(connection)
            await self._forward_open(connection)
        except BaseException:
            connection.abort()
            raise
        connection.used = asyncio.get_running_loop().time()
        return connection

    def _is_usable(self, connection: Connection) -> bool:
        return not connection.is_used_up()

    def _end(self, connection: Connection) -> None:
        connection.abort()

    async def _register(self, connection: Connection) -> None:
        """Register a session."""
        self._frames._session_handle = 0
        connection.writer.write(self._frames._build_register_session())
        connection.session, _ = await next_frame(connection, REGISTER)
        self._frames._session_handle = connection.session

    async def _forward_open(self, connection: Connection) -> None:
        """Open a CIP connection to the controller: a large one or, where it has none, one of the usual size.

        Raises:
            AdapterError: the controller refuses it.
        """
        for service, size in _SIZES.items():
            self._frames.ConnectionSize = size
            connection.writer.write(self._frames._build_forward_open_packet())
            reply = reply_of(service, unconnected_message((await next_frame(connection, SEND_RR_DATA))[1]))
            if reply.status == SUCCESS:
                break
            if service != LARGE_FORWARD_OPEN or (reply.status, reply.extended) not in _NOT_SO_LARGE:
                raise open_refusal(reply.status, reply.extended, self._slot)
        if len(reply.data) < 8:
            raise BadReply("it names no connections")
        self._frames._ot_connection_id, connection.answers = struct.unpack_from("<II", reply.data)
        connection.size = size

    async def close(self) -> None:
        """Close the CIP connection and the session: a controller has few, and keeps those that nobody closes."""
        connection = self._connection
        if connection is not None and not self._turn.locked() and not connection.is_used_up():
            try:
                async with asyncio.timeout(_FAREWELL_S):
                    connection.writer.write(self._frames._build_forward_close_packet())
                    await next_frame(connection, SEND_RR_DATA)
                    connection.writer.write(self._frames._build_unregister_session())
                    await connection.writer.drain()
                    connection.writer.close()
                    await connection.writer.wait_closed()
            except (OSError, EOFError, BadReply, Refused):
                pass
        await super().close()
