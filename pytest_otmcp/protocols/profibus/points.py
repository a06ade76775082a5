"""The points of the mock PROFIBUS segment: inputs and outputs of its slaves, as bytes, and as values with the names of a tag list."""

from __future__ import annotations

import random
import struct
from typing import Any

from ..journal import Image
from ..point import Kind, Point
from ..proof import Call
from .entries import points

__all__ = ["DRIVE", "OTHERS", "SIZES", "VALVES", "bytes_of", "input_named", "inputs_of", "output_named", "outputs_of"]

VALVES, DRIVE, OTHERS = 5, 8, 9
"""Stations; the last one is another master's."""
SIZES = {VALVES: 2, DRIVE: 8, OTHERS: 1}
"""Bytes of inputs, and of outputs, of each."""
_BYTE = Kind("B")


def bytes_of(rng: random.Random, station: int) -> list[int]:
    """Return bytes for a station, of which none is zero, as those of a slave are that has no master yet."""
    return [rng.randrange(1, 0x100) for _ in range(SIZES[station])]


def inputs_of(station: int) -> Point:
    """Return the inputs of a slave, as a list of numbers."""

    def found(image: Image) -> list[Any]:
        return [image["points"][name] for name in points(station, "input", bytes(SIZES[station]))]

    return Point(
        kind=_BYTE,
        reading=Call("read_inputs", {"slave": station}),
        pokes=lambda values: ({"station": station, "inputs": bytes(values).hex()},),
        held=lambda values: points(station, "input", bytes(values)),
        found=found,
        output="values",
        condition={"station": station},
    )


def outputs_of(station: int) -> Point:
    """Return the outputs of a slave. A master repeats its own: others that were set at the slave would not stay."""
    return Point(
        kind=_BYTE,
        writing=Call("write_outputs", {"slave": station}),
        held=lambda values: points(station, "output", bytes(values)),
        output="values",
        given_as="data",
    )


def input_named(name: str, kind: Kind) -> Point:
    """Return the value with a name in the inputs of the drive, from byte 0 on."""

    def pokes(value: Any) -> tuple[dict[str, object], ...]:
        return ({"station": DRIVE, "inputs": struct.pack(f">{kind.form}", value).ljust(SIZES[DRIVE], b"\0").hex()},)

    return Point(kind=kind, reading=Call("read_alias", {"name": name}), pokes=pokes)


def output_named(name: str, kind: Kind, offset: int) -> Point:
    """Return the value with a name in the outputs of the drive."""
    call = {"name": name}
    return Point(
        kind=kind,
        reading=Call("read_alias", call),
        writing=Call("write_alias", call),
        held=lambda value: points(DRIVE, "output", struct.pack(f">{kind.form}", value), offset),
    )
