"""Named readings as calls: what is set at the device before one, and what its answer has to say. Pure."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ..protocols.exercise import READING, Asked
from ..protocols.point import Point, restoring
from ..protocols.proof import Call, Proof, Way
from ..protocols.registry import protocols
from ..subject.command import Command, Draw

__all__ = ["Readings", "apart", "asked_of", "place_of", "with_readings"]

Readings = Sequence[tuple[str, Command]]
"""Named readings, each with the operation that it performs."""


def asked_of(protocol: str, operation: str, inputs: Mapping[str, Any], value: object) -> Asked:
    """Return a call of a reading whose place holds this value.

    Args:
        inputs: of the operation, as the reading draws them.
    """
    return place_of(protocol, operation, inputs).read(value)


def apart(every: Iterable[Asked]) -> list[Asked]:
    """Return the calls whose places share no cell of the device with that of one before them: what is set for one stays for all."""
    found: list[Asked] = []
    for asked in every:
        if all(asked.points.keys().isdisjoint(other.points) for other in found):
            found.append(asked)
    return found


def with_readings(proof: Proof, protocol: str, readings: Readings) -> Proof:
    """Return the proof with the readings of a subject as further ways and calls, before those that show no value of the device."""
    if not readings:
        return proof
    known = protocols()[protocol].operations
    ways = [_way(protocol, operation, reading) for operation, reading in readings]
    of_operation: dict[str, list[Mapping[str, Any]]] = {}
    for operation, reading in readings:
        of_operation.setdefault(operation, []).extend(reading.examples())
    calls = [_AnyOf(operation, examples[0], examples=tuple(examples)) for operation, examples in of_operation.items()]
    places = [place_of(protocol, operation, inputs) for operation, reading in readings for inputs in reading.examples()]
    restore, further = proof.restore, restoring(*places)
    return replace(
        proof,
        ways=tuple(sorted((*proof.ways, *ways), key=lambda way: way.weak)),
        unreachable=tuple(sorted((*proof.unreachable, *calls), key=lambda call: known[call.operation].status)),
        restore=lambda image: (*further(image), *restore(image)),
    )


@dataclass(frozen=True, slots=True)
class _AnyOf(Call):
    """A call by any of several readings, another one each time."""

    examples: tuple[Mapping[str, Any], ...] = ()

    def made(self, rng: random.Random) -> Mapping[str, Any]:
        return rng.choice(self.examples)


def _way(protocol: str, operation: str, reading: Command) -> Way:
    holds = reading.holds
    assert holds is not None
    # The place is that of the first example: one is enough.
    place = place_of(protocol, operation, reading.examples()[0])
    return place.way(partial(_any, holds), bits=max(1, math.floor(math.log2(holds.count))))


def _any(holds: Draw, rng: random.Random) -> Any:
    return holds.value(rng.randrange(holds.count))


def place_of(protocol: str, operation: str, inputs: Mapping[str, Any]) -> Point:
    """Return the place at the mock that a reading with these inputs of the operation tells.

    Raises:
        ValueError: there is no such place.
    """
    of_operation = {name: value for name, value in inputs.items() if name != READING}
    place = protocols()[protocol].places[operation](of_operation)
    if place is None:
        raise ValueError(f"the mock device has no place for {operation} with {of_operation}")
    return replace(place, reading=Call(operation, inputs))
