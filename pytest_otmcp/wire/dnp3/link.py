"""Frames of the data link layer and segments of the transport function (IEEE 1815, clauses 9 and 8). It handles bytes only."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ..framing import MalformedError

__all__ = [
    "ACK",
    "CONFIRMED_USER_DATA",
    "FIRST",
    "LINK_STATUS",
    "NOT_SUPPORTED",
    "REQUEST_LINK_STATUS",
    "RESET_LINK_STATES",
    "TEST_LINK_STATES",
    "UNCONFIRMED_USER_DATA",
    "LinkFrame",
    "Reassembly",
    "link_length",
    "segments",
]

RESET_LINK_STATES, TEST_LINK_STATES, CONFIRMED_USER_DATA = 0, 2, 3
UNCONFIRMED_USER_DATA, REQUEST_LINK_STATUS = 4, 9
"""Functions of a primary station."""
ACK, LINK_STATUS, NOT_SUPPORTED = 0, 11, 15
"""Functions of a secondary station."""

_START = b"\x05\x64"
_HEADER, _BLOCK = 10, 16
_FROM_MASTER, _PRIMARY = 0x80, 0x40
_FIN, FIRST = 0x80, 0x40
"""Bits of a transport header: the segment is the last, or the first, of its fragment."""
_SEGMENT = 249
"""Bytes of an application fragment that a frame holds beside the transport header."""
LARGEST_FRAGMENT = 2048


def _table() -> tuple[int, ...]:
    found = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (0xA6BC if value & 1 else 0)
        found.append(value)
    return tuple(found)


_TABLE = _table()


def crc(data: bytes | bytearray) -> bytes:
    """Return the cyclic redundancy check of a block, low byte first (clause 9.2.4.2)."""
    value = 0
    for byte in data:
        value = value >> 8 ^ _TABLE[(value ^ byte) & 0xFF]
    return (value ^ 0xFFFF).to_bytes(2, "little")


def link_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the frame at the beginning of the buffer, check sums included; None while too little of it has arrived.

    Raises:
        MalformedError: no frame begins like that.
    """
    if buffer[:2] != _START[: len(buffer[:2])]:
        raise MalformedError(f"link: it begins with {buffer[:2].hex()}, not with 0564")
    if len(buffer) < 3:
        return None
    user = buffer[2] - 5
    if user < 0:
        raise MalformedError(f"link: length {buffer[2]}")
    return _HEADER + user + 2 * -(-user // _BLOCK)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkFrame:
    """A frame.

    Attributes:
        function: of a primary station (``primary``) or of a secondary one.
        from_master: direction bit.
        data: user data, without check sums.
    """

    function: int
    primary: bool
    from_master: bool
    destination: int
    source: int
    data: bytes = b""

    @classmethod
    def parse(cls, raw: bytes) -> LinkFrame:
        """Read a frame.

        Raises:
            MalformedError: a check sum is wrong.
        """
        if crc(raw[:8]) != raw[8:_HEADER]:
            raise MalformedError("link: the check sum of the header is wrong")
        data = b""
        for start in range(_HEADER, len(raw), _BLOCK + 2):
            block = raw[start : start + _BLOCK + 2]
            if crc(block[:-2]) != block[-2:]:
                raise MalformedError("link: a check sum of the data is wrong")
            data += block[:-2]
        control, destination, source = struct.unpack_from("<BHH", raw, 3)
        return cls(
            function=control & 0x0F,
            primary=bool(control & _PRIMARY),
            from_master=bool(control & _FROM_MASTER),
            destination=destination,
            source=source,
            data=data,
        )

    def encoded(self) -> bytes:
        """Return the frame as it is on the wire."""
        control = self.function | _PRIMARY * self.primary | _FROM_MASTER * self.from_master
        header = _START + struct.pack("<BBHH", 5 + len(self.data), control, self.destination, self.source)
        blocks = (self.data[start : start + _BLOCK] for start in range(0, len(self.data), _BLOCK))
        return header + crc(header) + b"".join(block + crc(block) for block in blocks)


def segments(fragment: bytes, sequence: int) -> list[bytes]:
    """Return the transport segments of an application fragment; the first has this sequence number."""
    parts = [fragment[start : start + _SEGMENT] for start in range(0, len(fragment), _SEGMENT)]
    return [
        bytes([FIRST * (not number) | _FIN * (number == len(parts) - 1) | (sequence + number) & 0x3F]) + part
        for number, part in enumerate(parts)
    ]


class Reassembly:
    """Transport segments on their way to an application fragment."""

    def __init__(self) -> None:
        self._fragment = bytearray()
        self._next: int | None = None

    def take(self, segment: bytes) -> bytes | None:
        """Add a segment; return the fragment that it completes.

        Raises:
            MalformedError: it does not follow what was there.
        """
        if not segment:
            raise MalformedError("transport: a segment without its header")
        header = segment[0]
        sequence = header & 0x3F
        if header & FIRST:
            # A first segment discards what was not finished (clause 8.2.1).
            self._fragment.clear()
        elif sequence != self._next:
            raise MalformedError(f"transport: a segment {sequence}, expected {self._next}")
        self._fragment += segment[1:]
        if len(self._fragment) > LARGEST_FRAGMENT:
            raise MalformedError(f"transport: a fragment of more than {LARGEST_FRAGMENT} bytes")
        if not header & _FIN:
            self._next = (sequence + 1) & 0x3F
            return None
        self._next = None
        return bytes(self._fragment)
