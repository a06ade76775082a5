"""The Modbus TCP server (MODBUS Messaging on TCP/IP V1.0b) with journal and fault plan.

It is not a library's server, because a reference must not lose pipelined requests, mix up transaction identifiers or
serve cells that do not exist, and the journal needs the connection and the bytes.
"""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Mapping
from functools import partial
from typing import Any

from ..device import Device
from ..endpoint import OpenEndpoint
from ..journal import Direction
from ..peer import process_of
from .faults import FaultPlan, Rule
from .image import UnitImage, poke
from .pdu import READS, IllegalRequest, describe, execute, read_response, values_read

__all__ = ["ModbusDevice"]

GATEWAY_TARGET_FAILED_TO_RESPOND = 0x0B
_MAX_LENGTH = 254
"""Largest value of the MBAP length field: unit identifier and a PDU of 253 bytes."""
_GARBAGE = b"\xde\xad\xbe\xef\xff\xff\x00\x01"


class ModbusDevice(Device):
    """A device with unit 1; a request to any other unit gets the gateway exception 0B and changes nothing."""

    protocol = "modbus"

    def __init__(self) -> None:
        super().__init__()
        self.units = {1: UnitImage()}
        self.faults = FaultPlan([])
        self._server: asyncio.Server | None = None
        self.connections = 0

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        listener = endpoints["modbus"]
        assert isinstance(listener, socket.socket)
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Connection(self), sock=listener, backlog=128)

    async def aclose(self) -> None:
        if self._server is not None:
            self._server.close()

    def image(self) -> dict[str, Any]:
        """Return ``units``: unit to table to list of cells; and ``points``, such as ``1/holding_registers/30``."""
        units = {str(number): unit.dump() for number, unit in self.units.items()}
        points = {
            f"{number}/{table}/{address}": cell
            for number, tables in units.items()
            for table, cells in tables.items()
            for address, cell in enumerate(cells)
        }
        return {"units": units, "points": points}

    async def poke(self, params: Mapping[str, Any]) -> None:
        poke(self.units, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.units = {1: UnitImage()}
        self.faults = FaultPlan([])

    async def tick(self) -> None:
        for unit in self.units.values():
            unit.tick()


class _Connection(asyncio.Protocol):
    """One client's connection. Requests are answered in order; a segment may hold several, or a part of one."""

    def __init__(self, device: ModbusDevice) -> None:
        self._device = device
        self._buffer = bytearray()
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._device.connections += 1
        self._number = self._device.connections
        peer = transport.get_extra_info("peername")[1]
        self._device.journal.connected(self._number, process_of(transport), peer=peer)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._buffer:
            self._malformed("the connection ended inside a frame")
        self._record("in", "DISCONNECTED")

    def pause_writing(self) -> None:
        # No more requests are read from a client that does not read its answers: the answers must not accumulate.
        self._transport.pause_reading()

    def resume_writing(self) -> None:
        self._transport.resume_reading()

    def _malformed(self, reason: str) -> None:
        self._record("in", "malformed", bytes=bytes(self._buffer[:300]).hex(), reason=reason)
        self._buffer.clear()

    def _record(self, direction: Direction, kind: str, **fields: Any) -> int:
        return self._device.journal.append(connection=self._number, direction=direction, kind=kind, **fields)

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        while len(self._buffer) >= 6 and not self._transport.is_closing():
            transaction, protocol, length = struct.unpack_from(">HHH", self._buffer)
            if protocol != 0 or not 2 <= length <= _MAX_LENGTH:
                # The beginning of the next frame can no longer be known. The guide (section 4.4.2.2) silently discards
                # such a frame; a witness drops the connection, so that the frame is not overlooked.
                self._malformed(f"MBAP header: protocol {protocol}, length {length}")
                self._transport.abort()
                return
            if len(self._buffer) < 6 + length:
                return
            unit = self._buffer[6]
            pdu = bytes(self._buffer[7 : 6 + length])
            del self._buffer[: 6 + length]
            self._request(transaction, unit, pdu)

    def _request(self, transaction: int, unit: int, pdu: bytes) -> None:
        fields = describe(pdu)
        asked = self._record(
            "in", "request", request=True, unit=unit, transaction_id=transaction, **fields, pdu=pdu.hex()
        )
        rule = self._device.faults.match(unit, fields)
        memory = self._device.units.get(unit)
        try:
            if memory is None:
                raise IllegalRequest(GATEWAY_TARGET_FAILED_TO_RESPOND)
            if rule is not None and rule.exception is not None:
                raise IllegalRequest(rule.exception)
            response = execute(memory, pdu, apply=rule is None or not rule.ack_only)
        except IllegalRequest as refusal:
            response = bytes([pdu[0] | 0x80, refusal.code])
        if rule is None:
            self._send(asked, fields, transaction, unit, response)
        else:
            self._misbehave(rule, asked, fields, transaction, unit, response)

    def _send(
        self,
        asked: int,
        request: Mapping[str, Any],
        transaction: int,
        unit: int,
        response: bytes,
        cut: int | None = None,
    ) -> None:
        """Answer the request that has the sequence number ``asked``."""
        if self._transport.is_closing():
            return
        frame = struct.pack(">HHHB", transaction, 0, len(response) + 1, unit) + response
        fields: dict[str, Any] = {
            "unit": unit,
            "transaction_id": transaction,
            "function": response[0] & 0x7F,
            "exception": response[1] if response[0] & 0x80 else None,
        }
        values = values_read(request, response)
        if values is not None:
            fields["values"] = values
        if cut is not None:
            fields["truncate"] = cut
        self._record("out", "response", answers=asked, **fields, pdu=response.hex())
        self._transport.write(frame[:cut])

    def _misbehave(
        self, rule: Rule, asked: int, request: Mapping[str, Any], transaction: int, unit: int, response: bytes
    ) -> None:
        if rule.drop:
            return
        if rule.close:
            self._transport.close()
            return
        if rule.reset:
            # With SO_LINGER 0 the kernel sends RST instead of FIN.
            sock = self._transport.get_extra_info("socket")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._transport.abort()
            return
        if rule.garbage:
            # The entry answers no request: no client can tell which request the bytes are for.
            self._record("out", "garbage", bytes=_GARBAGE.hex())
            self._transport.write(_GARBAGE)
            return
        if rule.answer_values is not None and response[0] in READS:
            response = read_response(response[0], rule.answer_values)
        send = partial(
            self._send,
            asked,
            request,
            (transaction + rule.transaction_id) & 0xFFFF,
            unit if rule.answer_unit is None else rule.answer_unit,
            response,
            rule.truncate,
        )
        if rule.delay_s:
            asyncio.get_running_loop().call_later(rule.delay_s, send)
        else:
            send()
