"""Variables of a read or write job: their addresses, and their bytes in the controller's memory."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from pytest_otmcp.wire.s7 import SUCCESS, Variable

from .image import OPTIMIZED, PROTECTED, Plant

__all__ = ["read_answer", "store"]

ACCESS_DENIED, ADDRESS_OUT_OF_RANGE, TYPE_NOT_SUPPORTED, TYPE_INCONSISTENT, NO_SUCH_OBJECT = 3, 5, 6, 7, 0x0A

BIT = 1
_WIDTHS = {BIT: 1, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 4, 8: 4}
"""Transport size of an address (BIT, BYTE, CHAR, WORD, INT, DWORD, DINT, REAL) to bytes of one element."""
_CARRIED_AS = {BIT: 3, 2: 4, 3: 9, 4: 4, 5: 5, 6: 4, 7: 5, 8: 7}
"""Transport size of an address to that of its data."""
_AREAS = {0x81: "I", 0x82: "Q", 0x83: "M"}
_DATA_BLOCK = 0x84


def _place(variable: Variable) -> str:
    """Return the name of the area, or the number that stands for none."""
    known = f"DB{variable.db}" if variable.area == _DATA_BLOCK else _AREAS.get(variable.area)
    return known or f"area {variable.area:02X}"


def _size(variable: Variable) -> int:
    """Return the number of bytes of a variable."""
    return _WIDTHS.get(variable.transport, 0) * variable.count


def _fault(plant: Plant, variable: Variable) -> int:
    """Return the code with which a variable is refused; :data:`~pytest_otmcp.wire.s7.SUCCESS` if it can be used."""
    place = _place(variable)
    if variable.transport not in _WIDTHS:
        return TYPE_NOT_SUPPORTED
    if place == PROTECTED:
        return ACCESS_DENIED
    if place == OPTIMIZED:
        return ADDRESS_OUT_OF_RANGE
    if place not in plant.areas:
        return NO_SUCH_OBJECT
    whole = variable.count == 1 if variable.transport == BIT else variable.count >= 1 and variable.address % 8 == 0
    if not whole or variable.address // 8 + _size(variable) > len(plant.areas[place]):
        return ADDRESS_OUT_OF_RANGE
    return SUCCESS


def read_answer(
    plant: Plant, asked: Sequence[Variable], forced: int | None, instead: bytes | None, longer: int
) -> bytes:
    """Return the data of the answer to a read.

    Args:
        forced: code for every variable instead of its own.
        instead: bytes for every variable instead of its own.
        longer: added to the length that is told.
    """
    parts = []
    for variable in asked:
        code = _fault(plant, variable) if forced is None else forced
        if code != SUCCESS:
            parts.append(bytes([code, 0, 0, 0]))
            continue
        content = _held(plant, variable) if instead is None else instead
        transport = _CARRIED_AS[variable.transport]
        length = len(content) * (8 if transport in (4, 5) else 1)
        header = struct.pack(">BBH", SUCCESS, transport, (length + longer) & 0xFFFF)
        parts.append(header + content)
    return b"".join(part + bytes(len(part) % 2) for part in parts[:-1]) + parts[-1]


def _held(plant: Plant, variable: Variable) -> bytes:
    area, first = plant.areas[_place(variable)], variable.address // 8
    if variable.transport == BIT:
        return bytes([area[first] >> variable.address % 8 & 1])
    return bytes(area[first : first + _size(variable)])


def store(plant: Plant, variable: Variable, transport: int, content: bytes, *, apply: bool) -> int:
    """Write a variable; return its code."""
    code = _fault(plant, variable)
    if code != SUCCESS:
        return code
    if transport != _CARRIED_AS[variable.transport] or len(content) != _size(variable):
        return TYPE_INCONSISTENT
    if apply:
        area, first = plant.areas[_place(variable)], variable.address // 8
        if variable.transport == BIT:
            mask = 1 << variable.address % 8
            area[first] = area[first] | mask if content[0] & 1 else area[first] & ~mask & 0xFF
        else:
            area[first : first + _size(variable)] = content
    return SUCCESS
