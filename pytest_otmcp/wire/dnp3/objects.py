"""Object headers and objects of the application layer (IEEE 1815, clause 4.2 and annex A). It handles bytes only.

Values in journal entries are JSON: what is no number, or infinite, is ``"NaN"``, ``"Infinity"`` or ``"-Infinity"``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = [
    "ALL",
    "COUNT8",
    "COUNT16",
    "FORMATS",
    "INDEX8",
    "INDEX16",
    "OCTETS",
    "PACKED",
    "START_STOP8",
    "START_STOP16",
    "Header",
    "IllegalObject",
    "UnknownObject",
    "as_json",
    "encode",
    "headers",
]

START_STOP8, START_STOP16, ALL, COUNT8, COUNT16, INDEX8, INDEX16 = 0x00, 0x01, 0x06, 0x07, 0x08, 0x17, 0x28
"""Qualifier codes: prefix code and range specifier code (table 4-5)."""

PACKED = frozenset({(1, 1), (10, 1), (80, 1)})
"""Group and variation of objects of one bit, eight to a byte."""
OCTETS = frozenset({110, 111})
"""Groups whose variation is the length of their octets."""

FORMATS: dict[tuple[int, int], tuple[str, str]] = {
    (1, 2): ("flags", "B"),
    (2, 1): ("flags", "B"),
    (2, 2): ("flags time_ms", "B6s"),
    (10, 2): ("flags", "B"),
    (12, 1): ("code count on_ms off_ms status", "BBIIB"),
    (20, 1): ("flags value", "BI"),
    (20, 2): ("flags value", "BH"),
    (20, 5): ("value", "I"),
    (20, 6): ("value", "H"),
    (30, 1): ("flags value", "Bi"),
    (30, 2): ("flags value", "Bh"),
    (30, 3): ("value", "i"),
    (30, 4): ("value", "h"),
    (30, 5): ("flags value", "Bf"),
    (30, 6): ("flags value", "Bd"),
    (32, 1): ("flags value", "Bi"),
    (32, 2): ("flags value", "Bh"),
    (32, 3): ("flags value time_ms", "Bi6s"),
    (32, 4): ("flags value time_ms", "Bh6s"),
    (32, 5): ("flags value", "Bf"),
    (32, 6): ("flags value", "Bd"),
    (32, 7): ("flags value time_ms", "Bf6s"),
    (32, 8): ("flags value time_ms", "Bd6s"),
    (40, 1): ("flags value", "Bi"),
    (40, 2): ("flags value", "Bh"),
    (40, 3): ("flags value", "Bf"),
    (40, 4): ("flags value", "Bd"),
    (41, 1): ("value status", "iB"),
    (41, 2): ("value status", "hB"),
    (41, 3): ("value status", "fB"),
    (41, 4): ("value status", "dB"),
    (50, 1): ("time_ms", "6s"),
    (50, 3): ("time_ms", "6s"),
    (52, 1): ("value", "H"),
    (52, 2): ("value", "H"),
}
"""Members and form of the objects that are known here; the state of a binary point is bit 7 of its flags."""

_STATES = frozenset({1, 2, 10})
"""Groups of binary points."""


class IllegalObject(ValueError):
    """The objects of a request cannot be read; the text says why. An outstation answers with IIN2.2, parameter error."""


class UnknownObject(IllegalObject):
    """The object is not known here, so that nothing behind it can be read: IIN2.1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """An object header with its objects.

    Attributes:
        start, stop: indexes of a range, None for another qualifier.
        count: how many objects are wanted or, with a ``start`` of None, are here.
        points: the objects, or the indexes alone, with a member ``index`` where the header has indexes.
        raw: the bytes of each object.
    """

    group: int
    variation: int
    qualifier: int
    start: int | None = None
    stop: int | None = None
    count: int | None = None
    points: Sequence[dict[str, Any]] = ()
    raw: Sequence[bytes] = ()

    def described(self) -> dict[str, Any]:
        """Return the members that a journal entry has of it."""
        found: dict[str, Any] = {"group": self.group, "variation": self.variation, "qualifier": self.qualifier}
        given = {"start": self.start, "stop": self.stop, "count": self.count}
        found |= {name: value for name, value in given.items() if value is not None}
        return found | ({"points": [_shown(point) for point in self.points]} if self.points else {})


