"""The pack of one protocol, which ``otmcp init`` needs: words of its tools, experiments, failures of its libraries."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from ..core.errors import UsageError
from ..protocols.exercise import Asked
from ..protocols.journal import JournalEntry
from ..protocols.registry import protocols
from .experimenter import Experiment
from .known_causes import KnownCause
from .proposal import Proposal

__all__ = ["Hints", "Pack", "Told", "load_pack", "plain"]

Told = Callable[[JournalEntry], tuple[str, Mapping[str, object]] | None]
"""A function that returns what a request that changes the plant asks for, as an operation with its inputs."""


Sources = Callable[[JournalEntry], Sequence[tuple[str, Mapping[str, Any]]]]
"""A function that returns what a request may have read: operations that read one value each, with their inputs, the plainest first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hints:
    """Hints that tell the tool for an operation from others, and its experiment. Words are separated by blanks.

    Attributes:
        likely: words of a tool's name or description that speak for the operation.
        unlikely: words of a tool's name that speak against it.
        needed: words of which a tool's name must have one; empty when it may have any.
        experiment: tries a guess at the mock device; None for a voluntary operation that is proposed by name and arguments alone.
        named: matches the whole names of the tools that are considered; None for any.
        choice: matches the value of an enumerated argument that names what the operation is about, such as a table.
        trials: pattern of a required argument's name, to the values that are tried when its schema does not say any.
    """

    likely: str
    unlikely: str
    experiment: Experiment | None
    needed: str = ""
    named: re.Pattern[str] | None = None
    choice: re.Pattern[str] | None = None
    trials: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def _none(proposals: Mapping[str, Proposal]) -> Mapping[str, tuple[str, str]]:
    return {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Pack:
    """The knowledge about one protocol for the proposal of bindings.

    Attributes:
        protocol: its key.
        operations: every abstract operation of the protocol, by name.
        arguments: input of operations to the names that tools have for it, separated by blanks.
        lists: inputs that are lists by themselves.
        constants: pattern of an argument's name, to the value that the mock device wants there.
        stand_ins: voluntary input to the pattern of the arguments for which there is a constant, and which stand for that input.
        names: names of the protocol that an argument may expect.
        late: a journal entry that may follow the answer to a call, as members and values; None when none does.
        told: None for a request that no named command can have; without it `otmcp init` looks for no named commands.
        sources: without it `otmcp init` looks for no named readings.
        samples: makes reads that prove a binding, beside those of the protocol's exercise; None where these are all.
        errors: error code to patterns of the texts in which libraries report it.
        causes: known causes in this protocol's libraries why an adapter does not start.
        choices: returns the keys of the protocol's own that the proposals show to have another value than their default, each with that
            value, and why.
    """

    protocol: str
    operations: Mapping[str, Hints]
    arguments: Mapping[str, str]
    lists: frozenset[str] = frozenset()
    constants: Mapping[str, object] = field(default_factory=dict)
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    late: Mapping[str, object] | None = None
    told: Told | None = None
    sources: Sources | None = None
    samples: Callable[[random.Random], Sequence[Asked]] | None = None
    errors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    causes: tuple[KnownCause, ...] = ()
    choices: Callable[[Mapping[str, Proposal]], Mapping[str, tuple[str, str]]] = _none


def plain(words: str, names: str, experiment: Experiment | None = None) -> Hints:
    """Return the hints for a voluntary operation, which is proposed for tools with such a name alone.

    Args:
        words: words of a tool's name or description that speak for it.
        names: pattern of the whole names of such tools, in any case.
    """
    return Hints(likely=words, unlikely="", experiment=experiment, named=re.compile(names, re.IGNORECASE))


def load_pack(protocol: str) -> Pack:
    """Load the pack of a protocol.

    Raises:
        UsageError: the protocol has none.
    """
    described = protocols()[protocol]
    if described.onboarding is None:
        raise UsageError(
            f"otmcp init cannot propose bindings for {described.name} yet; 'otmcp docs subject-file' says how to write them"
        )
    pack: Pack = import_module(described.onboarding).PACK
    return pack
