"""The connection to the controller: made on demand, one exchange at a time, no write ever sent twice.

python-snap7's clients send a request again when ``auto_reconnect`` is on, writes too, cut what is longer than a PDU into several
jobs, and take the answer with the right number for the right answer. So its connection and its PDUs are used here without them.
"""

from __future__ import annotations

import asyncio
import struct
from typing import Any

from snap7.async_client import AsyncISOTCPConnection
from snap7.error import S7ConnectionError, S7Error, S7TimeoutError
from snap7.s7protocol import S7Protocol

from ..core import AdapterError, Call, resolve
from .refusals import refusal
from .wire import BadReply, Reply, reference, reply_of, request_facts

__all__ = ["PDU_SIZE", "Link"]

PDU_SIZE = 480
"""Largest PDU, in bytes, that is asked for; a controller may agree to 240 only."""
_SMALLEST_PDU = 64
_CONNECTION_TYPE = 1 << 8
"""Of the called TSAP: a programming device, which every controller accepts."""
_LATE = 3
"""Late answers to earlier requests that may come before the answer."""
_MOST_PARTS = 100


class _Lost(Exception):
    """The connection ended before any byte of the answer had come."""


class _Connection(AsyncISOTCPConnection):
    """One connection, which can be ended at once: ``disconnect`` waits until everything has been sent."""

    pdu_length = 0

    def abort(self) -> None:
        self.connected = False
        if self._writer is not None:
            self._writer.transport.abort()


