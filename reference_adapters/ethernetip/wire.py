"""Requests and answers of CIP (Common Industrial Protocol) as bytes, and the check that an answer belongs to its request.

pylogix builds paths and frames. Of an answer it looks at the status alone: it takes the answer of another request, of another
connection or of another service for the right one.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from ..core import BadReply

__all__ = [
    "FORWARD_OPEN",
    "HEADER",
    "LARGE_FORWARD_OPEN",
    "MODIFY",
    "PARTLY",
    "READ",
    "REGISTER",
    "SOME_FAILED",
    "SUCCESS",
    "WRITE",
    "Reply",
    "attribute_of",
    "connected_message",
    "embedded",
    "header_of",
    "modify_service",
    "parts_of",
    "read_service",
    "reply_of",
    "several",
    "unconnected_message",
    "write_service",
]

READ, WRITE, MODIFY = 0x4C, 0x4D, 0x4E
_MULTIPLE = 0x0A
FORWARD_OPEN, LARGE_FORWARD_OPEN = 0x54, 0x5B
SUCCESS, PARTLY, SOME_FAILED = 0x00, 0x06, 0x1E
REGISTER = 0x65
_MESSAGE_ROUTER = bytes.fromhex("20022401")

HEADER = 24
"""Bytes of the encapsulation header, whose bytes 2 and 3 are the length of what follows."""
_CONNECTED_ADDRESS, _CONNECTED_DATA = 0xA1, 0xB1
_NULL_ADDRESS, _UNCONNECTED_DATA = 0x00, 0xB2


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """An answer of CIP.

    Attributes:
        status: general status, 0 for success.
        extended: the first word of the extended status; None without.
        data: what follows.
    """

    status: int
    extended: int | None
    data: bytes


def read_service(path: bytes, elements: int) -> bytes:
    """Return the request to read so many elements of a tag."""
    return _service(READ, path) + struct.pack("<H", elements)


def write_service(path: bytes, kind: bytes, contents: Sequence[bytes]) -> bytes:
    """Return the request to write elements of a tag, whose type ``kind`` says."""
    return _service(WRITE, path) + kind + struct.pack("<H", len(contents)) + b"".join(contents)


def modify_service(path: bytes, size: int, bit: int, value: bool) -> bytes:
    """Return the request to set or clear one bit of a tag of ``size`` bytes: the controller takes it OR a mask, AND another one."""
    mask = 1 << bit
    set_bits, kept = (mask if value else 0), (1 << 8 * size) - 1 - (0 if value else mask)
    return (
        _service(MODIFY, path)
        + struct.pack("<H", size)
        + set_bits.to_bytes(size, "little")
        + kept.to_bytes(size, "little")
    )


def _service(code: int, path: bytes) -> bytes:
    return bytes([code, len(path) // 2]) + path


def several(services: Sequence[bytes]) -> bytes:
    """Return the request that has several (Multiple_Service_Packet): their number, where each begins, and they themselves."""
    offset = 2 + 2 * len(services)
    offsets = b""
    for service in services:
        offsets += struct.pack("<H", offset)
        offset += len(service)
    return _service(_MULTIPLE, _MESSAGE_ROUTER) + struct.pack("<H", len(services)) + offsets + b"".join(services)


def embedded(request: bytes) -> list[int]:
    """Return the codes of the services that a request has in itself; its own where it has none."""
    if request[0] != _MULTIPLE:
        return [request[0]]
    (count,) = struct.unpack_from("<H", request, 6)
    return [request[6 + offset] for offset in struct.unpack_from(f"<{count}H", request, 8)]


def header_of(header: bytes, command: int) -> tuple[int, int, int]:
    """Return length, session and status of the header of an answer to this command.

    Raises:
        BadReply: it is the answer to another command.
    """
    found, length, session, status = struct.unpack_from("<HHII", header)
    if found != command:
        raise BadReply("it answers another command")
    return length, session, status


def connected_message(body: bytes) -> tuple[int, int, bytes]:
    """Return the connection, the sequence count and the message of an answer on a connection (SendUnitData).

    Raises:
        BadReply: it is none.
    """
    address, data = _items(body, _CONNECTED_ADDRESS, _CONNECTED_DATA)
    if len(address) != 4 or len(data) < 2:
        raise BadReply("its items are cut off")
    return int.from_bytes(address, "little"), int.from_bytes(data[:2], "little"), data[2:]


def unconnected_message(body: bytes) -> bytes:
    """Return the message of an answer outside of connections (SendRRData).

    Raises:
        BadReply: it is none.
    """
    return _items(body, _NULL_ADDRESS, _UNCONNECTED_DATA)[1]


def _items(body: bytes, *wanted: int) -> list[bytes]:
    if len(body) < 8 or struct.unpack_from("<H", body, 6)[0] != len(wanted):
        raise BadReply("it has another number of items")
    found, place = [], 8
    for kind in wanted:
        if len(body) < place + 4:
            raise BadReply("its items are cut off")
        item, length = struct.unpack_from("<HH", body, place)
        if item != kind or len(body) < place + 4 + length:
            raise BadReply("it has another item than the request, or a part of one")
        found.append(body[place + 4 : place + 4 + length])
        place += 4 + length
    if place != len(body):
        raise BadReply("bytes follow its last item")
    return found


def reply_of(service: int, message: bytes) -> Reply:
    """Return the answer to a service.

    Raises:
        BadReply: it is the answer to another one, or is cut off.
    """
    if len(message) < 4 or len(message) < 4 + 2 * message[3]:
        raise BadReply("it is cut off")
    if message[0] != service | 0x80:
        raise BadReply("it answers another service")
    extended = int.from_bytes(message[4:6], "little") if message[3] else None
    return Reply(status=message[2], extended=extended, data=message[4 + 2 * message[3] :])


def parts_of(request: bytes, reply: Reply) -> list[Reply]:
    """Return the answers to the services of a request that has several.

    Raises:
        BadReply: their number is another one, or one is the answer to another service.
    """
    services, data = embedded(request), reply.data
    if len(data) < 2 + 2 * len(services) or struct.unpack_from("<H", data)[0] != len(services):
        raise BadReply("it answers another number of services")
    starts = [*struct.unpack_from(f"<{len(services)}H", data, 2), len(data)]
    if starts[0] != 2 + 2 * len(services) or sorted(starts) != starts:
        raise BadReply("its answers lie one over the other")
    return [
        reply_of(service, data[start:end]) for service, start, end in zip(services, starts, starts[1:], strict=False)
    ]


def attribute_of(reply: Reply, attribute: int) -> tuple[int, bytes]:
    """Return status and value of the one attribute that was asked for, or set, by an attribute list.

    Raises:
        BadReply: it is about another one, or about several.
    """
    if len(reply.data) < 6 or struct.unpack_from("<HH", reply.data) != (1, attribute):
        raise BadReply("it is about other attributes")
    return int.from_bytes(reply.data[4:6], "little"), reply.data[6:]
