"""The Modbus TCP server (MODBUS Messaging on TCP/IP V1.0b) with journal and fault plan.

It is not a library's server, because a reference must not lose pipelined requests, mix up transaction identifiers or
serve cells that do not exist, and the journal needs the connection and the bytes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

from pytest_otmcp.wire.modbus import (
    HEADER,
    MASK_WRITE,
    WRITE_REGISTER,
    WRITE_REGISTERS,
    frame,
    mbap_length,
    request_fields,
)

from ..framed_connection import FramedConnection
from ..tcp_device import TcpDevice
from .answers import falsified
from .faults import FaultPlan
from .image import UnitImage
from .pdu import IllegalRequest, execute
from .pokes import Restless, poke_cells, poke_identification, poke_size, poke_units, restless_cells

__all__ = ["ModbusDevice"]

GATEWAY_TARGET_FAILED_TO_RESPOND = 0x0B


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
        self.network.restored()

    async def tick(self) -> None:
        for unit in self.units.values():
            unit.tick()

    def stir(self, unit: int) -> None:
        """Change the cells of a unit that change by themselves."""
        for cell in self.restless:
            if cell.unit == unit and unit in self.units:
                cell.move(self.units[unit])


class _Connection(FramedConnection[ModbusDevice]):
    """One client's connection. Requests are answered in order."""

    def __init__(self, device: ModbusDevice) -> None:
        super().__init__(device, mbap_length)

    def frame(self, raw: bytes) -> None:
        (transaction, _, _, unit), pdu = HEADER.unpack_from(raw), raw[HEADER.size :]
        fields = request_fields(pdu)
        rule = self.device.faults.match(unit, fields)
        asked = self.received(raw, rule)
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        self.device.stir(unit)
        memory = self.device.units.get(unit)
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
            self.send(frame(transaction, unit, response), asked)
        else:
            self.misbehave(rule, partial(self.send, falsified(rule, transaction, unit, response), asked, rule))


def _clamp(memory: UnitImage, request: Mapping[str, Any], bounds: tuple[int, int]) -> None:
    """Bring the registers that a request has written between two bounds."""
    if request["function"] not in (WRITE_REGISTER, WRITE_REGISTERS, MASK_WRITE):
        return
    for address in range(request["address"], request["address"] + request["quantity"]):
        memory.holding_registers[address] = min(max(memory.holding_registers[address], bounds[0]), bounds[1])
