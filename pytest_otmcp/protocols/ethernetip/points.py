"""The points of the mock Logix controller: its tags, elements of its arrays, and the names of an adapter's list."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..journal import Image
from ..point import (
    BOOL,
    FLOAT32,
    FLOAT64,
    INT8,
    INT16,
    INT32,
    INT64,
    TEXT,
    UINT8,
    UINT16,
    UINT32,
    UINT64,
    Kind,
    Point,
)
from ..proof import Call

__all__ = ["ARRAY", "ELEMENT", "KINDS", "LEVEL", "TARGET", "VALVE", "array", "elements", "poke", "tag"]

ARRAY, ELEMENT = "Counts", "INT"
"""An array that belongs to the clients, and the type of its elements."""

KINDS: Mapping[str, Kind] = {
    "SINT": INT8,
    "INT": INT16,
    "DINT": INT32,
    "LINT": INT64,
    "USINT": UINT8,
    "UINT": UINT16,
    "UDINT": UINT32,
    "ULINT": UINT64,
    "REAL": FLOAT32,
    "LREAL": FLOAT64,
    "BOOL": BOOL,
    "STRING": TEXT,
}


def poke(name: str, value: object) -> dict[str, object]:
    """Return the poke that sets a tag."""
    return {"tag": name, "value": value}


def tag(name: str, kind: str = "DINT", *, alias: str | None = None) -> Point:
    """Return the value of a tag.

    Args:
        alias: name that the adapter has for it, by which it reads and writes.
    """
    call = {"name": alias}
    return Point(
        kind=KINDS[kind],
        reading=Call("read_alias", call) if alias else Call("read_tag", {"tag": name}),
        writing=Call("write_alias", call) if alias else Call("write_tag", {"tag": name, "value": None, "type": kind}),
        pokes=lambda value: (poke(name, value),),
        held=lambda value: {name: value},
        found=lambda image: image["points"].get(name),
        condition={} if alias else {"service": "read", "tag": name},
    )


def elements(first: int, count: int, name: str = ARRAY) -> list[str]:
    """Return the names of elements of an array."""
    return [f"{name}[{index}]" for index in range(first, first + count)]


def array(first: int, count: int, name: str = ARRAY) -> Point:
    """Return elements of an array beside one another, as a list."""
    names = elements(first, count, name)

    def found(image: Image) -> list[object]:
        return [image["points"][one] for one in names]

    def held(values: Any) -> dict[str, object]:
        return dict(zip(names, values, strict=True))

    return Point(
        kind=INT16,
        reading=Call("read_array", {"tag": names[0], "count": count}),
        writing=Call("write_array", {"tag": names[0]}),
        pokes=lambda values: tuple(poke(*one) for one in held(values).items()),
        held=held,
        found=found,
        output="values",
        given_as="values",
    )


VALVE, TARGET = tag("ValvePosition"), tag("BatchTarget")
LEVEL = tag("Levels[1]", "REAL", alias="otmcp_level")
