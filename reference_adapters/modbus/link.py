"""The connection to the device: made on demand, one exchange at a time, nothing ever sent twice behind one's back.

pymodbus's defaults re-send writes three times and reconnect in their own time; here ``retries`` and ``reconnect_delay``
are 0 and both decisions are made in :meth:`Link.exchange`, where it is known whether bytes have left.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from ..core import AdapterError, Call

__all__ = ["Link", "Send"]

Send = Callable[[AsyncModbusTcpClient], Awaitable[ModbusPDU]]

# MODBUS Application Protocol V1.1b3, section 7: exception code to error code and outcome of a write.
_EXCEPTIONS = {
    1: ("unsupported_operation", "rejected", "the device does not offer this function"),
    2: ("illegal_address", "rejected", "the device has no such address"),
    3: ("illegal_value", "rejected", "the device refuses the value or quantity"),
    4: ("device_failure", "unknown", "the device failed while executing the request"),
    5: ("accepted_pending", "unknown", "the device accepted the request and needs time"),
    6: ("device_busy", "rejected", "the device is busy"),
    8: ("device_failure", "unknown", "the device reports a memory parity error"),
    10: ("gateway_path_unavailable", "rejected", "the gateway has no path to the unit"),
    11: ("gateway_target_no_response", "unknown", "the unit behind the gateway did not respond"),
}


class _ConnectionLost(Exception):
    """The connection ended while a reply was awaited."""


class Link:
    """One TCP connection to a Modbus device or gateway."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self._host = host
        self._port = port
        self._timeout_s = timeout_s
        self._lock = asyncio.Lock()
        self._client: AsyncModbusTcpClient | None = None
        self._lost = asyncio.Event()
        self._sent_transaction: int | None = None
        self._call: Call | None = None
        self.generation = 0

    async def exchange(self, call: Call, unit: int, send: Send) -> ModbusPDU:
        """Send one request and return its reply.

        A read that met a dead connection is repeated once over a new one. A write is not: once its bytes may have
        left, only the device knows what became of it.

        Raises:
            AdapterError: no connection, no reply, a reply that does not belong to the request, or an exception reply.
        """
        async with self._lock:
            try:
                reply = await self._attempt(call, send)
            except _ConnectionLost:
                if call.writes:
                    raise AdapterError("connection_lost", "the connection broke while the write was under way") from None
                try:
                    reply = await self._attempt(call, send)
                except _ConnectionLost:
                    raise AdapterError("connection_lost", "the connection broke during the call") from None
        return _checked(call, unit, reply)

    async def _attempt(self, call: Call, send: Send) -> ModbusPDU:
        client, fresh = await self._connected()
        call.connection(generation=self.generation, fresh=fresh)
        self._call, self._sent_transaction = call, None
        request = asyncio.ensure_future(send(client))
        lost = asyncio.ensure_future(self._lost.wait())
        try:
            # pymodbus does not fail a pending request when the peer closes; it would wait out its timeout.
            await asyncio.wait({request, lost}, return_when=asyncio.FIRST_COMPLETED)
            if not request.done():
                self._drop(call)
                raise _ConnectionLost
            reply = request.result()
        except ModbusException as error:
            self._drop(call)
            if self._lost.is_set():
                raise _ConnectionLost from None
            raise AdapterError("timeout", f"no valid reply within {self._timeout_s:g} s") from error
        except asyncio.CancelledError:
            # A reply that comes late must not meet the next request.
            self._drop(call)
            raise
        finally:
            lost.cancel()
            request.cancel()
            self._call = None
        if reply.transaction_id != self._sent_transaction:
            self._drop(call)
            raise AdapterError("protocol_error", "the reply carries another transaction identifier", outcome="unknown")
        return reply

    async def _connected(self) -> tuple[AsyncModbusTcpClient, bool]:
        if self._client is not None and self._client.connected and not self._lost.is_set():
            return self._client, False
        self._drop(None)
        lost = self._lost = asyncio.Event()
        client = AsyncModbusTcpClient(
            self._host,
            port=self._port,
            timeout=self._timeout_s,
            retries=0,
            reconnect_delay=0,
            trace_connect=lambda connected: None if connected else lost.set(),
            trace_pdu=self._trace,
        )
        if not await client.connect():
            client.close()
            raise AdapterError("connect_failed", "no connection to the device could be made", outcome="not_sent")
        self._client = client
        self.generation += 1
        return client, True

    def _trace(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        # Counts what really goes to the transport, whoever decided to send it.
        if sending and self._call is not None:
            self._call.sending()
            self._sent_transaction = pdu.transaction_id
        return pdu

    def _drop(self, call: Call | None) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.close()
        if call is not None:
            call.disconnected()

    async def close(self) -> None:
        """Close the connection."""
        self._drop(None)


def _checked(call: Call, unit: int, reply: ModbusPDU) -> ModbusPDU:
    trace: dict[str, Any] = {"unit": reply.dev_id, "function": reply.function_code & 0x7F}
    if reply.dev_id != unit:
        raise AdapterError("protocol_error", "the reply comes from another unit", outcome="unknown")
    if reply.isError():
        code = getattr(reply, "exception_code", 0)
        call.answered(**trace, exception_code=code)
        error, outcome, meaning = _EXCEPTIONS.get(code, ("protocol_error", "unknown", "unknown exception code"))
        raise AdapterError(
            error, f"{meaning} (exception {code:02X})", outcome=outcome if call.writes else "not_applicable"
        )
    call.answered(**trace)
    return reply
