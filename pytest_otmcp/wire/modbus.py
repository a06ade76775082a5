"""The codec of Modbus TCP, written from the specifications alone.

MODBUS Messaging on TCP/IP Implementation Guide V1.0b, section 3.1 (MBAP header); MODBUS Application Protocol V1.1b3,
section 6 (functions) and 7 (exceptions). Requests are described as far as their bytes go, also those that a device refuses: the
bytes that arrived are evidence.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from .framing import MalformedError

__all__ = [
    "HEADER",
    "MASK_WRITE",
    "READS",
    "READ_WRITE",
    "STATE_CHANGING",
    "WRITE_COIL",
    "WRITE_COILS",
    "WRITE_REGISTER",
    "WRITE_REGISTERS",
    "bits",
    "frame",
    "mbap_length",
    "packed_bits",
    "packed_registers",
    "registers",
    "request_fields",
    "response_fields",
]

READ_BITS = frozenset({1, 2})
READ_REGISTERS = frozenset({3, 4})
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS, MASK_WRITE, READ_WRITE = 5, 6, 15, 16, 22, 23
READS = READ_BITS | READ_REGISTERS | {READ_WRITE}
STATE_CHANGING = frozenset({WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS, MASK_WRITE, READ_WRITE})
"""Functions whose request can change the device."""

HEADER = struct.Struct(">HHHB")
_LONGEST_PDU = 253


def mbap_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the application data unit at the beginning of the buffer.

    Raises:
        MalformedError: the protocol identifier is not 0, or the length is impossible.
    """
    if len(buffer) < 6:
        return None
    _, protocol, length = struct.unpack_from(">HHH", buffer)
    if protocol != 0:
        raise MalformedError(f"the protocol identifier is {protocol}, it must be 0")
    if not 2 <= length <= 1 + _LONGEST_PDU:
        raise MalformedError(f"the MBAP length is {length}, it must be 2 to {1 + _LONGEST_PDU}")
    return 6 + int(length)


def request_fields(pdu: bytes) -> dict[str, Any]:
    """Return what a request says: the members of its journal entry, see :class:`~pytest_otmcp.protocols.modbus.entries.ModbusEntry`."""
    function = pdu[0]
    fields: dict[str, Any] = {"function": function}
    words = struct.unpack_from(f">{min(len(pdu) - 1, 8) // 2}H", pdu, 1)
    if function in READ_BITS | READ_REGISTERS | {WRITE_COILS, WRITE_REGISTERS} and len(words) >= 2:
        fields["address"], fields["quantity"] = words[:2]
        if function == WRITE_COILS:
            fields["values"] = bits(pdu[6:], words[1])
        elif function == WRITE_REGISTERS:
            fields["values"] = registers(pdu[6:])
    elif function == WRITE_REGISTER and len(words) >= 2:
        fields |= {"address": words[0], "quantity": 1, "values": [words[1]]}
    elif function == WRITE_COIL and len(words) >= 2:
        # Section 6.5: FF00 is ON, 0000 is OFF, all other values are illegal and have no meaning.
        fields |= {
            "address": words[0],
            "quantity": 1,
            "values": [{0x0000: False, 0xFF00: True}.get(words[1], words[1])],
        }
    elif function == MASK_WRITE and len(words) >= 3:
        fields |= {"address": words[0], "quantity": 1, "and_mask": words[1], "or_mask": words[2]}
    elif function == READ_WRITE and len(pdu) >= 10:
        fields |= {"read_address": words[0], "read_quantity": words[1]}
        fields |= {"address": words[2], "quantity": words[3], "values": registers(pdu[10:])}
    return fields


def response_fields(pdu: bytes, request: Mapping[str, Any]) -> dict[str, Any]:
    """Return what an answer says.

    Args:
        request: what the request says that it answers; empty where that is not known.
    """
    function = pdu[0] & 0x7F
    if pdu[0] & 0x80:
        return {"function": function, "exception": pdu[1] if len(pdu) > 1 else None}
    fields: dict[str, Any] = {"function": function, "exception": None}
    if function in READ_BITS and len(pdu) >= 2:
        fields["values"] = bits(pdu[2:], request.get("quantity", 0) if request else 8 * (len(pdu) - 2))
    elif function in READ_REGISTERS | {READ_WRITE} and len(pdu) >= 2:
        fields["values"] = registers(pdu[2:])
    return fields


def registers(data: bytes) -> list[int]:
    """Return the registers of a data field."""
    return list(struct.unpack_from(f">{len(data) // 2}H", data))


def bits(data: Iterable[int], quantity: int) -> list[bool]:
    """Return the bits, least significant first (section 6.1)."""
    return [bool(byte >> bit & 1) for byte in data for bit in range(8)][:quantity]


def frame(transaction: int, unit: int, pdu: bytes, *, protocol: int = 0, length: int | None = None) -> bytes:
    """Return an application data unit.

    Args:
        protocol, length: fields of the header that are not what they should be.
    """
    return HEADER.pack(transaction, protocol, len(pdu) + 1 if length is None else length, unit) + pdu


def packed_registers(values: Sequence[int]) -> bytes:
    """Return registers as a data field has them."""
    return struct.pack(f">{len(values)}H", *values)


def packed_bits(values: Sequence[int]) -> bytes:
    """Return bits as a data field has them."""
    data = bytearray((len(values) + 7) // 8)
    for place, value in enumerate(values):
        data[place // 8] |= bool(value) << (place % 8)
    return bytes(data)
