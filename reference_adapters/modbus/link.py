"""The connection to the device: made on demand, one exchange at a time, no write ever sent twice.

By default pymodbus sends a write again three times and reconnects by itself. Here ``retries`` and ``reconnect_delay`` are 0,
and :meth:`Link.exchange` makes both decisions, because it knows whether bytes have left.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from ..core import AdapterError, Call, resolve
from .wire import BadReply, Frame, is_other_reply, reply_pdu, request_facts

__all__ = ["Link", "Send"]

Send = Callable[[AsyncModbusTcpClient], Awaitable[ModbusPDU]]

# MODBUS Application Protocol V1.1b3, section 7: exception code to error code and outcome of a write.
_EXCEPTIONS = {
    1: ("unsupported_operation", "rejected", "the device does not offer this function"),
    2: ("illegal_address", "rejected", "the device has no such address"),
    3: ("illegal_value", "rejected", "the device refuses the value or quantity"),
    4: ("device_failure", "unknown", "the device failed while executing the request"),
    5: ("accepted_pending", "unknown", "the device accepted the request and needs time; do not repeat it"),
    6: ("device_busy", "rejected", "the device is busy; try again later"),
    8: ("device_failure", "rejected", "the device reports a memory parity error"),
    10: ("gateway_path_unavailable", "rejected", "the gateway has no path to the unit"),
    11: ("gateway_target_no_response", "unknown", "the unit behind the gateway did not respond"),
}


class _ConnectionDied(Exception):
    """The connection ended before any byte of the reply had come."""


class _Connection:
    """One TCP connection, and the bytes of its present exchange."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self.lost = False
        self.request: Frame | None = None
        self.received = b""
        self.answered = False
        self._call: Call | None = None
        self._patience = asyncio.timeout(None)
        self.client = AsyncModbusTcpClient(
            host,
            port=port,
            timeout=timeout_s,
            retries=0,
            reconnect_delay=0,
            trace_connect=self._connect,
            trace_packet=self._packet,
            trace_pdu=self._pdu,
        )

    async def exchange(self, call: Call, send: Send) -> ModbusPDU:
        """Send one request of this call and return its reply.

        Raises:
            ModbusException: there is no reply that pymodbus understands.
            BadReply: the reply does not belong to the request.
            TimeoutError: the connection ended, or another frame than the reply came. pymodbus would wait for the reply until
                its own timeout.
        """
        self._call, self.request, self.received, self.answered = call, None, b"", False
        try:
            async with asyncio.timeout(None) as self._patience:
                pdu = await send(self.client)
        finally:
            self._call = None
        assert self.request is not None
        reply_pdu(self.request, self.received)
        return pdu

    def _connect(self, connected: bool) -> None:
        if connected:
            return
        self.lost = True
        if self._call is not None and not self.answered:
            self._give_up()

    def _give_up(self) -> None:
        if self._patience.when() is None:
            self._patience.reschedule(0.0)

    def _packet(self, sending: bool, data: bytes) -> bytes:
        # pymodbus shows every byte that goes to the transport: the trace has what was on the wire, not what was asked.
        if not sending:
            self.received = data
            if self._call is not None and self.request is not None and is_other_reply(self.request, data):
                self._give_up()
        elif self._call is not None:
            self.request, facts = request_facts(data)
            trace = self._call.trace
            trace.update(facts)
            trace.setdefault("transaction_ids", []).append(self.request.transaction)
            self._call.sending()
            trace["pdus"] = self._call.attempts
        return data

    def _pdu(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        self.answered = not sending
        return pdu


class Link:
    """One TCP connection at a time to a Modbus device or gateway.

    Args:
        host, port: address of the device.
        timeout_s: seconds for connecting, and for each exchange.
    """

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self._host = host
        self._port = port
        self._timeout_s = timeout_s
        self._lock = asyncio.Lock()
        self._connection: _Connection | None = None
        self._generation = 0

    async def exchange(self, call: Call, send: Send) -> ModbusPDU:
        """Send one request and return its reply, after checking that the reply belongs to this request.

        A read that finds the connection dead is repeated once over a new one. A write is not: once its bytes may have
        left, only the device knows whether it was executed.

        Raises:
            AdapterError: no connection, no reply, a reply that does not belong to the request, or an exception reply.
        """
        async with self._lock:
            try:
                try:
                    return await self._attempt(call, send)
                except _ConnectionDied:
                    if call.sent:
                        raise
                    return await self._attempt(call, send)
            except _ConnectionDied:
                raise AdapterError("connection_lost", "the connection broke during the call") from None

    async def _attempt(self, call: Call, send: Send) -> ModbusPDU:
        connection = await self._connected(call)
        try:
            pdu = await connection.exchange(call, send)
        except (ModbusException, TimeoutError, BadReply, asyncio.CancelledError) as error:
            # A late reply to this request must not be taken for the reply to the next one.
            self._drop()
            call.disconnected()
            if isinstance(error, asyncio.CancelledError):
                raise
            raise self._explained(connection, error) from None
        call.answered()
        return _accepted(call, pdu)

    def _explained(self, connection: _Connection, error: Exception) -> Exception:
        if isinstance(error, BadReply):
            return AdapterError("protocol_error", f"the reply is not the one to the request: {error}")
        if connection.received:
            return AdapterError("protocol_error", "what the device sent is no valid reply to the request")
        if connection.lost:
            return _ConnectionDied()
        return AdapterError("timeout", f"the device did not reply within {self._timeout_s:g} s")

    async def _connected(self, call: Call) -> _Connection:
        existing = self._connection
        if existing is not None and existing.client.connected and not existing.lost:
            call.connection(generation=self._generation, fresh=False)
            return existing
        self._drop()
        call.disconnected()
        await resolve(self._host, self._port)
        connection = _Connection(self._host, self._port, self._timeout_s)
        try:
            made = await connection.client.connect()
        except asyncio.CancelledError:
            connection.client.close()
            raise
        if not made:
            connection.client.close()
            message = f"no connection to {self._host}:{self._port}; is the device on, and is the address right?"
            raise AdapterError("connect_failed", message, outcome="not_sent")
        self._connection = connection
        self._generation += 1
        call.connection(generation=self._generation, fresh=True)
        return connection

    def _drop(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.client.close()

    async def close(self) -> None:
        """Close the connection."""
        self._drop()


def _accepted(call: Call, pdu: ModbusPDU) -> ModbusPDU:
    if not pdu.isError():
        return pdu
    code = int(getattr(pdu, "exception_code", 0))
    call.trace["exception_code"] = code
    error, outcome, meaning = _EXCEPTIONS.get(code, ("protocol_error", "unknown", "unknown exception code"))
    raise AdapterError(error, f"{meaning} (exception {code:02X})", outcome=outcome if call.writes else "not_applicable")
