"""What was found out about a guess: what one call showed, and the proposal that came of it. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..protocols.journal import JournalEntry
from .evidence import Sample
from .guess import Guess

__all__ = ["Proposal", "Shown", "by_name"]


@dataclass(slots=True, kw_only=True)
class Proposal:
    """A proposed binding and the evidence for it.

    Attributes:
        proven: True when the device has seen the expected request.
        evidence: sentences for the file's comments.
        offset: input to the number that has to be added to it.
        form: where the answer's document is: ``structured``, ``json``, ``text`` or ``texts``.
        outputs: output to its rule.
        good: the answer to a call that succeeded.
        told: the inputs of that call, as the tool was told them.
        samples: output to the answers in which its value is known, that one first.
        placed: the sentences of the evidence that say where the values are.
        caveats: sentences on further calls that proved nothing, because they failed or had another result.
        provocations: calls that have to fail, each with the error code of the failure, and its inputs.
        failures: answers to calls that had to fail, each with the error code that it should have.
        blocking: the call waits for what it answers.
        by_input: arguments that the file is to give by an input, where the trials gave a constant or nothing.
        returned: a random value came from the mock device through the tool, or to it.
        whole: False when it is only right as long as there is no tool that does more.
        tried: False when no call was made, because its name and its arguments are all there is to go by.
        likelier: sentences on tools that are likelier by their names, and have proven less.
    """

    guess: Guess
    proven: bool
    evidence: list[str]
    offset: dict[str, int] = field(default_factory=dict)
    form: str | None = None
    outputs: dict[str, Mapping[str, object]] = field(default_factory=dict)
    good: Mapping[str, object] | None = None
    told: Mapping[str, object] = field(default_factory=dict)
    samples: dict[str, list[Sample]] = field(default_factory=dict)
    placed: list[str] = field(default_factory=list)
    caveats: list[str] = field(default_factory=list)
    provocations: list[tuple[str, Mapping[str, object]]] = field(default_factory=list)
    failures: list[tuple[str, Mapping[str, object]]] = field(default_factory=list)
    by_input: dict[str, str] = field(default_factory=dict)
    blocking: bool = False
    returned: bool = False
    whole: bool = True
    tried: bool = True
    likelier: list[str] = field(default_factory=list)


def by_name(guesses: Sequence[Guess]) -> Proposal | None:
    """Return the proposal for the likeliest guess without calling anything; None where there is no guess."""
    if not guesses:
        return None
    by_input = {argument: f"${name}" for argument, name in guesses[0].stand_ins.items()}
    evidence = ["by its name and its arguments; not called"]
    return Proposal(guess=guesses[0], proven=False, tried=False, evidence=evidence, by_input=by_input)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """The observations of one call.

    Attributes:
        message: the answer; None when there is none.
        entries: journal entries that the device wrote during the call.
        words: the answer, or why there is none, in a few words.
        told: the inputs as the tool was told them.
    """

    message: Mapping[str, object] | None
    entries: Sequence[JournalEntry]
    words: str
    told: Mapping[str, object] = field(default_factory=dict)
