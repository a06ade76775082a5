"""The proof that a session talks to the mock device and to no other: what a protocol asks before anything may be written. Pure.

A random value is set at the mock past the protocol, and has to come back through the adapter; or a random name is asked for
through the adapter, and has to be seen by the mock. No other device can answer like that, and no adapter can guess it. How a
proof is carried out stands in the room ``trial``.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .journal import Entries, Image, JournalEntry

__all__ = ["ENOUGH_BITS", "REACHED", "Call", "Proof", "Question", "Way", "exchanged"]

ENOUGH_BITS = 32
"""Random bits after which nobody is taken for the mock by chance."""

Poke = Mapping[str, object]
"""What a mock device is told to set out of band."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """One call that may show where its answer comes from.

    Attributes:
        inputs: of the operation.
        pokes: what is set at the mock before the call.
        bits: number of random bits that the answer's outputs and the mock's journal since the call show to have come through.
    """

    inputs: Mapping[str, object]
    bits: Callable[[Mapping[str, object], Entries], int]
    pokes: tuple[Poke, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """An operation that writes nothing and may be the proof.

    Attributes:
        operation: its name.
        ask: makes a question with random numbers of its own.
        weak: the answer shows only that the session reaches the mock, not where its answers come from. Such a way counts
            where the adapter has no other one.
        waiting: the way is for an adapter that performs the operation by a call that waits (or that does not); None for both.
    """

    operation: str
    ask: Callable[[random.Random], Question]
    weak: bool = False
    waiting: bool | None = None


@dataclass(frozen=True, slots=True)
class Call:
    """An operation that writes nothing and cannot succeed while the device is away.

    Attributes:
        operation: its name.
        inputs: of the operation.
        new: names an input, and makes its value from a random number: it is another one in every call, so that an answer from memory is
            none to it. None where every call has the same inputs.
        brings: what is set at the device before the call, from its inputs, so that a call which waits has something to bring: where nothing
            comes its answer may be a failure.
    """

    operation: str
    inputs: Mapping[str, Any] = field(default_factory=dict)
    new: tuple[str, Callable[[random.Random], object]] | None = None
    brings: Callable[[Mapping[str, Any]], tuple[Poke, ...]] = lambda inputs: ()

    def made(self, rng: random.Random) -> Mapping[str, Any]:
        """Return the inputs of the next call."""
        return self.inputs if self.new is None else {**self.inputs, self.new[0]: self.new[1](rng)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """How a protocol proves where an adapter's session leads. Without any way nothing is ever written.

    Attributes:
        ways: in the order in which they are tried.
        arrival: a journal entry with which a client arrives at the mock; what counts for an adapter without any of the ways.
            None where nothing does.
        restore: what has to be poked so that the mock holds again what it held when the image was taken.
        unreachable: every operation that cannot succeed while the device is away, the best first: those that give values, and last the
            status. An adapter is taken through an outage with the first that it has, and nothing is written during the outage unless
            that one has just failed twice: an adapter that still gets answers gets them from elsewhere.
    """

    ways: tuple[Way, ...] = ()
    arrival: Callable[[JournalEntry], bool] | None = None
    restore: Callable[[Image], tuple[Poke, ...]] = lambda image: ()
    unreachable: tuple[Call, ...] = ()


def exchanged(outputs: Mapping[str, object], entries: Entries) -> int:
    """Count a request of a client that reached the mock as enough, for a way that is weak."""
    return ENOUGH_BITS if any(entry["request"] and entry["origin"] == "client" for entry in entries) else 0


REACHED = Way(operation="ping", ask=lambda rng: Question(inputs={}, bits=exchanged), weak=True)
"""The way for an adapter without a read: its ping reaches the mock."""
