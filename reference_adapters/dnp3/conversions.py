"""Between points of answers and what tools say of them, and between what an alias is to hold and the objects that write it."""

from __future__ import annotations

import struct
from collections.abc import Callable

from ..core import AdapterError
from .aliases import Alias
from .commands import analog_command, binary_command
from .connection import Response
from .objects import Point
from .shapes import AliasEntry, PointValue

__all__ = ["command_for", "entry", "exactly", "holds", "shown", "text"]


def exactly(response: Response, kind: str, indexes: range) -> list[Point]:
    """Return the points that were asked for, in the order of their indexes.

    Raises:
        AdapterError: the answer has others, or not all.
    """
    if [(point.kind, point.index) for point in response.points] != [(kind, index) for index in indexes]:
        raise AdapterError("protocol_error", "the outstation answered about other points than it was asked for")
    return list(response.points)


def shown(point: Point) -> PointValue:
    """Return a point as tools tell it."""
    return {
        "point_type": point.kind,
        "index": point.index,
        "value": point.value,
        "special": point.special,
        "flags": None if point.flags is None else list(point.flags),
        "timestamp": None if point.time is None else point.time.isoformat(timespec="milliseconds"),
    }


def text(point: Point) -> str:
    """Return the text of an octet string.

    Raises:
        AdapterError: its bytes are no UTF-8.
    """
    try:
        return point.content.decode()
    except UnicodeDecodeError:
        raise AdapterError("type_mismatch", "the octet string is no text in UTF-8") from None


def entry(name: str, alias: Alias) -> AliasEntry:
    """Return an entry of the alias map as ``list_points`` tells it."""
    return {
        "alias": name,
        "outstation_address": alias.outstation_address,
        "point_type": alias.point_type,
        "index": alias.index,
        "data_type": alias.data_type,
        "unit": alias.unit,
        "writable": alias.writable,
    }


def command_for(alias: Alias, value: object) -> bytes:
    """Return the object that operates the output of an alias.

    Raises:
        AdapterError: the output has no such values.
    """
    if alias.point_type == "analog_output":
        assert alias.data_type is not None
        return analog_command(alias.index, alias.data_type, value)
    if not isinstance(value, bool):
        message = "a binary output is switched by true or false"
        raise AdapterError("type_mismatch", message, field="/value", outcome="not_sent")
    return binary_command(alias.index, "latch_on" if value else "latch_off", 1, 0, 0)


def holds(alias: Alias, objects: bytes, value: object) -> Callable[[Point], bool]:
    """Return the test whether a point holds what was written."""
    if alias.point_type == "octet_string":
        return lambda point: isinstance(value, str) and point.content == value.encode()
    if alias.data_type == "float32":
        # The nearest number that the command could carry, whichever variation tells it.
        (carried,) = struct.unpack("<f", objects[-5:-1])
        return lambda point: point.value == carried
    return lambda point: point.value == value and isinstance(point.value, bool) == isinstance(value, bool)
