"""The points of the mock EtherCAT segment: objects of its drive, inputs and outputs of its slaves, as bytes and by the names of an alias map."""

from __future__ import annotations

import random
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

__all__ = [
    "ACCELERATION",
    "DRIVE",
    "KINDS",
    "LONGEST",
    "SIZES",
    "TERMINAL",
    "TEXTS",
    "TYPED",
    "bytes_of",
    "content_of",
    "inputs_of",
    "object_at",
    "output_named",
    "outputs_of",
]

TERMINAL, DRIVE = 0, 1
"""Positions."""
SIZES = {TERMINAL: 2, DRIVE: 8}
"""Bytes of inputs, and of outputs, of each."""
LONGEST = 32
"""Characters of the text that a client may write."""
KINDS: Mapping[str, Kind] = {
    "INT8": INT8,
    "UINT8": UINT8,
    "INT16": INT16,
    "UINT16": UINT16,
    "INT32": INT32,
    "UINT32": UINT32,
    "INT64": INT64,
    "UINT64": UINT64,
    "FLOAT32": FLOAT32,
    "FLOAT64": FLOAT64,
    "BOOL": BOOL,
    "STRING": TEXT,
}
_TYPED, _TEXT, _ACCELERATION = 0x2001, 0x2002, 0x2000


def content_of(kind: str, value: Any) -> bytes:
    """Return a value as it is on the wire.

    Raises:
        struct.error: the type has no such value.
    """
    if kind == "STRING":
        return str(value).encode("latin-1", "replace")
    return struct.pack(f"<{KINDS[kind].form}", value)


def object_at(index: int, subindex: int, kind: str, slave: int = DRIVE) -> Point:
    """Return the point that is an object of a slave."""
    place = {"slave": slave, "index": index, "subindex": subindex, "type": kind}
    name = f"{slave}:{index:04x}:{subindex}"

    def pokes(value: Any) -> tuple[Mapping[str, object], ...]:
        return ({"slave": slave, "object": [index, subindex], "data": content_of(kind, value).hex()},)

    def held(value: Any) -> Mapping[str, object]:
        # What it holds is what can be packed: a number of 32 bits is rounded.
        content = content_of(kind, value)
        return {name: value if kind == "STRING" else struct.unpack(f"<{KINDS[kind].form}", content)[0]}

    def found(image: Image) -> object:
        return image["points"][name]

    return Point(
        kind=KINDS[kind],
        reading=Call("read_sdo", place),
        writing=Call("write_sdo", place),
        pokes=pokes,
        held=held,
        found=found,
        condition={"service": "sdo_upload", "slave": slave},
    )


TYPED = {
    kind: object_at(_TYPED, number, kind) for number, kind in enumerate((*KINDS,), start=1) if KINDS[kind] is not TEXT
}
"""An object of each type that has a size; nothing uses them."""
TEXTS = object_at(_TEXT, 0, "STRING")
ACCELERATION = object_at(_ACCELERATION, 1, "UINT16")
"""An object that takes 0 to 1000."""


def bytes_of(rng: random.Random, slave: int) -> list[int]:
    """Return bytes for a slave, of which none is zero, as those of a slave are that is not in OP."""
    return [rng.randrange(1, 0x100) for _ in range(SIZES[slave])]


def inputs_of(slave: int) -> Point:
    """Return the inputs of a slave, as a list of numbers."""

    def found(image: Image) -> list[Any]:
        return [image["points"][name] for name in points(slave, "input", bytes(SIZES[slave]))]

    return Point(
        kind=UINT8,
        reading=Call("read_inputs", {"slave": slave}),
        pokes=lambda values: ({"slave": slave, "inputs": bytes(values).hex()},),
        held=lambda values: points(slave, "input", bytes(values)),
        found=found,
        output="values",
        condition={"slave": slave},
    )


def outputs_of(slave: int) -> Point:
    """Return the outputs of a slave. A master repeats its own: others that were set at the slave would not stay."""
    return Point(
        kind=UINT8,
        writing=Call("write_outputs", {"slave": slave}),
        held=lambda values: points(slave, "output", bytes(values)),
        output="values",
        given_as="data",
    )


def output_named(name: str, kind: Kind, offset: int) -> Point:
    """Return the value with a name in the outputs of the drive."""
    call = {"name": name}
    return Point(
        kind=kind,
        reading=Call("read_alias", call),
        writing=Call("write_alias", call),
        held=lambda value: points(DRIVE, "output", struct.pack(f"<{kind.form}", value), offset),
    )
