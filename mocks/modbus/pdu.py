"""Executes Modbus request PDUs on a unit's memory (MODBUS Application Protocol V1.1b3, section 6).

Rule: this file knows bytes and memory, no sockets. Every request is answered with a response PDU or an exception; the
checks come in the order of the specification's state diagrams: function, quantity or value, address, execution.
"""

from __future__ import annotations

import struct
from typing import Any

from .image import SIZE, UnitImage

__all__ = ["STATE_CHANGING", "IllegalRequest", "describe", "execute"]

ILLEGAL_FUNCTION, ILLEGAL_DATA_ADDRESS, ILLEGAL_DATA_VALUE = 1, 2, 3

READ_COILS, READ_DISCRETE, READ_HOLDING, READ_INPUT = 1, 2, 3, 4
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS = 5, 6, 15, 16
MASK_WRITE, READ_WRITE, ENCAPSULATED = 22, 23, 43

STATE_CHANGING = frozenset({WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS, MASK_WRITE, READ_WRITE})

_IDENTIFICATION = {
    0: b"pytest-otmcp",
    1: b"MOCK-MB-1",
    2: b"1.0",
    3: b"https://github.com/pytest-otmcp",
    4: b"Modbus TCP mock plant",
    5: b"MOCK-MB",
    6: b"conformance",
}
_CATEGORY_LAST = {1: 2, 2: 6, 3: 6}
_MAX_PDU = 253


class IllegalRequest(Exception):
    """The request is answered with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def describe(pdu: bytes) -> dict[str, Any]:
    """The request's fields for the journal, as far as its bytes go."""
    function = pdu[0]
    fields: dict[str, Any] = {"function": function, "state_changing": function in STATE_CHANGING}
    if function != ENCAPSULATED and len(pdu) >= 5:
        fields["address"], second = struct.unpack_from(">HH", pdu, 1)
        if function == WRITE_COIL:
            fields["quantity"], fields["values"] = 1, [second == 0xFF00]
        elif function == WRITE_REGISTER:
            fields["quantity"], fields["values"] = 1, [second]
        elif function == MASK_WRITE and len(pdu) >= 7:
            fields["and_mask"], fields["or_mask"] = struct.unpack_from(">HH", pdu, 3)
        elif function == READ_WRITE and len(pdu) >= 10:
            fields["read_address"], fields["read_quantity"] = fields["address"], second
            fields["address"], fields["quantity"] = struct.unpack_from(">HH", pdu, 5)
            fields["values"] = _registers(pdu[10:])
        else:
            fields["quantity"] = second
            if function == WRITE_COILS and len(pdu) > 6:
                fields["values"] = _bits(pdu[6:], second)
            elif function == WRITE_REGISTERS and len(pdu) > 6:
                fields["values"] = _registers(pdu[6:])
    return fields


