"""The connection to the controller.

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

from ..core import AdapterError, BadReply, Call, DeviceLink
from .refusals import refusal
from .wire import Reply, reference, reply_of, request_facts

__all__ = ["PDU_SIZE", "Link"]

PDU_SIZE = 480
"""Largest PDU, in bytes, that is asked for; a controller may agree to 240 only."""
_SMALLEST_PDU = 64
_CONNECTION_TYPE = 1 << 8
"""Of the called TSAP: a programming device, which every controller accepts."""
_LATE = 3
"""Late answers to earlier requests that may come before the answer."""
_MOST_PARTS = 100


class _Connection(AsyncISOTCPConnection):
    """One connection, which can be ended at once: ``disconnect`` waits until everything has been sent."""

    pdu_length = 0

    def abort(self) -> None:
        self.connected = False
        if self._writer is not None:
            self._writer.transport.abort()


class Link(DeviceLink[_Connection]):
    """One connection at a time to a controller.

    Args:
        host, port: address of the controller.
        rack, slot: of its CPU.
        timeout_s: seconds for connecting, and for each exchange.

    Attributes:
        protocol: numbers and builds the requests.
    """

    peer = "controller"
    failures = (S7Error,)

    def __init__(self, host: str, port: int, rack: int, slot: int, timeout_s: float) -> None:
        super().__init__(host, port, timeout_s)
        self.protocol = S7Protocol()
        self._rack, self._slot = rack, slot

    @property
    def pdu_size(self) -> int:
        """Largest PDU that the controller has agreed to; what is asked for as long as it has not."""
        return PDU_SIZE if self._connection is None else self._connection.pdu_length

    async def exchange(self, call: Call, request: bytes, *, changes_state: bool = True) -> Reply:
        """Send a request and return its answer, after checking that it is the answer to this request.

        Args:
            changes_state: False for a question of a writing tool.

        Raises:
            AdapterError: no connection, no answer, another answer than the request's, or a refusal.
        """

        async def once(connection: _Connection) -> Reply:
            if len(request) > connection.pdu_length:
                message = f"the controller takes PDUs of up to {connection.pdu_length} bytes; ask for less at once"
                raise AdapterError("limit_exceeded", message, outcome="not_sent" if call.writes else "not_applicable")
            call.sending(changes_state=changes_state)
            call.trace.update(request_facts(request))
            call.trace.setdefault("references", []).append(reference(request))
            call.trace["pdus"] = call.attempts
            async with asyncio.timeout(self._timeout_s):
                return reply_of(self.protocol, request, await _answer(connection, request))

        reply = await self.perform(call, once)
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

    def _explained(self, call: Call, connection: _Connection, error: Exception) -> Exception:
        if isinstance(error, S7TimeoutError):
            error = TimeoutError()
        # The library's words are the only sign of what came: an end of the connection, or bytes that are no TPKT.
        elif isinstance(error, S7Error) and (not isinstance(error, S7ConnectionError) or "Invalid" in str(error)):
            return AdapterError("protocol_error", "what the controller sent is no valid answer to the request")
        return super()._explained(call, connection, error)

    async def _open(self) -> _Connection:
        connection = _Connection(self._host, self._port, remote_tsap=_CONNECTION_TYPE | self._rack << 5 | self._slot)
        try:
            await connection.connect(self._timeout_s)
            connection.pdu_length = await self._set_up(connection)
        except BaseException:
            connection.abort()
            raise
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

    def _unreachable(self, error: Exception) -> AdapterError:
        # A disconnect request in the place of the confirmation: the host is a controller, and nothing is in this slot.
        if "got 0x80" in str(error):
            where = f"{self._host}:{self._port}"
            message = f"{where} refuses rack {self._rack}, slot {self._slot}; set S7_RACK and S7_SLOT to the CPU's"
            return AdapterError("config_error", message, outcome="not_sent")
        return super()._unreachable(error)

    def _is_usable(self, connection: _Connection) -> bool:
        """Tell whether the controller has neither ended the connection nor sent something that nobody had asked for: where the next answer
        begins cannot be known then. The library would find both only by reading, when the next request has left."""
        reader: Any = connection._reader
        return connection.connected and reader is not None and not reader._buffer and not reader.at_eof()

    def _end(self, connection: _Connection) -> None:
        connection.abort()


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
