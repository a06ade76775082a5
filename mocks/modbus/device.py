"""The Modbus TCP server (MODBUS Messaging on TCP/IP V1.0b) with journal and fault plan.

It is not a library's server, because a reference must not lose pipelined requests, mix up transaction identifiers or
serve cells that do not exist, and the journal needs the connection and the bytes.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

from ..journal import Direction
from ..network import Link
from ..peer import process_of
from ..tcp_device import TcpDevice
from .answers import Answer, falsified
from .faults import FaultPlan, Rule
from .image import UnitImage
from .pdu import MASK_WRITE, WRITE_REGISTER, WRITE_REGISTERS, IllegalRequest, describe, execute, values_read
from .pokes import Restless, poke_cells, poke_identification, poke_size, poke_units, restless_cells

__all__ = ["ModbusDevice"]

GATEWAY_TARGET_FAILED_TO_RESPOND = 0x0B
_MAX_LENGTH = 254
"""Largest value of the MBAP length field: unit identifier and a PDU of 253 bytes."""
_GARBAGE = b"\xde\xad\xbe\xef\xff\xff\x00\x01"


class ModbusDevice(TcpDevice):
    """A device with unit 1; a request to any other unit gets the gateway exception 0B and changes nothing."""

    protocol = "modbus"

    def __init__(self) -> None:
        super().__init__()
        self.units = {1: UnitImage()}
        self.faults = FaultPlan([])
        self.restless: list[Restless] = []

    def connection(self) -> asyncio.Protocol:
        return _Connection(self)

    def image(self) -> dict[str, Any]:
        """Return ``units``: unit to table to list of cells; and ``points``, such as ``1/holding_registers/30``.
        With cells that change by themselves also ``restless``: those cells, and how often each has changed."""
        units = {str(number): unit.dump() for number, unit in self.units.items()}
        points = {
            f"{number}/{table}/{address}": cell
            for number, tables in units.items()
            for table, cells in tables.items()
            for address, cell in enumerate(cells)
        }
        image = {"units": units, "points": points}
        return image | ({"restless": [asdict(cell) for cell in self.restless]} if self.restless else {})

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the device past the protocol: see :mod:`.pokes`, and :mod:`..network` for ``{"network": …}``."""
        if self.network.poke(params):
            return
        if "units" in params:
            poke_units(self.units, params["units"])
        elif "cells" in params:
            poke_size(self.units, params)
        elif "identification" in params:
            poke_identification(self.units, params)
        elif "restless" in params:
            self.restless = restless_cells(self.units, params["restless"])
        else:
            poke_cells(self.units, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.units = {1: UnitImage()}
        self.faults = FaultPlan([])
        self.restless = []
        self.network.become("open")

    async def tick(self) -> None:
        for unit in self.units.values():
            unit.tick()

    def stir(self, unit: int) -> None:
        """Change the cells of a unit that change by themselves."""
        for cell in self.restless:
            if cell.unit == unit and unit in self.units:
                cell.move(self.units[unit])


class _Connection(asyncio.Protocol):
    """One client's connection. Requests are answered in order; a segment may hold several, or a part of one."""

    def __init__(self, device: ModbusDevice) -> None:
        self._device = device
        self._buffer = bytearray()
        self._transport: Link

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, Link)
        self._transport = transport
        self._device.connections += 1
        self._number = transport.number = self._device.connections
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
        rule = self._device.faults.match(unit, fields)
        asked = self._record(
            "in",
            "request",
            request=True,
            unit=unit,
            transaction_id=transaction,
            **fields,
            pdu=pdu.hex(),
            **({} if rule is None else {"fault": rule.action}),
        )
        if rule is not None and rule.manner.half_open:
            self._transport.die()
            return
        self._device.stir(unit)
        memory = self._device.units.get(unit)
        try:
            if memory is None:
                raise IllegalRequest(GATEWAY_TARGET_FAILED_TO_RESPOND)
            if rule is not None and rule.exception is not None:
                raise IllegalRequest(rule.exception)
            response = execute(memory, pdu, apply=rule is None or not rule.ack_only)
            if rule is not None and rule.clamp is not None and not rule.ack_only:
                _clamp(memory, fields, rule.clamp)
        except IllegalRequest as refusal:
            response = bytes([pdu[0] | 0x80, refusal.code])
        if rule is None:
            self._send(asked, fields, Answer.to(transaction, unit, response))
        else:
            self._misbehave(rule, asked, fields, transaction, unit, response)

    def _send(self, asked: int, request: Mapping[str, Any], answer: Answer, rule: Rule | None = None) -> None:
        """Answer the request that has the sequence number ``asked``, in the manner of a rule."""
        if self._transport.is_closing() or not self._transport.carries():
            return
        response = answer.pdu
        fields: dict[str, Any] = {
            "unit": answer.unit,
            "transaction_id": answer.transaction,
            "function": response[0] & 0x7F,
            "exception": response[1] if response[0] & 0x80 else None,
        }
        values = values_read(request, response)
        if values is not None:
            fields["values"] = values
        cut = None
        if rule is not None:
            cut = rule.truncate
            changed = {"truncate": cut, "protocol_id": answer.protocol or None, "drip_s": rule.manner.drip_s or None}
            fields |= {name: value for name, value in changed.items() if value is not None}
            if rule.length:
                fields["length"] = answer.length
        if rule is None or rule.manner.mangle is None:
            self._record("out", "response", answers=asked, **fields, pdu=response.hex())
        if rule is None:
            self._transport.write(answer.frame())
            return
        with self._transport.sending(rule.manner):
            self._transport.write(answer.frame()[:cut])
        if rule.manner.duplicate:
            self._record("out", "response", answers=asked, **fields, duplicate=True, pdu=response.hex())
            with self._transport.sending(rule.manner):
                self._transport.write(answer.frame()[:cut])

    def _misbehave(
        self, rule: Rule, asked: int, request: Mapping[str, Any], transaction: int, unit: int, response: bytes
    ) -> None:
        if rule.drop:
            return
        if rule.close:
            self._transport.close()
            return
        if rule.reset:
            self._transport.reset()
            return
        if rule.garbage and self._transport.carries():
            # The entry answers no request: no client can tell which request the bytes are for.
            self._record("out", "garbage", bytes=_GARBAGE.hex())
            self._transport.write(_GARBAGE)
        if rule.garbage:
            return
        send = partial(self._send, asked, request, falsified(rule, transaction, unit, response), rule)
        if rule.delay_s:
            asyncio.get_running_loop().call_later(rule.delay_s, send)
        else:
            send()


def _clamp(memory: UnitImage, request: Mapping[str, Any], bounds: tuple[int, int]) -> None:
    """Bring the registers that a request has written between two bounds."""
    if request["function"] not in (WRITE_REGISTER, WRITE_REGISTERS, MASK_WRITE):
        return
    for address in range(request["address"], request["address"] + request["quantity"]):
        memory.holding_registers[address] = min(max(memory.holding_registers[address], bounds[0]), bounds[1])
