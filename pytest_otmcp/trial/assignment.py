"""A task in words for an assistant, with what must have happened at the device and what must not. Pure.

Assignments measure an assistant with an adapter, not an adapter: nothing of them is part of a conformance run or of a certificate.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from ..subject.model import READ_WRITE

__all__ = ["FAMILIES", "OUTCOMES", "Act", "Assignment", "Assignments", "Case", "Family", "Outcome"]

Family = Literal[
    "control",
    "read",
    "write",
    "steps",
    "range",
    "guard",
    "premise",
    "look",
    "ambiguous",
    "down",
    "injection",
    "approval",
    "declined",
    "cross",
]
FAMILIES: tuple[Family, ...] = get_args(Family)

Outcome = Literal["done", "refused", "failed", "unsure"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
"""What an assistant may say at its end: it did what was asked; it was refused, or it refused; it tried and cannot say that it worked; it
does not know enough to act."""

Person = Literal["accept", "decline"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Act:
    """One operation of an adapter.

    Attributes:
        operation: of the protocol.
        inputs: of the operation.
        holds: points of the device's image and their values after it.
        arrives: members of the journal's entry of its request; for writes that no image shows.
        beside: inputs by which it would be about the neighbour instead.
        clamped: inputs by which a value that does not fit would be made to fit.
    """

    protocol: str
    operation: str
    inputs: Mapping[str, object] = field(default_factory=dict)
    holds: Mapping[str, object] = field(default_factory=dict)
    arrives: Mapping[str, object] = field(default_factory=dict)
    beside: Mapping[str, object] = field(default_factory=dict)
    clamped: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One try of an assignment, with the values of this try.

    Attributes:
        prompt: what the assistant is asked, in words.
        acts: what a good assistant does. Those that write must have happened at the device, each once, and nothing else that changes
            the plant.
        value: the value that the answer must have; None where none is asked for.
        outcomes: what a true answer may say.
        pokes: protocol and poke, each past the protocol, before the assistant comes.
        nothing_happens: the writes among the acts are refused, or do not reach the device: each must have been tried, with its
            arguments, and nothing may have changed.
        temptation: what must not be done, and what an assistant might do that goes beyond the words, or obeys a text of the device.
    """

    prompt: str
    acts: tuple[Act, ...] = ()
    value: object = None
    outcomes: tuple[Outcome, ...] = ("done",)
    pokes: tuple[tuple[str, Mapping[str, object]], ...] = ()
    nothing_happens: bool = False
    temptation: Act | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Assignment:
    """A task in words.

    Attributes:
        id: such as ``modbus.write``.
        needs: operations, each with its protocol.
        make: makes a try from random numbers.
        launch: launch of the adapters.
        down: protocol whose device is stopped before the assistant comes.
        target: the target of writes that a person has to approve, as the subject file must name it; empty for none.
        person: what the person answers who is asked for an approval.
    """

    id: str
    family: Family
    needs: tuple[str, ...]
    make: Callable[[random.Random], Case]
    launch: str = READ_WRITE
    down: str = ""
    target: str = ""
    person: Person = "accept"

    @property
    def protocols(self) -> tuple[str, ...]:
        """The protocols whose adapters the assistant is given."""
        return tuple(dict.fromkeys(need.partition(".")[0] for need in self.needs))


class Assignments:
    """The assignments that a module declares, in order."""

    def __init__(self) -> None:
        self._declared: list[Assignment] = []

    def __iter__(self) -> Iterator[Assignment]:
        return iter(self._declared)

    def assignment(
        self,
        id: str,
        family: Family,
        needs: str,
        *,
        launch: str = READ_WRITE,
        down: str = "",
        target: str = "",
        person: Person = "accept",
    ) -> Callable[[Callable[[random.Random], Case]], Callable[[random.Random], Case]]:
        """Declare what the decorated function makes the tries of.

        Args:
            needs: operations, with their protocols, separated by spaces.
        """

        def declare(make: Callable[[random.Random], Case]) -> Callable[[random.Random], Case]:
            self._declared.append(
                Assignment(
                    id=id,
                    family=family,
                    needs=tuple(needs.split()),
                    make=make,
                    launch=launch,
                    down=down,
                    target=target,
                    person=person,
                )
            )
            return make

        return declare
