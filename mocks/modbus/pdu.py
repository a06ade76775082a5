"""The execution of Modbus request PDUs on a unit's memory (MODBUS Application Protocol V1.1b3, section 6).

This file handles bytes and memory, no sockets. Every request is answered with a response PDU or an exception; the
checks come in the order of the specification's state diagrams: function, quantity or value, address, execution.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence

from pytest_otmcp.wire.modbus import (
    MASK_WRITE,
    READ_WRITE,
    WRITE_COIL,
    WRITE_COILS,
    WRITE_REGISTER,
    WRITE_REGISTERS,
    bits,
    packed_bits,
    packed_registers,
    registers,
)

from .image import UnitImage

__all__ = ["IllegalRequest", "execute", "identify", "read_response"]

ILLEGAL_FUNCTION, ILLEGAL_DATA_ADDRESS, ILLEGAL_DATA_VALUE = 1, 2, 3

READ_COILS, READ_DISCRETE, READ_HOLDING, READ_INPUT, ENCAPSULATED = 1, 2, 3, 4, 43
_COIL_STATES = {0x0000: False, 0xFF00: True}

_CATEGORY_LAST = {1: 2, 2: 6, 3: 6}
_MAX_PDU = 253


class IllegalRequest(Exception):
    """The request is answered with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def read_response(function: int, values: Sequence[int]) -> bytes:
    """Return the response PDU that answers a read with these registers or bits."""
    data = packed_bits(values) if function in (READ_COILS, READ_DISCRETE) else packed_registers(values)
    return bytes([function, len(data)]) + data


def execute(unit: UnitImage, pdu: bytes, *, apply: bool = True) -> bytes:
    """Execute a request and return the response PDU.

    Args:
        apply: False answers a write as if it had been done, without doing it.

    Raises:
        IllegalRequest: the exception code to answer with.
    """
    if pdu[0] not in _FUNCTIONS:
        raise IllegalRequest(ILLEGAL_FUNCTION)
    return _FUNCTIONS[pdu[0]](unit, pdu, apply)


def _read_bits(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    address, quantity = _span(unit, pdu[1:], 2000)
    cells = unit.coils if pdu[0] == READ_COILS else unit.discrete_inputs
    return read_response(pdu[0], cells[address : address + quantity])


def _read_registers(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    address, quantity = _span(unit, pdu[1:], 125)
    cells = unit.holding_registers if pdu[0] == READ_HOLDING else unit.input_registers
    return read_response(pdu[0], cells[address : address + quantity])


def _write_coil(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    address, value = _pair(pdu[1:])
    if value not in _COIL_STATES:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    _within(unit, address, 1)
    if apply:
        unit.coils[address] = _COIL_STATES[value]
    return pdu


def _write_register(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    address, value = _pair(pdu[1:])
    _within(unit, address, 1)
    if apply:
        unit.holding_registers[address] = value
    return pdu


def _write_coils(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    address, quantity, data = _block(unit, pdu[1:], 1968, lambda count: (count + 7) // 8)
    if apply:
        unit.coils[address : address + quantity] = bits(data, quantity)
    return pdu[:5]


def _write_registers(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    address, quantity, data = _block(unit, pdu[1:], 123, lambda count: 2 * count)
    if apply:
        unit.holding_registers[address : address + quantity] = registers(data)
    return pdu[:5]


def _mask_write(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    if len(pdu) != 7:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    address, and_mask, or_mask = struct.unpack_from(">HHH", pdu, 1)
    _within(unit, address, 1)
    if apply:
        current = unit.holding_registers[address]
        unit.holding_registers[address] = (current & and_mask) | (or_mask & ~and_mask & 0xFFFF)
    return pdu


def _read_write(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    if len(pdu) < 10:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    read_address, read_quantity, address, quantity, count = struct.unpack_from(">HHHHB", pdu, 1)
    data = pdu[10:]
    if not 1 <= read_quantity <= 125 or not 1 <= quantity <= 121 or count != 2 * quantity or len(data) != count:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    _within(unit, read_address, read_quantity)
    _within(unit, address, quantity)
    # Section 6.17: the write is performed before the read.
    if apply:
        unit.holding_registers[address : address + quantity] = registers(data)
    return read_response(READ_WRITE, unit.holding_registers[read_address : read_address + read_quantity])


def _pair(body: bytes) -> tuple[int, int]:
    if len(body) != 4:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    first, second = struct.unpack(">HH", body)
    return first, second


def _span(unit: UnitImage, body: bytes, limit: int) -> tuple[int, int]:
    address, quantity = _pair(body)
    if not 1 <= quantity <= limit:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    _within(unit, address, quantity)
    return address, quantity


def _within(unit: UnitImage, address: int, quantity: int) -> None:
    if address + quantity > unit.size:
        raise IllegalRequest(ILLEGAL_DATA_ADDRESS)


def _block(unit: UnitImage, body: bytes, limit: int, size: Callable[[int], int]) -> tuple[int, int, bytes]:
    if len(body) < 5:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    address, quantity, count = struct.unpack_from(">HHB", body)
    data = body[5:]
    if not 1 <= quantity <= limit or count != size(quantity) or len(data) != count:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    _within(unit, address, quantity)
    return address, quantity, data


def identify(objects: Mapping[int, bytes], body: bytes) -> bytes:
    """Return the answer to Read Device Identification (section 6.21).

    Its conformity level is 82: basic and regular objects, stream and individual access. A stream that does not fit into
    one PDU is continued at the object that the answer names.

    Raises:
        IllegalRequest: 01 for another MEI type, 02 for an unknown object asked for individually, 03 otherwise.
    """
    if not body or body[0] != 0x0E:
        raise IllegalRequest(ILLEGAL_FUNCTION)
    if len(body) != 3:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    code, first = body[1], body[2]
    if code == 4:
        if first not in objects:
            raise IllegalRequest(ILLEGAL_DATA_ADDRESS)
        wanted = [first]
    elif code in _CATEGORY_LAST:
        category = [identifier for identifier in sorted(objects) if identifier <= _CATEGORY_LAST[code]]
        # According to the section, an unknown object id restarts the stream at the beginning.
        wanted = [identifier for identifier in category if first not in category or identifier >= first]
    else:
        raise IllegalRequest(ILLEGAL_DATA_VALUE)
    listed, following = b"", None
    taken = 0
    for identifier in wanted:
        entry = bytes([identifier, len(objects[identifier])]) + objects[identifier]
        if 7 + len(listed) + len(entry) > _MAX_PDU:
            following = identifier
            break
        listed += entry
        taken += 1
    more = b"\x00\x00" if following is None else bytes([0xFF, following])
    return bytes([ENCAPSULATED, 0x0E, code, 0x82]) + more + bytes([taken]) + listed


def _encapsulated(unit: UnitImage, pdu: bytes, apply: bool) -> bytes:
    return identify(unit.identification, pdu[1:])


_FUNCTIONS: Mapping[int, Callable[[UnitImage, bytes, bool], bytes]] = {
    READ_COILS: _read_bits,
    READ_DISCRETE: _read_bits,
    READ_HOLDING: _read_registers,
    READ_INPUT: _read_registers,
    WRITE_COIL: _write_coil,
    WRITE_REGISTER: _write_register,
    WRITE_COILS: _write_coils,
    WRITE_REGISTERS: _write_registers,
    MASK_WRITE: _mask_write,
    READ_WRITE: _read_write,
    ENCAPSULATED: _encapsulated,
}
"""What executes a request PDU, by function code; False as the last argument leaves the memory as it is."""
