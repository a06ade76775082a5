"""Variables of a read or write job: their addresses, and their bytes in the controller's memory."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .image import OPTIMIZED, PROTECTED, Plant

__all__ = [
    "ADDRESS_OUT_OF_RANGE",
    "NO_SUCH_OBJECT",
    "SUCCESS",
    "Variable",
    "read_answer",
    "store",
    "variables",
    "written_data",
]

SUCCESS = 0xFF
ACCESS_DENIED, ADDRESS_OUT_OF_RANGE, TYPE_NOT_SUPPORTED, TYPE_INCONSISTENT, NO_SUCH_OBJECT = 3, 5, 6, 7, 0x0A

BIT = 1
_WIDTHS = {BIT: 1, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 4, 8: 4}
"""Transport size of an address (BIT, BYTE, CHAR, WORD, INT, DWORD, DINT, REAL) to bytes of one element."""
_CARRIED_AS = {BIT: 3, 2: 4, 3: 9, 4: 4, 5: 5, 6: 4, 7: 5, 8: 7}
"""Transport size of an address to that of its data."""
_IN_BITS = {3, 4, 5}
"""Transport sizes of data whose length is told in bits; others in bytes."""
_AREAS = {0x81: "I", 0x82: "Q", 0x83: "M"}
_DATA_BLOCK = 0x84
_ANY_POINTER = bytes([0x12, 0x0A, 0x10])


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """One variable as a job addresses it: an S7 ANY pointer.

    Attributes:
        transport: type of the elements.
        count: number of elements.
        db: number of the data block, 0 for other areas.
        area: number of the area.
        address: of the first bit.
    """

    transport: int
    count: int
    db: int
    area: int
    address: int

    @property
    def place(self) -> str:
        """Name of the area, or the number that stands for none."""
        return f"DB{self.db}" if self.area == _DATA_BLOCK else _AREAS.get(self.area, f"area {self.area:02X}")

    @property
    def size(self) -> int:
        """Number of bytes."""
        return _WIDTHS.get(self.transport, 0) * self.count

    def described(self) -> dict[str, Any]:
        """Return the members that the journal has of it."""
        return {
            "area": self.area,
            "db": self.db,
            "byte": self.address // 8,
            "bit": self.address % 8,
            "transport": self.transport,
            "count": self.count,
        }

    def fault(self, plant: Plant) -> int:
        """Return the code with which this variable is refused; :data:`SUCCESS` if it can be used."""
        if self.transport not in _WIDTHS:
            return TYPE_NOT_SUPPORTED
        if self.place == PROTECTED:
            return ACCESS_DENIED
        if self.place == OPTIMIZED:
            return ADDRESS_OUT_OF_RANGE
        if self.place not in plant.areas:
            return NO_SUCH_OBJECT
        whole = self.count == 1 if self.transport == BIT else self.count >= 1 and self.address % 8 == 0
        if not whole or self.address // 8 + self.size > len(plant.areas[self.place]):
            return ADDRESS_OUT_OF_RANGE
        return SUCCESS


def variables(parameters: bytes) -> list[Variable] | None:
    """Return the variables of a job's parameters; None where these are no list of ANY pointers."""
    if len(parameters) < 2 or len(parameters) != 2 + 12 * parameters[1] or not parameters[1]:
        return None
    found = []
    for start in range(2, len(parameters), 12):
        if parameters[start : start + 3] != _ANY_POINTER:
            return None
        transport, count, db, area = struct.unpack_from(">BHHB", parameters, start + 3)
        address = int.from_bytes(parameters[start + 9 : start + 12])
        found.append(Variable(transport=transport, count=count, db=db, area=area, address=address))
    return found


def written_data(asked: Sequence[Variable], data: bytes) -> list[tuple[int, bytes]] | None:
    """Return transport size and bytes for each variable of a write; None where the data does not add up.

    Data of an odd length is padded to an even one, except for the last.
    """
    found: list[tuple[int, bytes]] = []
    for number in range(len(asked)):
        if len(data) < 4:
            return None
        transport, length = data[1], int.from_bytes(data[2:4])
        size = (length + 7) // 8 if transport in _IN_BITS else length
        if len(data) < 4 + size:
            return None
        found.append((transport, data[4 : 4 + size]))
        data = data[4 + size + (size % 2 if number < len(asked) - 1 else 0) :]
    return None if data else found


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
        code = variable.fault(plant) if forced is None else forced
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
    area, first = plant.areas[variable.place], variable.address // 8
    if variable.transport == BIT:
        return bytes([area[first] >> variable.address % 8 & 1])
    return bytes(area[first : first + variable.size])


def store(plant: Plant, variable: Variable, transport: int, content: bytes, *, apply: bool) -> int:
    """Write a variable; return its code."""
    code = variable.fault(plant)
    if code != SUCCESS:
        return code
    if transport != _CARRIED_AS[variable.transport] or len(content) != variable.size:
        return TYPE_INCONSISTENT
    if apply:
        area, first = plant.areas[variable.place], variable.address // 8
        if variable.transport == BIT:
            mask = 1 << variable.address % 8
            area[first] = area[first] | mask if content[0] & 1 else area[first] & ~mask & 0xFF
        else:
            area[first : first + variable.size] = content
    return SUCCESS