def as_json(value: Any) -> Any:
    """Return a value as JSON has it."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def _shown(point: dict[str, Any]) -> dict[str, Any]:
    return {name: as_json(value) for name, value in point.items()}


class _Reader:
    """Bytes that are taken one after the other."""

    def __init__(self, raw: bytes) -> None:
        self._raw = raw
        self.position = 0

    @property
    def left(self) -> int:
        return len(self._raw) - self.position

    def take(self, count: int) -> bytes:
        if count > self.left:
            raise IllegalObject("the objects are cut off")
        self.position += count
        return self._raw[self.position - count : self.position]

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")


def headers(raw: bytes, *, with_objects: bool) -> list[Header]:
    """Read object headers.

    Args:
        with_objects: objects follow their headers, as in every function but reads and those that name classes.

    Raises:
        IllegalObject: they cannot be read.
    """
    reader = _Reader(raw)
    found = []
    while reader.left:
        found.append(_header(reader, with_objects))
    return found


def _header(reader: _Reader, with_objects: bool) -> Header:
    group, variation, qualifier = reader.take(3)
    kind: dict[str, Any] = {"group": group, "variation": variation, "qualifier": qualifier}
    if qualifier == ALL:
        return Header(**kind)
    if qualifier in (START_STOP8, START_STOP16):
        start, stop = (reader.number(1 + qualifier) for _ in range(2))
        if stop < start:
            raise IllegalObject(f"a range from {start} to {stop}")
        indexes: Iterable[int] = range(start, stop + 1)
        place: dict[str, Any] = {"start": start, "stop": stop}
        size = 0
    elif qualifier in (COUNT8, COUNT16, INDEX8, INDEX16):
        size = {COUNT8: 0, COUNT16: 0, INDEX8: 1, INDEX16: 2}[qualifier]
        count = reader.number(1 if qualifier in (COUNT8, INDEX8) else 2)
        indexes, place = range(count), {"count": count}
    else:
        raise IllegalObject(f"qualifier {qualifier:02X}")
    if not with_objects:
        points = [{"index": reader.number(size)} for _ in indexes] if size else []
        return Header(**kind, **place, points=points)
    return _with_objects(reader, kind, place, list(indexes), size)


def _with_objects(
    reader: _Reader, kind: dict[str, Any], place: dict[str, Any], indexes: list[int], size: int
) -> Header:
    group, variation = kind["group"], kind["variation"]
    if (group, variation) in PACKED and not size:
        bits = int.from_bytes(reader.take((len(indexes) + 7) // 8), "little")
        points = [{"index": index, "value": bool(bits >> number & 1)} for number, index in enumerate(indexes)]
        return Header(**kind, **place, points=points)
    if (group, variation) not in FORMATS and group not in OCTETS:
        raise UnknownObject(f"object g{group}v{variation}")
    numbered = "start" in place
    points, raw = [], []
    for number in indexes:
        index = {"index": reader.number(size)} if size else {"index": number} if numbered else {}
        content = reader.take(_size(group, variation))
        raw.append(content)
        points.append({**index, **_members(group, variation, content)})
    return Header(**kind, **place, points=points, raw=raw)


def _size(group: int, variation: int) -> int:
    return variation if group in OCTETS else struct.calcsize("<" + FORMATS[group, variation][1])


def _members(group: int, variation: int, content: bytes) -> dict[str, Any]:
    """Return what an object says."""
    if group in OCTETS:
        return {"octets": content.hex()}
    names, form = FORMATS[group, variation]
    found = dict(zip(names.split(), struct.unpack("<" + form, content), strict=True))
    if "time_ms" in found:
        found["time_ms"] = int.from_bytes(found["time_ms"], "little")
    if group in _STATES:
        found["value"], found["flags"] = bool(found["flags"] & 0x80), found["flags"] & 0x7F
    return found


def encode(group: int, variation: int, point: dict[str, Any]) -> bytes:
    """Return an object that is not packed, without its index.

    Args:
        point: its members, see :data:`FORMATS`; ``octets`` of an octet string, ``value`` of a binary point.
    """
    if group in OCTETS:
        return bytes.fromhex(point["octets"])
    names, form = FORMATS[group, variation]
    given = dict(point)
    if group in _STATES:
        given["flags"] |= 0x80 * given["value"]
    if "time_ms" in given:
        given["time_ms"] = given["time_ms"].to_bytes(6, "little")
    return struct.pack("<" + form, *(given[name] for name in names.split()))
