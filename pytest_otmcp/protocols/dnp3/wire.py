"""Frames of the data link layer, segments of the transport function and object headers, for recorded bytes (IEEE 1815, clauses 9, 8 and
4.2, annex A). Pure."""

from __future__ import annotations

import math
import struct
from typing import Any

from ...wire.framing import MalformedError

__all__ = ["LinkHeader", "Segments", "link_length", "objects_of", "unpack_frame"]

_LONGEST = 2048
_BLOCK, _SUM = 16, 2
_TIME = 6

_BITS = frozenset({(1, 1), (10, 1), (80, 1)})
"""Objects of one bit."""
_TEXTS = frozenset({110, 111})
"""Groups of octet strings, whose variation is their length."""
_BINARY = frozenset({1, 2, 10})
"""Groups whose objects hold a state as the highest bit of their flags."""
_NUMBERS = {
    20: {1: "I", 2: "H", 5: "-I", 6: "-H"},
    30: {1: "i", 2: "h", 3: "-i", 4: "-h", 5: "f", 6: "d"},
    32: {1: "i", 2: "h", 3: "i@", 4: "h@", 5: "f", 6: "d", 7: "f@", 8: "d@"},
    40: {1: "i", 2: "h", 3: "f", 4: "d"},
}
"""Numbers of a point by group and variation: their form; ``-`` for those without flags, ``@`` for those with a time."""
_COMMANDS = {1: "i", 2: "h", 3: "f", 4: "d"}
"""Values of analog output commands (group 41) by variation."""


def _remainders() -> list[int]:
    table = list(range(256))
    for _ in range(8):
        table = [value >> 1 ^ 0xA6BC * (value & 1) for value in table]
    return table


_REMAINDERS = _remainders()


def _is_intact(block: bytes) -> bool:
    remainder = 0
    for octet in block[:-_SUM]:
        remainder = _REMAINDERS[(remainder ^ octet) & 0xFF] ^ remainder >> 8
    return int.from_bytes(block[-_SUM:], "little") == remainder ^ 0xFFFF


def link_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the link frame at the beginning of the buffer, with its check sums.

    Raises:
        MalformedError: no frame begins like that.
    """
    start = bytes(buffer[:2])
    if not b"\x05\x64".startswith(start):
        raise MalformedError(f"a link frame begins with 0564, this with {start.hex()}")
    if len(buffer) < 3:
        return None
    if buffer[2] < 5:
        raise MalformedError(f"the length of the link frame is {buffer[2]}, it must be 5 or more")
    blocks, rest = divmod(buffer[2] - 5, _BLOCK)
    return 10 + blocks * (_BLOCK + _SUM) + (rest + _SUM if rest else 0)


class LinkHeader:
    """Header of a link frame.

    Attributes:
        function: of a primary station, where ``primary``, or of a secondary one.
        from_master: its direction.
        destination, source: link addresses.
    """

    def __init__(self, frame: bytes) -> None:
        control, self.destination, self.source = struct.unpack_from("<BHH", frame, 3)
        self.function = control & 0x0F
        self.primary = bool(control & 0x40)
        self.from_master = bool(control & 0x80)


def unpack_frame(frame: bytes) -> tuple[LinkHeader, bytes] | None:
    """Return header and user data of a whole frame; None where a check sum is wrong."""
    if not _is_intact(frame[:10]):
        return None
    data = bytearray()
    for start in range(10, len(frame), _BLOCK + _SUM):
        block = frame[start : start + _BLOCK + _SUM]
        if not _is_intact(block):
            return None
        data += block[:-_SUM]
    return LinkHeader(frame), bytes(data)


class Segments:
    """The transport segments of one direction."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._expected = -1

    def add(self, segment: bytes) -> bytes | None:
        """Add a segment; return the fragment that it completes.

        Raises:
            MalformedError: it does not follow the one before.
        """
        if not segment:
            raise MalformedError("a frame with user data has no transport header")
        number = segment[0] & 0x3F
        if segment[0] & 0x40:
            self._parts = []
        elif number != self._expected:
            raise MalformedError(f"the transport segment {number} does not follow the one before")
        self._parts.append(segment[1:])
        if sum(map(len, self._parts)) > _LONGEST:
            raise MalformedError(f"a fragment has more than {_LONGEST} bytes")
        if segment[0] & 0x80:
            whole, self._parts, self._expected = b"".join(self._parts), [], -1
            return whole
        self._expected = (number + 1) & 0x3F
        return None


