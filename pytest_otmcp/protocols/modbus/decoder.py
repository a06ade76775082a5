"""Decoder of Modbus TCP for recorded bytes, written from the specifications alone.

MODBUS Messaging on TCP/IP Implementation Guide V1.0b, section 3.1 (MBAP header); MODBUS Application Protocol V1.1b3,
section 6 (functions) and 7 (exceptions). Requests are described as far as their bytes go, also those that the
device refuses: the bytes that arrived are evidence. Every message of a client is a request; the functions of
:data:`STATE_CHANGING` may change the plant.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Any

from ..conversation import Direction, Message, Outstanding
from ..framing import MalformedError
from ..journal import JournalEntry
from ..reread import difference

__all__ = ["STATE_CHANGING", "ModbusConversation", "contradiction", "mbap_length"]

READ_BITS = frozenset({1, 2})
READ_REGISTERS = frozenset({3, 4})
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS, MASK_WRITE, READ_WRITE = 5, 6, 15, 16, 22, 23
STATE_CHANGING = frozenset({WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS, MASK_WRITE, READ_WRITE})
"""Functions whose request can change the device."""

_HEADER = struct.Struct(">HHHB")
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


class ModbusConversation:
    """One connection. It remembers requests, so that answers can be read: an answer pads its bits to whole bytes."""

    def __init__(self) -> None:
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request`` and
        ``response``."""
        transaction, _, _, unit = _HEADER.unpack_from(frame)
        pdu = frame[7:]
        key = (transaction, unit, pdu[0] & 0x7F)
        fields: dict[str, object] = {"unit": unit, "transaction_id": transaction}
        if direction == "in":
            message = Message(
                direction="in",
                kind="request",
                fields={**fields, **_request(pdu), "pdu": pdu.hex()},
                request=True,
                state_changing=pdu[0] in STATE_CHANGING,
            )
            self._outstanding.add(key, message)
            return [message]
        asked = self._outstanding.take(key)
        fields |= {**_response(pdu, {} if asked is None else asked.fields), "pdu": pdu.hex()}
        return [Message(direction="out", kind="response", fields=fields, answers=asked)]


def contradiction(entry: JournalEntry) -> str | None:
    """Say where an entry differs from its PDU; None where it does not."""
    members: Mapping[str, Any] = dict(entry)
    # What came in with bytes is a request, whatever it is called; what went out may have been damaged on the way.
    if entry["kind"] not in ("request", "response") and (entry["direction"] == "out" or "pdu" not in members):
        return "is called a request, and has no PDU" if entry["request"] else None
    try:
        pdu = bytes.fromhex(members["pdu"])
    except (KeyError, TypeError, ValueError):
        pdu = b""
    if not pdu:
        return f"has no PDU but {members.get('pdu')!r}"
    if entry["direction"] == "in":
        shown = {"kind": "request", "request": True, **_request(pdu), "state_changing": pdu[0] in STATE_CHANGING}
    else:
        # How many bits were asked for only the request says; the last byte is padded.
        values = members.get("values")
        shown = _response(pdu, {"quantity": len(values) if isinstance(values, list) else 0})
    return difference(members, shown, "PDU")


def _request(pdu: bytes) -> dict[str, object]:
    function = pdu[0]
    fields: dict[str, object] = {"function": function}
    words = struct.unpack_from(f">{min(len(pdu) - 1, 8) // 2}H", pdu, 1)
    if function in READ_BITS | READ_REGISTERS | {WRITE_COILS, WRITE_REGISTERS} and len(words) >= 2:
        fields["address"], fields["quantity"] = words[:2]
        if function == WRITE_COILS:
            fields["values"] = _bits(pdu[6:], words[1])
        elif function == WRITE_REGISTERS:
            fields["values"] = _registers(pdu[6:])
    elif function == WRITE_REGISTER and len(words) >= 2:
        fields |= {"address": words[0], "quantity": 1, "values": [words[1]]}
    elif function == WRITE_COIL and len(words) >= 2:
        fields |= {"address": words[0], "quantity": 1}
        # Section 6.5: FF00 is ON, 0000 is OFF, all other values are illegal and have no meaning.
        if words[1] in (0x0000, 0xFF00):
            fields["values"] = [words[1] == 0xFF00]
    elif function == MASK_WRITE and len(words) >= 3:
        fields |= {"address": words[0], "quantity": 1, "and_mask": words[1], "or_mask": words[2]}
    elif function == READ_WRITE and len(pdu) >= 10:
        fields |= {"read_address": words[0], "read_quantity": words[1]}
        fields |= {"address": words[2], "quantity": words[3], "values": _registers(pdu[10:])}
    return fields


def _response(pdu: bytes, request: Mapping[str, Any]) -> dict[str, Any]:
    function = pdu[0] & 0x7F
    if pdu[0] & 0x80:
        return {"function": function, "exception": pdu[1] if len(pdu) > 1 else None}
    fields: dict[str, Any] = {"function": function, "exception": None}
    if function in READ_BITS and len(pdu) >= 2:
        fields["values"] = _bits(pdu[2:], request.get("quantity", 0) if request else 8 * (len(pdu) - 2))
    elif function in READ_REGISTERS | {READ_WRITE} and len(pdu) >= 2:
        fields["values"] = _registers(pdu[2:])
    return fields


def _registers(data: bytes) -> list[int]:
    return list(struct.unpack_from(f">{len(data) // 2}H", data))


def _bits(data: Iterable[int], quantity: int) -> list[bool]:
    """Return the bits, least significant first (section 6.1)."""
    return [bool(byte >> bit & 1) for byte in data for bit in range(8)][:quantity]
