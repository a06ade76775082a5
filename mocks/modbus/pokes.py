"""What can be changed at the device past the protocol: cells, units, identification, cells that change by themselves.

==================  ====================================================================================================
``table``           ``{"unit": 1, "table": "coils", "address": 3, "values": [true]}`` sets cells
``units``           ``{"units": [1, 2, 17, 247, 255]}``: the units that there are from now on. One that existed keeps its cells;
                    a new one has the plant of unit 1, and from address 10 on other contents than every other unit: registers
                    hold 100 times the unit and the address, bits those of the unit's number, over and over
``cells``           ``{"unit": 1, "cells": 65536}``: so many cells has every table of the unit from now on, up to the last address;
                    the new ones hold 0. The image then has all of them
``identification``  ``{"unit": 1, "identification": {"0": base64, "128": base64}}``: objects of Read Device Identification by
                    object id, of any bytes; null removes one
``restless``        ``{"restless": [{"unit": 1, "table", "address", "change": "increment" or "toggle", "bits": 0xFFFE}]}``: cells
                    that change by themselves just before each request to their unit is executed, so between any two requests.
                    An increment shows how often somebody asked. A toggle turns the bits of a register (all, without ``bits``), or
                    a coil or discrete input. The list takes the place of the one before; the image counts the ``changes``
==================  ====================================================================================================
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..fault_rules import integer
from .image import SIZE, TABLES, UnitImage

__all__ = ["Restless", "poke_cells", "poke_identification", "poke_size", "poke_units", "restless_cells"]

_UNIT = integer(0, 0xFF)
_ADDRESSES = 0x10000
_FREE = 10
"""First address whose cells have no meaning in the plant."""


@dataclass(slots=True, kw_only=True)
class Restless:
    """A cell that changes by itself.

    Attributes:
        bits: of a register, those that a toggle turns.
        changes: how often it has changed.
    """

    unit: int
    table: str
    address: int
    change: str
    bits: int
    changes: int = 0

    def move(self, memory: UnitImage) -> None:
        """Change the cell once."""
        cells = memory.table(self.table)
        held = cells[self.address]
        if isinstance(held, bool):
            cells[self.address] = not held
        elif self.change == "toggle":
            cells[self.address] = held ^ self.bits
        else:
            cells[self.address] = (held + 1) & 0xFFFF
        self.changes += 1


def poke_cells(units: Mapping[int, UnitImage], params: Mapping[str, Any]) -> None:
    """Set cells: unit (default 1), table, address, values.

    Raises:
        ValueError: no such cell or value.
        KeyError: a parameter is missing.
    """
    unit, table, address, values = params.get("unit", 1), params["table"], params["address"], params["values"]
    if type(address) is not int or not isinstance(values, list):
        raise ValueError(f"a poke has an integer address and a list of values, found {address!r} and {values!r}")
    _memory(units, unit).poke(table, address, values)


def poke_units(units: dict[int, UnitImage], numbers: Any) -> None:
    """Change the units that there are.

    Raises:
        ValueError: this is no list of unit identifiers.
    """
    if not isinstance(numbers, list) or not numbers or not all(map(_UNIT.accepts, numbers)):
        raise ValueError(f"units: expected a list of integers from 0 to 255, found {numbers!r}")
    kept = {number: units.get(number) or _other(number) for number in numbers}
    units.clear()
    units.update(kept)


def poke_size(units: Mapping[int, UnitImage], params: Mapping[str, Any]) -> None:
    """Give the tables of a unit more cells.

    Raises:
        ValueError: no such unit or number.
    """
    memory, size = _memory(units, params.get("unit", 1)), params["cells"]
    if type(size) is not int or not memory.size <= size <= _ADDRESSES:
        raise ValueError(f"cells: expected an integer from {memory.size} to {_ADDRESSES}, found {size!r}")
    memory.enlarge(size)


def _other(number: int) -> UnitImage:
    """Return the memory of a unit that differs from every other unit's."""
    memory = UnitImage()
    for address in range(_FREE, SIZE):
        memory.holding_registers[address] = memory.input_registers[address] = 100 * number + address
        memory.coils[address] = memory.discrete_inputs[address] = bool(number >> (address % 8) & 1)
    return memory


def poke_identification(units: Mapping[int, UnitImage], params: Mapping[str, Any]) -> None:
    """Change objects of the identification.

    Raises:
        ValueError: no such unit, object id or value.
    """
    objects = params["identification"]
    memory = _memory(units, params.get("unit", 1))
    if not isinstance(objects, Mapping):
        raise ValueError(f"identification: expected an object, found {objects!r}")
    changed = dict(memory.identification)
    for name, text in objects.items():
        if not name.isdecimal() or int(name) > 0xFF:
            raise ValueError(f"identification: expected object ids from 0 to 255, found {name!r}")
        if text is None:
            changed.pop(int(name), None)
            continue
        try:
            content = base64.b64decode(text, validate=True)
        except (binascii.Error, TypeError, ValueError):
            raise ValueError(f"identification: object {name} is no base64: {text!r}") from None
        if len(content) > 244:
            raise ValueError(f"identification: object {name} has {len(content)} bytes, and 244 fit into an answer")
        changed[int(name)] = content
    memory.identification = changed


def restless_cells(units: Mapping[int, UnitImage], sources: Any) -> list[Restless]:
    """Return the cells that a poke wants to change by themselves.

    Raises:
        ValueError: no such cell or change.
    """
    if not isinstance(sources, list) or not all(isinstance(source, Mapping) for source in sources):
        raise ValueError(f"restless: expected a list of objects, found {sources!r}")
    return [_restless(units, source) for source in sources]


def _restless(units: Mapping[int, UnitImage], source: Mapping[str, Any]) -> Restless:
    known = {"unit", "table", "address", "change", "bits"}
    if source.keys() - known:
        raise ValueError(
            f"restless: unknown members {sorted(source.keys() - known)}; known are {', '.join(sorted(known))}"
        )
    cell = Restless(
        unit=source.get("unit", 1),
        table=source.get("table", "holding_registers"),
        address=source["address"],
        change=source.get("change", "increment"),
        bits=source.get("bits", 0xFFFF),
    )
    memory = _memory(units, cell.unit)
    bits = cell.table in ("coils", "discrete_inputs")
    if cell.table not in TABLES or not integer(0, memory.size - 1).accepts(cell.address):
        raise ValueError(f"restless: there is no cell {cell.table} {cell.address!r}")
    if cell.change not in ("toggle",) + (() if bits else ("increment",)) or not integer(1, 0xFFFF).accepts(cell.bits):
        raise ValueError(f"restless: {cell.table} cannot change by {cell.change!r} with the bits {cell.bits!r}")
    return cell


def _memory(units: Mapping[int, UnitImage], unit: Any) -> UnitImage:
    if type(unit) is not int or unit not in units:
        raise ValueError(f"unit {unit} is not configured; configured are {', '.join(map(str, units))}")
    return units[unit]