def objects_of(data: bytes, *, with_objects: bool) -> list[dict[str, Any]]:
    """Return the object headers of a fragment with what follows them.

    Args:
        with_objects: objects follow, not only indexes.

    Raises:
        MalformedError: they cannot be read.
    """
    found = []
    position = 0
    while position < len(data):
        header, position = _header(data, position, with_objects)
        found.append(header)
    return found


def _take(data: bytes, position: int, size: int) -> tuple[bytes, int]:
    if position + size > len(data):
        raise MalformedError("the objects are cut off")
    return data[position : position + size], position + size


def _number(data: bytes, position: int, size: int) -> tuple[int, int]:
    octets, position = _take(data, position, size)
    return int.from_bytes(octets, "little"), position


def _header(data: bytes, position: int, with_objects: bool) -> tuple[dict[str, Any], int]:
    (group, variation, qualifier), position = _take(data, position, 3)
    header: dict[str, Any] = {"group": group, "variation": variation, "qualifier": qualifier}
    prefix = {0x17: 1, 0x28: 2}.get(qualifier, 0)
    if qualifier == 0x06:
        return header, position
    first = 0
    if qualifier in (0x00, 0x01):
        first, position = _number(data, position, 1 + qualifier)
        last, position = _number(data, position, 1 + qualifier)
        if last < first:
            raise MalformedError(f"a range from {first} to {last}")
        header |= {"start": first, "stop": last}
        count = last - first + 1
    elif qualifier in (0x07, 0x08, 0x17, 0x28):
        count, position = _number(data, position, 1 if qualifier in (0x07, 0x17) else 2)
        header["count"] = count
    else:
        raise MalformedError(f"the qualifier {qualifier:02X}")
    points: list[dict[str, Any]] = []
    if not with_objects and prefix:
        for _ in range(count):
            index, position = _number(data, position, prefix)
            points.append({"index": index})
    elif with_objects and (group, variation) in _BITS and not prefix:
        octets, position = _take(data, position, -(-count // 8))
        points = [
            {"index": first + place, "value": bool(octets[place // 8] >> place % 8 & 1)} for place in range(count)
        ]
    elif with_objects:
        size = _size(group, variation)
        for place in range(count):
            point: dict[str, Any] = {"index": first + place} if "start" in header else {}
            if prefix:
                point["index"], position = _number(data, position, prefix)
            octets, position = _take(data, position, size)
            points.append(point | _members(group, variation, octets))
    return header | ({"points": points} if points else {}), position


def _form(group: int, variation: int) -> str | None:
    return _NUMBERS.get(group, {}).get(variation)


def _size(group: int, variation: int) -> int:
    form = _form(group, variation)
    if form is not None:
        return struct.calcsize("<" + form.strip("-@")) + ("-" not in form) + _TIME * ("@" in form)
    if group in _TEXTS:
        return variation
    sizes = {(1, 2): 1, (2, 1): 1, (2, 2): 1 + _TIME, (10, 2): 1, (12, 1): 11, (50, 1): _TIME, (50, 3): _TIME}
    sizes |= {(52, 1): 2, (52, 2): 2}
    sizes |= {(41, number): struct.calcsize("<" + form) + 1 for number, form in _COMMANDS.items()}
    if (group, variation) not in sizes:
        raise MalformedError(f"the object g{group}v{variation} is not known")
    return sizes[group, variation]


def _members(group: int, variation: int, octets: bytes) -> dict[str, Any]:
    """Return what an object says."""
    form = _form(group, variation)
    if form is not None:
        flags = {} if "-" in form else {"flags": octets[0]}
        number = struct.unpack_from("<" + form.strip("-@"), octets, len(flags))[0]
        stamp = {"time_ms": int.from_bytes(octets[-_TIME:], "little")} if "@" in form else {}
        return {**flags, "value": _json(number), **stamp}
    if group in _TEXTS:
        return {"octets": octets.hex()}
    if group in _BINARY:
        state = {"flags": octets[0] & 0x7F, "value": bool(octets[0] & 0x80)}
        return state | ({"time_ms": int.from_bytes(octets[1:], "little")} if len(octets) > 1 else {})
    if group == 12:
        code, count, on_ms, off_ms, status = struct.unpack("<BBIIB", octets)
        return {"code": code, "count": count, "on_ms": on_ms, "off_ms": off_ms, "status": status}
    if group == 41:
        return {"value": _json(struct.unpack_from("<" + _COMMANDS[variation], octets)[0]), "status": octets[-1]}
    return {"time_ms" if group == 50 else "value": int.from_bytes(octets, "little")}


def _json(number: float) -> object:
    if isinstance(number, float) and not math.isfinite(number):
        return "NaN" if math.isnan(number) else "Infinity" if number > 0 else "-Infinity"
    return number
