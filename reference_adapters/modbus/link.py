"""The connection to the device.

By default pymodbus sends a write again three times and reconnects by itself. Here ``retries`` and ``reconnect_delay`` are 0, and
:class:`~..core.DeviceLink` makes both decisions, because it knows whether bytes have left.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Awaitable, Callable

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from ..core import AdapterError, Call, DeviceLink, Lost, handshake_failure
from .wire import Frame, is_other_reply, reply_pdu, request_facts

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


_NOT_AUTHORISED = 1
"""Over TLS the exception of a function that a device does not offer also says that it refuses it to the role of the certificate (MODBUS/TCP
Security Protocol Specification)."""


class _Connection:
    """One TCP connection, in clear or over TLS, and the bytes of its present exchange.

    Attributes:
        used: something was answered.
        failure: why there is no connection, or why it has ended unused.
    """

    def __init__(self, host: str, port: int, timeout_s: float, tls: ssl.SSLContext | None) -> None:
        self.lost = False
        self.failure: Exception | None = None
        self.used = False
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
        if tls is not None:
            self._secure(host, port, tls)

    def _secure(self, host: str, port: int, tls: ssl.SSLContext) -> None:
        """Let the client connect over TLS, with the frames of Modbus TCP (MODBUS/TCP Security Protocol Specification, section 4).

        pymodbus' own client for TLS takes one record for one frame, and tells of a failed handshake only that there is no connection.
        """
        protocol = self.client.ctx
        ended = protocol.connection_lost

        def note(exc: Exception | None) -> None:
            # With TLS 1.3 a device that refuses this side's certificate says so when the connection is open already.
            if not self.used:
                self.failure = exc
            ended(exc)

        async def connect() -> tuple[asyncio.BaseTransport, asyncio.BaseProtocol]:
            try:
                return await asyncio.get_running_loop().create_connection(
                    protocol.handle_new_connection, host, port, ssl=tls, server_hostname=host
                )
            except OSError as error:
                self.failure = error
                raise

        protocol.connection_lost = note  # type: ignore[method-assign]
        protocol.call_create = connect

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
            self._call.sending()
            trace = self._call.trace
            trace.update(facts)
            trace.setdefault("transaction_ids", []).append(self.request.transaction)
            trace["pdus"] = self._call.attempts
        return data

    def _pdu(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        self.answered = not sending
        self.used = self.used or self.answered
        return pdu


class Link(DeviceLink[_Connection]):
    """One TCP connection at a time to a Modbus device or gateway."""

    failures = (ModbusException,)

    async def exchange(self, call: Call, send: Send) -> ModbusPDU:
        """Send one request and return its reply, after checking that the reply belongs to this request.

        Raises:
            AdapterError: no connection, no reply, a reply that does not belong to the request, or an exception reply.
        """
        pdu = await self.perform(call, lambda connection: connection.exchange(call, send))
        return _accepted(call, pdu, secure=self._tls is not None)

    def _explained(self, call: Call, connection: _Connection, error: Exception) -> Exception:
        if isinstance(connection.failure, ssl.SSLError) and (
            refused := handshake_failure(connection.failure, self.peer)
        ):
            return refused
        if isinstance(error, OSError | ModbusException):
            if connection.received:
                return AdapterError("protocol_error", "what the device sent is no valid reply to the request")
            # pymodbus raises the same for silence and for the end of a connection.
            error = Lost() if connection.lost else TimeoutError()
        return super()._explained(call, connection, error)

    async def _open(self) -> _Connection:
        connection = _Connection(self._host, self._port, self._timeout_s, self._tls)
        try:
            if await connection.client.connect():
                return connection
            raise connection.failure or OSError
        except BaseException:
            connection.client.close()
            raise

    def _is_usable(self, connection: _Connection) -> bool:
        return connection.client.connected and not connection.lost

    def _end(self, connection: _Connection) -> None:
        connection.client.close()


def _accepted(call: Call, pdu: ModbusPDU, *, secure: bool) -> ModbusPDU:
    if not pdu.isError():
        return pdu
    code = int(getattr(pdu, "exception_code", 0))
    call.trace["exception_code"] = code
    error, outcome, meaning = _EXCEPTIONS.get(code, ("protocol_error", "unknown", "unknown exception code"))
    details = None
    if secure and code == _NOT_AUTHORISED:
        error, meaning, details = "access_denied", "the device refuses this function to the role", {"by": "device"}
    raise AdapterError(
        error,
        f"{meaning} (exception {code:02X})",
        outcome=outcome if call.writes else "not_applicable",
        details=details,
    )
