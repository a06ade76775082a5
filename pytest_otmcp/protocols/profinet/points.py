"""The points of the mock PROFINET IO device: inputs and outputs of its subslots and records, as bytes, and as values with the names of an
alias map."""

from __future__ import annotations

import random
import struct
from typing import Any

from ..journal import Image
from ..point import Kind, Point
from ..proof import Call
from .entries import points

__all__ = [
    "DRIVE",
    "FREE",
    "PUMP",
    "SIZES",
    "STATION",
    "VALVES",
    "bytes_of",
    "input_named",
    "inputs_of",
    "outputs_of",
    "record_named",
    "record_of",
]

STATION = "kit-device"
DRIVE, PUMP, VALVES, HEATER = 1, 2, 3, 4
"""Slots: of these the first and the third have inputs and a record of the same size, the others have outputs."""
SIZES = {DRIVE: 8, PUMP: 8, VALVES: 2, HEATER: 2}
"""Bytes of each."""
FREE = 3
"""Index of the records that any bytes fit into."""
_BYTE = Kind("B")


def bytes_of(rng: random.Random, slot: int) -> list[int]:
    """Return bytes for a slot, of which none is zero, as outputs are that have no controller."""
    return [rng.randrange(1, 0x100) for _ in range(SIZES[slot])]


def _place(slot: int, **more: object) -> dict[str, Any]:
    return {"station": STATION, "slot": slot, "subslot": 1, **more}


def _bytes(slot: int, which: str, *, size: int | None = None, **more: Any) -> Point:
    length = SIZES[slot] if size is None else size

    def found(image: Image) -> list[Any]:
        return [image["points"][name] for name in points(slot, which, bytes(length))]

    return Point(
        kind=_BYTE, output="values", held=lambda values: points(slot, which, bytes(values)), found=found, **more
    )


def inputs_of(slot: int) -> Point:
    """Return the inputs of a slot, as a list of numbers."""
    return _bytes(
        slot,
        "input",
        reading=Call("read_inputs", _place(slot)),
        pokes=lambda values: ({"slot": slot, "inputs": bytes(values).hex()},),
        condition={"slot": slot},
    )


def outputs_of(slot: int) -> Point:
    """Return the outputs of a slot. A controller repeats its own: others that were set at the device would not stay."""
    return _bytes(slot, "output", writing=Call("write_outputs", _place(slot)), given_as="data")


def record_of(slot: int, index: int = FREE, *, size: int | None = None) -> Point:
    """Return a record, as a list of numbers."""
    place = _place(slot, index=index)
    return _bytes(
        slot,
        f"record.{index}",
        size=size,
        reading=Call("read_record", place),
        writing=Call("write_record", place),
        pokes=lambda values: ({"slot": slot, "index": index, "record": bytes(values).hex()},),
        given_as="data",
    )


def input_named(name: str, kind: Kind) -> Point:
    """Return the value with a name in the inputs of the first slot, from byte 0 on."""

    def pokes(value: Any) -> tuple[dict[str, object], ...]:
        return ({"slot": DRIVE, "inputs": struct.pack(f">{kind.form}", value).ljust(SIZES[DRIVE], b"\0").hex()},)

    return Point(kind=kind, reading=Call("read_alias", {"name": name}), pokes=pokes)


def record_named(name: str, kind: Kind, index: int) -> Point:
    """Return the value with a name that a record of the first slot is."""
    call = {"name": name}

    def content(value: Any) -> bytes:
        return struct.pack(f">{kind.form}", value)

    return Point(
        kind=kind,
        reading=Call("read_alias", call),
        writing=Call("write_alias", call),
        pokes=lambda value: ({"slot": DRIVE, "index": index, "record": content(value).hex()},),
        held=lambda value: points(DRIVE, f"record.{index}", content(value)),
    )
