"""The points of the mock S7 controller: values of its data blocks, each at a byte, and of the type that is asked for."""

from __future__ import annotations

import struct
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
from .entries import points

__all__ = ["BLOCK", "KINDS", "PLANT", "content_of", "of_bytes", "value_at"]

PLANT, BLOCK = 1, 10
"""Data blocks: the plant's, and the clients'."""
DECLARED = 60
"""Characters that the STRING is declared with."""

KINDS: Mapping[str, Kind] = {
    "BYTE": UINT8,
    "WORD": UINT16,
    "DWORD": UINT32,
    "USINT": UINT8,
    "UINT": UINT16,
    "UDINT": UINT32,
    "SINT": INT8,
    "INT": INT16,
    "DINT": INT32,
    "REAL": FLOAT32,
    "LREAL": FLOAT64,
    "LINT": INT64,
    "ULINT": UINT64,
    "BOOL": BOOL,
    "STRING": TEXT,
}


def content_of(kind: str, value: Any) -> bytes:
    """Return a value as it lies in a data block.

    Raises:
        struct.error: the type has no such value.
    """
    if kind == "STRING":
        text = str(value).encode("latin-1", "replace")
        return bytes([DECLARED, len(text)]) + text
    return struct.pack(f">{KINDS[kind].form}", value)


def value_at(start: int, kind: str = "INT", db: int = BLOCK) -> Point:
    """Return the point from a byte of a data block on."""
    area, form = f"DB{db}", KINDS[kind].form
    place = {"db": db, "start": start, "type": kind}

    def pokes(value: Any) -> tuple[Mapping[str, object], ...]:
        # The other bits of a BOOL's byte are not the adapter's.
        content = bytes([1 if value else 0xFE]) if kind == "BOOL" else content_of(kind, value)
        return ({"area": area, "byte": start, "data": content.hex()},)

    def found(image: Image) -> object:
        names = points(area, start, bytes(KINDS[kind].size))
        return struct.unpack(f">{form}", bytes(image["points"][name] for name in names))[0]

    return Point(
        kind=KINDS[kind],
        reading=Call("read_typed", place),
        writing=Call("write_db", place),
        pokes=pokes,
        held=lambda value: points(area, start, content_of(kind, value)),
        found=found,
        condition={"service": "read", "db": db, "byte": start},
    )


def of_bytes(start: int, size: int, db: int = BLOCK) -> Point:
    """Return the point of several bytes, as a list of numbers."""
    area = f"DB{db}"
    return Point(
        kind=UINT8,
        reading=Call("read_db", {"db": db, "start": start, "size": size}),
        pokes=lambda values: ({"area": area, "byte": start, "data": bytes(values).hex()},),
        held=lambda values: points(area, start, bytes(values)),
        output="values",
    )