class Link:
    """One connection at a time to a controller.

    Args:
        host, port: address of the controller.
        rack, slot: of its CPU.
        timeout_s: seconds for connecting, and for each exchange.

    Attributes:
        protocol: numbers and builds the requests.
    """

    def __init__(self, host: str, port: int, rack: int, slot: int, timeout_s: float) -> None:
        self.protocol = S7Protocol()
        self._host = host
        self._port = port
        self._rack, self._slot = rack, slot
        self._timeout_s = timeout_s
        self._lock = asyncio.Lock()
        self._connection: _Connection | None = None
        self._generation = 0

    @property
    def pdu_size(self) -> int:
        """Largest PDU that the controller has agreed to; what is asked for as long as it has not."""
        return PDU_SIZE if self._connection is None else self._connection.pdu_length

    async def exchange(self, call: Call, request: bytes, *, changes_state: bool = True) -> Reply:
        """Send a request and return its answer, after checking that it is the answer to this request.

        A read that finds the connection dead is repeated once over a new one. A write is not: once its bytes may have left, only
        the controller knows whether it was executed.

        Args:
            changes_state: False for a question of a writing tool.

        Raises:
            AdapterError: no connection, no answer, another answer than the request's, or a refusal.
        """
        async with self._lock:
            reply = await self._repeated(call, request, changes_state)
        if reply.error:
            raise refusal(call, error=reply.error)
        return reply

    async def parts(self, call: Call, request: bytes) -> list[Reply]:
        """Send a request of user data, ask for the parts that follow the answer, and return all.

        Raises:
            AdapterError: as for :meth:`exchange`.
        """
        replies = [await self.exchange(call, request)]
        # Byte 9 of the parameters: more follows; byte 7: the number of the sequence.
        while replies[-1].parameters[9] and len(replies) < _MOST_PARTS:
            group, subfunction, sequence = request[15] & 0x0F, request[16], replies[-1].parameters[7]
            following = self.protocol.build_userdata_followup_request(group, subfunction, sequence)
            replies.append(await self.exchange(call, following))
        return replies

    async def _repeated(self, call: Call, request: bytes, changes_state: bool) -> Reply:
        try:
            try:
                return await self._attempt(call, request, changes_state)
            except _Lost:
                if call.sent:
                    raise
                return await self._attempt(call, request, changes_state)
        except _Lost:
            raise AdapterError("connection_lost", "the connection broke during the call") from None

    async def _attempt(self, call: Call, request: bytes, changes_state: bool) -> Reply:
        connection = await self._connected(call)
        if len(request) > connection.pdu_length:
            message = f"the controller takes PDUs of up to {connection.pdu_length} bytes; ask for less at once"
            raise AdapterError("limit_exceeded", message, outcome="not_sent" if call.writes else "not_applicable")
        call.trace.update(request_facts(request))
        call.trace.setdefault("references", []).append(reference(request))
        call.sending(changes_state=changes_state)
        call.trace["pdus"] = call.attempts
        try:
            async with asyncio.timeout(self._timeout_s):
                reply = reply_of(self.protocol, request, await _answer(connection, request))
        except (S7Error, OSError, TimeoutError, BadReply, asyncio.CancelledError) as error:
            # A late answer to this request must not be taken for the answer to the next one.
            self._drop()
            call.disconnected()
            if isinstance(error, asyncio.CancelledError):
                raise
            raise self._explained(error) from None
        call.answered()
        return reply

    def _explained(self, error: Exception) -> Exception:
        if isinstance(error, TimeoutError | S7TimeoutError):
            return AdapterError("timeout", f"the controller did not answer within {self._timeout_s:g} s")
        if isinstance(error, BadReply):
            return AdapterError("protocol_error", f"the answer is not the one to the request: {error}")
        # The library's words are the only sign of what came: an end of the connection, or bytes that are no TPKT.
        if isinstance(error, S7ConnectionError) and "Invalid" in str(error):
            return AdapterError("protocol_error", "what the controller sent is no valid answer to the request")
        if isinstance(error, S7ConnectionError | OSError):
            return _Lost()
        return AdapterError("protocol_error", "what the controller sent is no valid answer to the request")

    async def _connected(self, call: Call) -> _Connection:
        existing = self._connection
        if existing is not None and existing.connected and not _is_used_up(existing):
            call.connection(generation=self._generation, fresh=False)
            return existing
        self._drop()
        call.disconnected()
        await resolve(self._host, self._port)
        connection = _Connection(self._host, self._port, remote_tsap=_CONNECTION_TYPE | self._rack << 5 | self._slot)
        try:
            async with asyncio.timeout(self._timeout_s):
                await connection.connect(self._timeout_s)
                connection.pdu_length = await self._set_up(connection)
        except (S7Error, OSError, TimeoutError, BadReply, AdapterError) as error:
            connection.abort()
            raise self._not_connected(error) from None
        except asyncio.CancelledError:
            connection.abort()
            raise
        self._connection = connection
        self._generation += 1
        call.connection(generation=self._generation, fresh=True)
        return connection

    async def _set_up(self, connection: _Connection) -> int:
        """Agree on a PDU, one job at a time; return its size."""
        request = self.protocol.build_setup_communication_request(1, 1, PDU_SIZE)
        reply = reply_of(self.protocol, request, await _answer(connection, request))
        if reply.error or len(reply.parameters) != 8:
            raise BadReply(f"error {reply.error:04X}")
        (size,) = struct.unpack(">H", reply.parameters[6:])
        if size < _SMALLEST_PDU:
            raise BadReply(f"a PDU of {size} bytes")
        return min(int(size), PDU_SIZE)

    def _not_connected(self, error: Exception) -> AdapterError:
        where = f"{self._host}:{self._port}"
        # A disconnect request in the place of the confirmation: the host is a controller, and nothing is in this slot.
        if "got 0x80" in str(error):
            message = f"{where} refuses rack {self._rack}, slot {self._slot}; set S7_RACK and S7_SLOT to the CPU's"
            return AdapterError("config_error", message, outcome="not_sent")
        message = f"no connection to {where}; is the controller on, and is the address right?"
        return AdapterError("connect_failed", message, outcome="not_sent")

    def _drop(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.abort()

    async def close(self) -> None:
        """Close the connection."""
        self._drop()


def _is_used_up(connection: _Connection) -> bool:
    """Tell whether the controller has ended the connection, or has sent something that nobody had asked for: where the next answer
    begins cannot be known then. The library would find both only by reading, when the next request has left."""
    reader: Any = connection._reader
    return reader is None or bool(reader._buffer) or reader.at_eof()


async def _answer(connection: _Connection, request: bytes) -> bytes:
    """Send a request, and return the PDU with its reference. What is late for an earlier request is passed over.

    Raises:
        BadReply: the answer has a reference that no request had.
        S7Error, OSError: there is none.
    """
    await connection.send_data(request)
    for _ in range(_LATE):
        pdu = await connection.receive_data()
        late = (reference(request) - reference(pdu)) & 0xFFFF
        if not late:
            return pdu
        # The numbers count up: a smaller one was an earlier request's, on this connection.
        if late > 0x8000 or reference(pdu) <= 0:
            break
    raise BadReply("its PDU reference is not the request's")
