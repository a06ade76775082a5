"""How a check that holds for every protocol reads and writes on one of them, and makes its device fall silent. Pure.

A check of the requirement suite that is about any adapter, whatever it talks to, asks the protocol's description what to do:
see :class:`Exercise`. A protocol without one has no such checks.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .journal import Entries, JournalEntry

__all__ = ["Asked", "Exercise", "every_change"]

Poke = Mapping[str, object]
"""What a mock device is told to set out of band."""

Rule = Mapping[str, object]
"""A rule of the mock's fault plan."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """One call whose good answer is known.

    Attributes:
        operation: its name.
        inputs: of the operation; values are random, so that no other call has the same answer.
        outputs: what a successful answer has to say.
        pokes: what is set at the mock before the call.
        points: what the device's image holds after a write, by point; empty where the device has no such image.
    """

    operation: str
    inputs: Mapping[str, Any]
    outputs: Mapping[str, Any] = field(default_factory=dict)
    pokes: tuple[Poke, ...] = ()
    points: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Exercise:
    """What checks for every protocol do on this one.

    Attributes:
        reading: name of the operation that reads.
        read: makes a call that changes nothing, and that the device has to answer during the call.
        writing: name of the operation that writes.
        write: makes a call that changes one thing at the device, by one request.
        number: the input of the write that is a number of limited range; None where there is none.
        bounded: inputs of the read and the write whose range the protocol itself limits.
        done: returns the requests among entries that ask the device for what a write asks for.
        reads, writes: the conditions of a fault plan that the requests of the read, or of the write, meet, in whichever way an
            adapter makes them.
        silent: rules with which the device takes every request and never answers.
        reset: rules with which the device resets the connection instead of answering.
        refused: rules with which the device refuses what is read, by an answer of the protocol.
    """

    reading: str
    read: Callable[[random.Random], Asked]
    writing: str
    write: Callable[[random.Random], Asked]
    number: str | None
    bounded: tuple[str, ...]
    done: Callable[[Entries, Asked], list[JournalEntry]]
    reads: tuple[Rule, ...]
    writes: tuple[Rule, ...]
    silent: tuple[Rule, ...]
    reset: tuple[Rule, ...]
    refused: tuple[Rule, ...]


def every_change(entries: Entries, asked: Asked) -> list[JournalEntry]:
    """Return every request that may change the plant: what a write asks for, where an adapter sends nothing of its own."""
    return [entry for entry in entries if entry["state_changing"]]