def execute(unit: UnitImage, pdu: bytes, *, apply: bool = True) -> bytes:
    """Execute a request and return the response PDU.

    Args:
        apply: False answers a write as if it had been done, without doing it.

    Raises:
        IllegalRequest: the exception code to answer with.
    """
    function, body = pdu[0], pdu[1:]
    if function in (READ_COILS, READ_DISCRETE):
        address, quantity = _span(body, 2000)
        cells = unit.coils if function == READ_COILS else unit.discrete_inputs
        data = _pack_bits(cells[address : address + quantity])
        return bytes([function, len(data)]) + data
    if function in (READ_HOLDING, READ_INPUT):
        address, quantity = _span(body, 125)
        registers = unit.holding_registers if function == READ_HOLDING else unit.input_registers
        return bytes([function, 2 * quantity]) + _pack(registers[address : address + quantity])
    if function == WRITE_COIL:
        address, value = _pair(body)
        if value not in (0x0000, 0xFF00):
            raise IllegalRequest(ILLEGAL_DATA_VALUE)
        _within(address, 1)
        if apply:
            unit.coils[address] = value == 0xFF00
        return pdu
    if function == WRITE_REGISTER:
        address, value = _pair(body)
        _within(address, 1)
        if apply:
            unit.holding_registers[address] = value
        return pdu
    if function == WRITE_COILS:
        address, quantity, data = _block(body, 1968, lambda count: (count + 7) // 8)
        if apply:
            unit.coils[address : address + quantity] = _bits(data, quantity)
        return pdu[:5]
    if function == WRITE_REGISTERS:
        address, quantity, data = _block(body, 123, lambda count: 2 * count)
        if apply:
            unit.holding_registers[address : address + quantity] = _registers(data)
        return pdu[:5]
    if function == MASK_WRITE:
        if len(body) != 6:
            raise IllegalRequest(ILLEGAL_DATA_VALUE)
        address, and_mask, or_mask = struct.unpack(">HHH", body)
        _within(address, 1)
        if apply:
            current = unit.holding_registers[address]
            unit.holding_registers[address] = (current & and_mask) | (or_mask & ~and_mask & 0xFFFF)
        return pdu
    if function == READ_WRITE:
        return _read_write(unit, body, apply)
    if function == ENCAPSULATED:
        return _identification(body)
    raise IllegalRequest(ILLEGAL_FUNCTION)


def _pair(body: bytes) -> tuple[int, int]:
    if len(body) != 4:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    first, second = struct.unpack(">HH", body)
    return first, second


def _span(body: bytes, limit: int) -> tuple[int, int]:
    address, quantity = _pair(body)
    if not 1 <= quantity <= limit:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    _within(address, quantity)
    return address, quantity


def _within(address: int, quantity: int) -> None:
    if address + quantity > SIZE:
        raise IllegalRequest(ILLEGAL_DATA_ADDRESS)


def _block(body: bytes, limit: int, size: Any) -> tuple[int, int, bytes]:
    if len(body) < 5:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    address, quantity, count = struct.unpack_from(">HHB", body)
    data = body[5:]
    if not 1 <= quantity <= limit or count != size(quantity) or len(data) != count:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    _within(address, quantity)
    return address, quantity, data


def _read_write(unit: UnitImage, body: bytes, apply: bool) -> bytes:
    if len(body) < 9:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    read_address, read_quantity, address, quantity, count = struct.unpack_from(">HHHHB", body)
    data = body[9:]
    if not 1 <= read_quantity <= 125 or not 1 <= quantity <= 121 or count != 2 * quantity or len(data) != count:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    _within(read_address, read_quantity)
    _within(address, quantity)
    # Section 6.17: the write is performed before the read.
    if apply:
        unit.holding_registers[address : address + quantity] = _registers(data)
    read = unit.holding_registers[read_address : read_address + read_quantity]
    return bytes([READ_WRITE, 2 * read_quantity]) + _pack(read)


def _identification(body: bytes) -> bytes:
    """Read Device Identification, section 6.21: conformity level 0x82 (regular, stream and individual access)."""
    if not body or body[0] != 0x0E:
        raise IllegalRequest(ILLEGAL_FUNCTION)
    if len(body) != 3:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    code, first = body[1], body[2]
    if code == 4:
        if first not in _IDENTIFICATION:
            raise IllegalRequest(ILLEGAL_DATA_ADDRESS)
        wanted = [first]
    elif code in _CATEGORY_LAST:
        last = _CATEGORY_LAST[code]
        # An unknown object id restarts the stream at the beginning, says the section.
        wanted = list(range(first if first <= last else 0, last + 1))
    else:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    objects, more, following = b"", 0x00, 0
    taken = 0
    for identifier in wanted:
        entry = bytes([identifier, len(_IDENTIFICATION[identifier])]) + _IDENTIFICATION[identifier]
        if 7 + len(objects) + len(entry) > _MAX_PDU:
            more, following = 0xFF, identifier
            break
        objects += entry
        taken += 1
    return bytes([ENCAPSULATED, 0x0E, code, 0x82, more, following, taken]) + objects


def _pack(registers: list[int]) -> bytes:
    return struct.pack(f">{len(registers)}H", *registers)


def _registers(data: bytes) -> list[int]:
    return list(struct.unpack(f">{len(data) // 2}H", data[: len(data) // 2 * 2]))


def _bits(data: bytes, quantity: int) -> list[bool]:
    return [bool(data[i // 8] >> (i % 8) & 1) for i in range(min(quantity, 8 * len(data)))]


def _pack_bits(cells: list[bool]) -> bytes:
    data = bytearray((len(cells) + 7) // 8)
    for i, cell in enumerate(cells):
        data[i // 8] |= cell << (i % 8)
    return bytes(data)
