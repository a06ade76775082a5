"""Discovery and configuration: DCP, by which stations are found by their names, and get their names and addresses."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ..framing import MalformedError

__all__ = [
    "ALL",
    "GET",
    "GET_OR_SET",
    "IDENTIFY",
    "IDENTIFY_REQUEST",
    "IDENTIFY_RESPONSE",
    "IDS",
    "IP",
    "NAME",
    "REFUSED",
    "REQUEST",
    "RESPONSE",
    "RESULT",
    "ROLE",
    "SET",
    "SIGNAL",
    "START",
    "STOP",
    "SUCCESS",
    "UNSUPPORTED",
    "UNSUPPORTED_OPTION",
    "VENDOR",
    "Block",
    "Dcp",
    "is_station_name",
]

GET_OR_SET, IDENTIFY_REQUEST, IDENTIFY_RESPONSE = 0xFEFD, 0xFEFE, 0xFEFF
"""Frame identifiers of DCP."""
GET, SET, IDENTIFY = 3, 4, 5
"""Services."""
REQUEST, RESPONSE, UNSUPPORTED = 0, 1, 5
"""Kinds of messages of a service."""

IP, VENDOR, NAME, IDS, ROLE = (1, 2), (2, 1), (2, 2), (2, 3), (2, 4)
START, STOP, SIGNAL, RESULT, ALL = (5, 1), (5, 2), (5, 3), (5, 4), (0xFF, 0xFF)
"""Options with their suboptions."""

SUCCESS, UNSUPPORTED_OPTION, REFUSED = 0, 1, 3
"""Results of a Set, block by block; :data:`REFUSED` is a value that the station cannot have."""

_HEADER = struct.Struct(">HBBIHH")
_LABEL = set("abcdefghijklmnopqrstuvwxyz0123456789-")


@dataclass(frozen=True, slots=True)
class Block:
    """One block: an option with its suboption, and its content, block qualifier or block information included."""

    option: tuple[int, int]
    content: bytes = b""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dcp:
    """One DCP message.

    Attributes:
        frame_id: one of the three identifiers.
        service, kind: what is asked for, and whether this asks or answers.
        xid: by which an answer is known.
        delay: of a request to all stations: the factor of the time over which they spread their answers, of 10 ms.
        blocks: those of a Get have no content.
    """

    frame_id: int
    service: int
    kind: int = REQUEST
    xid: int = 0
    delay: int = 0
    blocks: tuple[Block, ...] = ()

    @classmethod
    def parse(cls, payload: bytes) -> Dcp:
        """Read a message from the frame identifier on.

        Raises:
            MalformedError: a length goes beyond the frame.
        """
        if len(payload) < _HEADER.size:
            raise MalformedError("a DCP message that is shorter than its header")
        frame_id, service, kind, xid, delay, length = _HEADER.unpack_from(payload)
        body = payload[_HEADER.size : _HEADER.size + length]
        if len(body) < length:
            raise MalformedError(f"a DCP message that says {length} bytes and has {len(body)}")
        plain = service == GET and kind == REQUEST
        blocks = tuple(_plain(body) if plain else _blocks(body))
        return cls(frame_id=frame_id, service=service, kind=kind, xid=xid, delay=delay, blocks=blocks)

    def encoded(self) -> bytes:
        """Return the message, from the frame identifier on."""
        plain = self.service == GET and self.kind == REQUEST
        body = b"".join(bytes(one.option) if plain else _encoded(one) for one in self.blocks)
        return _HEADER.pack(self.frame_id, self.service, self.kind, self.xid, self.delay, len(body)) + body

    def content(self, option: tuple[int, int]) -> bytes | None:
        """Return the content of the first block with an option; None without one."""
        return next((one.content for one in self.blocks if one.option == option), None)


def _plain(body: bytes) -> list[Block]:
    if len(body) % 2:
        raise MalformedError("a Get of half an option")
    return [Block((body[at], body[at + 1])) for at in range(0, len(body), 2)]


def _blocks(body: bytes) -> list[Block]:
    found, at = [], 0
    while at < len(body):
        length = int.from_bytes(body[at + 2 : at + 4])
        content = body[at + 4 : at + 4 + length]
        if len(body) < at + 4 or len(content) < length:
            raise MalformedError("a DCP block that goes beyond its message")
        found.append(Block((body[at], body[at + 1]), content))
        # A block begins at an even place; the byte before it is not counted.
        at += 4 + length + length % 2
    return found


def _encoded(block: Block) -> bytes:
    head = bytes(block.option) + len(block.content).to_bytes(2)
    return head + block.content + bytes(len(block.content) % 2)


def is_station_name(name: str) -> bool:
    """Tell whether a station may have a name: labels of RFC 1035 in lower case, none of them an address, and no port (IEC 61158-6-10, 4.3.1.4.15.2)."""
    labels = name.split(".")
    proper = all(0 < len(one) <= 63 and set(one) <= _LABEL and one[0] != "-" != one[-1] for one in labels)
    address = len(labels) == 4 and all(one.isdecimal() for one in labels)
    port = labels[0].startswith("port-") and labels[0][5:8].isdecimal()
    return proper and len(name) <= 240 and not address and not port
