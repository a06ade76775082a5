"""The points of the outstation: their types, quality flags and static objects (IEEE 1815, clause 11 and annex A)."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from pytest_otmcp.wire.dnp3.objects import FORMATS, OCTETS, PACKED, START_STOP8, encode

__all__ = ["FLAGS", "GROUPS", "ONLINE", "Point", "converted", "fits", "flag_names", "known", "static_objects"]

ONLINE, _OVER_RANGE = 0x01, 0x20
FLAGS = {
    "ONLINE": 0x01,
    "RESTART": 0x02,
    "COMM_LOST": 0x04,
    "REMOTE_FORCED": 0x08,
    "LOCAL_FORCED": 0x10,
    "OVER_RANGE": 0x20,
    "REFERENCE_ERR": 0x40,
}
"""Quality flags of analog points; the others have the first five of them (clauses 11.6 to 11.9)."""

GROUPS = {
    "binary_input": 1,
    "binary_output": 10,
    "counter": 20,
    "analog_input": 30,
    "analog_output": 40,
    "octet_string": 110,
}
"""Types of points to the groups of their static objects."""

_DEFAULTS = {
    (1, "bool"): 2,
    (10, "bool"): 2,
    (20, "uint32"): 1,
    (30, "int32"): 1,
    (30, "float"): 5,
    (30, "double"): 6,
    (40, "int32"): 1,
    (40, "float"): 3,
}
"""Variations that are answered with where none is asked for, by group and kind of value."""
_WITH_FLAGS = {(1, 1): 2, (10, 1): 2, (20, 5): 1, (20, 6): 2, (30, 3): 1, (30, 4): 2}
"""Variations without flags, and those that take their place where a point is not just online (clause 5.1.4.2)."""
_INTEGERS = {"i": (-(2**31), 2**31 - 1), "h": (-(2**15), 2**15 - 1), "I": (0, 2**32 - 1), "H": (0, 2**16 - 1)}


@dataclass(slots=True, kw_only=True)
class Point:
    """A point.

    Attributes:
        type: name, such as ``analog_input``.
        kind: what it holds: ``bool``, ``int32``, ``uint32``, ``float``, ``double`` or ``octets``.
        event_class: class of the events that its changes make; 0 for none.
    """

    type: str
    index: int
    kind: str
    value: Any
    flags: int = ONLINE
    event_class: int = 0

    @property
    def name(self) -> str:
        """Name in the image."""
        return f"{self.type}/{self.index}"

    @property
    def group(self) -> int:
        """Group of its static object."""
        return GROUPS[self.type]


def flag_names(flags: int) -> list[str]:
    """Return the names of quality flags."""
    return [name for name, bit in FLAGS.items() if flags & bit]


def fits(kind: str, value: Any) -> bool:
    """Tell whether a point of this kind can hold a value."""
    if kind == "bool":
        return isinstance(value, bool)
    if kind == "octets":
        return isinstance(value, bytes) and 1 <= len(value) <= 255
    if kind in ("int32", "uint32"):
        lowest, highest = _INTEGERS["i" if kind == "int32" else "I"]
        return type(value) is int and lowest <= value <= highest
    return type(value) in (int, float) and (kind == "double" or not math.isfinite(value) or _is_single(value))


def _is_single(value: float) -> bool:
    try:
        struct.pack("<f", value)
    except OverflowError:
        return False
    return True


def static_objects(points: Sequence[Point], variation: int, indexed: int | None = None) -> bytes:
    """Return the static objects of points of one group, whose indexes are in order and without gaps.

    Args:
        variation: that is asked for; 0 for any.
        indexed: qualifier with which each object has its index; None for ranges.
    """
    found = b""
    for number, run in groupby(points, lambda point: _variation(point, variation)):
        same = list(run)
        head = bytes([same[0].group, number])
        if indexed is not None:
            size = 1 + (indexed != 0x17)
            objects = b"".join(point.index.to_bytes(size, "little") + _object(point, number) for point in same)
            found += head + bytes([indexed]) + len(same).to_bytes(size, "little") + objects
            continue
        found += head + bytes([START_STOP8, same[0].index, same[-1].index])
        if (same[0].group, number) in PACKED:
            bits = sum(point.value << position for position, point in enumerate(same))
            found += bits.to_bytes((len(same) + 7) // 8, "little")
        else:
            found += b"".join(_object(point, number) for point in same)
    return found


def known(group: int, variation: int) -> bool:
    """Tell whether there is such a static object."""
    return group in GROUPS.values() and (
        variation == 0 or (group, variation) in FORMATS or (group, variation) in PACKED
    )


def _variation(point: Point, asked: int) -> int:
    if point.group in OCTETS:
        return len(point.value)
    number = asked or _DEFAULTS[point.group, point.kind]
    return _WITH_FLAGS.get((point.group, number), number) if point.flags != ONLINE else number


def _object(point: Point, variation: int) -> bytes:
    if point.group in OCTETS:
        return bytes(point.value)
    value, flags = converted(point.value, FORMATS.get((point.group, variation), ("", ""))[1], point.flags)
    return encode(point.group, variation, {"value": value, "flags": flags})


def converted(value: Any, form: str, flags: int) -> tuple[Any, int]:
    """Return a value as an object of this form holds it, and its flags: what does not fit is brought within, and is over range."""
    bounds = next((bounds for letter, bounds in _INTEGERS.items() if letter in form), None)
    if isinstance(value, bool) or (bounds is None and "f" not in form):
        return value, flags
    if bounds is None:
        if math.isfinite(value) and not _is_single(value):
            return math.copysign(math.inf, value), flags | _OVER_RANGE
        return float(value), flags
    if isinstance(value, float) and math.isnan(value):
        return 0, flags | _OVER_RANGE
    lowest, highest = bounds
    within = min(max(value, lowest), highest)
    return int(within), flags | (_OVER_RANGE if within != value else 0)
