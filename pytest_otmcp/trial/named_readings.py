"""Named readings as calls: what is set at the device before one, and what its answer has to say. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ..protocols.exercise import READING, Asked
from ..protocols.point import Point, restoring
from ..protocols.proof import Call, Proof, Way
from ..protocols.registry import protocols
from ..subject.command import Command

__all__ = ["Readings", "asked_of", "with_readings"]

Readings = Sequence[tuple[str, Command]]
"""Named readings, each with the operation that it performs."""


def asked_of(protocol: str, operation: str, inputs: Mapping[str, Any], value: object) -> Asked:
    """Return a call of a reading whose place holds this value.

    Args:
        inputs: of the operation, as the reading draws them.
    """
    return _place(protocol, operation, inputs).read(value)


def with_readings(proof: Proof, protocol: str, readings: Readings) -> Proof:
    """Return the proof with the readings of a subject as further ways and calls, before those that show no value of the device."""
    if not readings:
        return proof
    known = protocols()[protocol].operations
    ways = [_way(protocol, operation, reading) for operation, reading in readings]
    calls = [Call(operation, reading.examples()[0]) for operation, reading in readings]
    places = [_place(protocol, operation, inputs) for operation, reading in readings for inputs in reading.examples()]
    restore, further = proof.restore, restoring(*places)
    return replace(
        proof,
        ways=tuple(sorted((*proof.ways, *ways), key=lambda way: way.weak)),
        unreachable=tuple(sorted((*proof.unreachable, *calls), key=lambda call: known[call.operation].status)),
        restore=lambda image: (*further(image), *restore(image)),
    )


def _way(protocol: str, operation: str, reading: Command) -> Way:
    assert reading.holds is not None
    # The place is that of the first example: one is enough.
    place = _place(protocol, operation, reading.examples()[0])
    return place.way(reading.held, bits=max(1, math.floor(math.log2(reading.holds.count))))


def _place(protocol: str, operation: str, inputs: Mapping[str, Any]) -> Point:
    of_operation = {name: value for name, value in inputs.items() if name != READING}
    place = protocols()[protocol].places[operation](of_operation)
    if place is None:
        raise ValueError(f"the mock device has no place for {operation} with {of_operation}")
    return replace(place, reading=Call(operation, inputs))
