"""Points of a mock device, and the types of their values: what checks, proof and tasks of a protocol follow from. Pure.

A protocol makes its points once: how each is set at the mock past the protocol, what the image holds then, and by which operations
an adapter reads and writes it. The calls of its :class:`~.exercise.Exercise`, the questions of its :class:`~.proof.Proof` and the
calls of its tasks are made from them.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ..core.strict_json import Wide
from .exercise import LARGEST_FLOAT32, NO_INTEGERS, NO_REALS, Asked, Contended
from .journal import Entries, Image
from .proof import Call, Question, Way

__all__ = [
    "BOOL",
    "FLOAT32",
    "FLOAT64",
    "INT8",
    "INT16",
    "INT32",
    "INT64",
    "TEXT",
    "UINT8",
    "UINT16",
    "UINT32",
    "UINT64",
    "Kind",
    "Point",
    "different_bytes",
    "half",
    "large",
    "restoring",
]

Poke = Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Kind:
    """A type of values.

    Attributes:
        form: its character in :mod:`struct`; empty for texts.
    """

    form: str

    @property
    def size(self) -> int:
        """Bytes of a value."""
        return int(struct.calcsize(f">{self.form}"))

    @property
    def is_whole(self) -> bool:
        """Its values are whole numbers."""
        return self.form in "bBhHiIqQ" and bool(self.form)

    @property
    def is_signed(self) -> bool:
        """Its values may be negative."""
        return self.form in "bhiqfd"

    @property
    def lowest(self) -> int:
        """The lowest whole number."""
        return -(1 << 8 * self.size - 1) if self.is_signed else 0

    @property
    def highest(self) -> int:
        """The highest whole number."""
        return self.lowest + (1 << 8 * self.size) - 1

    def due(self, value: Any) -> Any:
        """Return what an answer that says a value of this type has to say."""
        return Wide(value) if self.form in ("q", "Q") else value

    def any(self, rng: random.Random) -> Any:
        """Return any whole number."""
        return rng.randrange(self.lowest, self.highest + 1)

    def telling(self, rng: random.Random) -> Any:
        """Return a value that would be another one with another sign, or as another type."""
        if not self.is_whole:
            return half(rng)
        bits = 8 * self.size
        return -rng.randrange(1, 2 ** (bits - 1)) if self.is_signed else rng.randrange(2 ** (bits - 1), 2**bits)


BOOL, TEXT = Kind("?"), Kind("")
INT8, INT16, INT32, INT64 = map(Kind, "bhiq")
UINT8, UINT16, UINT32, UINT64 = map(Kind, "BHIQ")
FLOAT32, FLOAT64 = map(Kind, "fd")


def half(rng: random.Random) -> float:
    """Return a half below 2 to the 20, which is exact as a floating-point number of 32 bits as well; it may be negative."""
    return rng.randrange(-(2**20), 2**20) + 0.5


def different_bytes(rng: random.Random, form: str) -> list[int]:
    """Return three whole numbers of 32 bits of which each byte differs, so that a value of parts of two is none of them.

    Args:
        form: of :mod:`struct`, such as ``>i``.
    """
    return [struct.unpack(form, bytes(rng.randrange(low, low + 80) for _ in range(4)))[0] for low in (1, 81, 161)]


def _no_pokes(value: Any) -> tuple[Poke, ...]:
    return ()


def _no_points(value: Any) -> Mapping[str, object]:
    return {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A place at the mock that holds a value.

    Attributes:
        kind: type of the value.
        pokes: returns what sets a value at the mock, past the protocol; nothing where it would not stay.
        unsound: returns what sets a value of which the device says that it is not good; nothing where the protocol has no such thing.
        held: returns what the image holds then, by point.
        found: returns the value that an image holds.
        reading, writing: operation and inputs of a read and of a write; None where there is none.
        output: of the read that is the value, and of the write that says what was written.
        given_as: the input of the write that is the value.
        listed: the output of a read is a list of this one value.
        condition: of a fault plan, which the requests of the read meet.
    """

    kind: Kind
    pokes: Callable[[Any], tuple[Poke, ...]] = _no_pokes
    unsound: Callable[[Any], tuple[Poke, ...]] = _no_pokes
    held: Callable[[Any], Mapping[str, object]] = _no_points
    found: Callable[[Image], Any] | None = None
    reading: Call | None = None
    writing: Call | None = None
    output: str = "value"
    given_as: str = "value"
    listed: bool = False
    condition: Mapping[str, object] = field(default_factory=dict)

    def read(self, value: Any) -> Asked:
        """Return the read of a value that is set before."""
        return replace(
            self.reads(),
            outputs={self.output: [self.kind.due(value)] if self.listed else self.kind.due(value)},
            pokes=self.pokes(value),
            points=self.held(value),
            condition=self.condition,
        )

    def any(self, rng: random.Random) -> Asked:
        """Return the read of any whole number of the type."""
        return self.read(self.kind.any(rng))

    def reads(self) -> Asked:
        """Return a read of which nothing is known."""
        assert self.reading is not None, "the point cannot be read"
        return Asked(operation=self.reading.operation, inputs=self.reading.inputs)

    def write(self, value: Any, *, before: Any = None) -> Asked:
        """Return the write of a value.

        Args:
            before: the value that is set at the mock before; None where none is.
        """
        return replace(
            self.writes(value),
            outputs={self.output: self.kind.due(value)},
            pokes=() if before is None else self.pokes(before),
            points=self.held(value),
        )

    def writes(self, value: object) -> Asked:
        """Return a write that must not be carried out."""
        assert self.writing is not None, "the point cannot be written"
        return Asked(operation=self.writing.operation, inputs={**self.writing.inputs, self.given_as: value})

    def read_again(self, image: Image) -> Asked:
        """Return the read of what the device holds."""
        assert self.found is not None
        return self.read(self.found(image))

    def contended(self, old: Any, *new: Any) -> Contended:
        """Return a read and writes for calls at the same time, with the old value of the point."""
        return Contended(
            old=old,
            new=new,
            pokes=self.pokes(old),
            read=self.reads(),
            output=self.output,
            writes=tuple(map(self.write, new)),
        )

    def bounds(self, **before: Any) -> list[tuple[Asked, object]]:
        """Return the writes of the lowest and the highest value of the type, each with the value beyond; of a floating-point number of 32
        bits the highest is the first."""
        if self.kind.is_whole:
            lowest, highest = self.kind.lowest, self.kind.highest
            return [(self.write(lowest, **before), lowest - 1), (self.write(highest, **before), highest + 1)]
        return [(self.write(sign * LARGEST_FLOAT32, **before), sign * 1e39) for sign in (1, -1)]

    def misfits(self, **before: Any) -> tuple[Asked, tuple[object, ...]]:
        """Return the write of a number, with what is no such number."""
        if self.kind.is_whole:
            return self.write(7, **before), NO_INTEGERS
        return self.write(7.5, **before), NO_REALS

    def way(
        self, draw: Callable[[random.Random], Any], bits: int, *, same: Callable[[Any, Any], int] | None = None
    ) -> Way:
        """Return the read of a random value as a proof of where a session leads.

        Args:
            draw: makes the value.
            bits: so many of it are random.
            same: returns how many of them the output shows; None where it is the value, or shows none.
        """

        def ask(rng: random.Random) -> Question:
            value = draw(rng)
            asked = self.read(value)

            def shown(outputs: Mapping[str, object], entries: Entries) -> int:
                found = outputs.get(self.output)
                if isinstance(found, list) and len(found) == 1 and not isinstance(value, list):
                    (found,) = found
                if same is not None:
                    return same(found, value)
                return bits if found == value and not isinstance(found, bool) else 0

            return Question(inputs=asked.inputs, pokes=asked.pokes, bits=shown)

        assert self.reading is not None
        return Way(operation=self.reading.operation, ask=ask)


def large(signed: Point, unsigned: Point) -> Callable[[Sequence[int], bool], tuple[Asked, ...]]:
    """Return what makes reads of whole numbers of 64 bits, at a point with a sign and at one without."""
    return lambda values, has_sign: tuple(map((signed if has_sign else unsigned).read, values))


def restoring(*points: Point) -> Callable[[Image], tuple[Poke, ...]]:
    """Return what makes the pokes that give points the values which they had in an image."""

    def restore(image: Image) -> tuple[Poke, ...]:
        return tuple(poke for point in points if point.found for poke in point.pokes(point.found(image)))

    return restore
