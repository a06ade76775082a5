"""Modbus TCP frames: the facts of a request, and the check that a reply belongs to it. It handles bytes, no connection.

pymodbus accepts replies with transaction identifier 0 instead of the request's, replies to another function, a byte count
or number of registers that was not asked for, and a write confirmation with another value (measured, 3.16.1). An adapter
must not accept them (MODBUS Messaging on TCP/IP V1.0b, section 4.4.1.3; Application Protocol V1.1b3, sections 6 and 7).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..core import BadReply

__all__ = ["Frame", "is_other_reply", "reply_pdu", "request_facts"]

_HEADER = struct.Struct(">HHHB")
_EXCEPTION_BIT = 0x80
_ENCAPSULATED = 0x2B


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One MBAP frame: transaction identifier, unit identifier, PDU."""

    transaction: int
    unit: int
    pdu: bytes


def _frames(data: bytes) -> Iterator[Frame]:
    while len(data) > _HEADER.size:
        transaction, protocol, length, unit = _HEADER.unpack_from(data)
        end = 6 + length
        if protocol != 0:
            raise BadReply("its protocol identifier is not 0")
        if length < 2 or len(data) < end:
            return
        yield Frame(transaction=transaction, unit=unit, pdu=data[_HEADER.size : end])
        data = data[end:]


def request_facts(data: bytes) -> tuple[Frame, dict[str, Any]]:
    """Return the frame of an outgoing request and its facts for ``meta.trace``: unit, function, address, count."""
    frame = next(_frames(data))
    facts: dict[str, Any] = {"unit": frame.unit, "function": frame.pdu[0]}
    if frame.pdu[0] != _ENCAPSULATED:
        address, second = struct.unpack_from(">HH", frame.pdu, 1)
        facts["address"] = address
        facts["count"] = second if frame.pdu[0] in (1, 2, 3, 4, 15, 16) else 1
    return frame, facts


def is_other_reply(request: Frame, received: bytes) -> bool:
    """Tell whether a whole frame has come that is neither the reply nor a late one to an earlier request, which may still be followed
    by the reply. pymodbus numbers its requests from 1."""
    try:
        if any(not 0 < frame.transaction < request.transaction for frame in _frames(received)):
            reply_pdu(request, received)
    except BadReply:
        return True
    return False


def reply_pdu(request: Frame, received: bytes) -> bytes:
    """Find the reply to a request in the bytes received after it, and return its PDU.

    Raises:
        BadReply: no frame fits the request in every respect.
    """
    same = [frame for frame in _frames(received) if frame.transaction == request.transaction]
    if not same:
        raise BadReply("its transaction identifier is not the request's")
    reply = same[0]
    if reply.unit != request.unit:
        raise BadReply("it comes from another unit")
    if reply.pdu[0] & ~_EXCEPTION_BIT != request.pdu[0]:
        raise BadReply("it is the reply to another function")
    if not _has_shape(request.pdu, reply.pdu):
        raise BadReply("its content does not fit the request")
    return reply.pdu


def _has_shape(request: bytes, reply: bytes) -> bool:
    function = request[0]
    if reply[0] & _EXCEPTION_BIT:
        return len(reply) == 2
    if function in (1, 2, 3, 4):
        quantity = int.from_bytes(request[3:5], "big")
        size = 2 * quantity if function in (3, 4) else (quantity + 7) // 8
        return len(reply) == 2 + size and reply[1] == size
    if function in (5, 6, 22):
        return reply == request
    if function in (15, 16):
        return reply == request[:5]
    return reply[1:3] == request[1:3] and _has_whole_objects(reply)


def _has_whole_objects(identification: bytes) -> bool:
    # Section 6.21: seven bytes, of which the last is the number of objects; each has an identifier and a length.
    if len(identification) < 7:
        return False
    end = 7
    for _ in range(identification[6]):
        if len(identification) < end + 2:
            return False
        end += 2 + identification[end + 1]
    return len(identification) == end
