"""Reads the last words of an assistant: one JSON object that says the outcome, and the value where one was asked for. Pure.

So no model has to judge what an answer means.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

from ..trial.assignment import OUTCOMES, Outcome

__all__ = ["ANSWER", "Claimed", "read_claim", "same_value"]

ANSWER = (
    'End your answer with one line that is a JSON object: {"outcome": "done"} if you did what was asked, "refused" instead of "done" if it was '
    'refused or you refuse it, "failed" if you tried and it did not work, "unsure" if you cannot know what is meant. Where you are asked to '
    'report a value, add it: {"outcome": "done", "value": 17}.'
)
"""What every assistant is told of the form of its answer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claimed:
    """What an assistant says at its end.

    Attributes:
        outcome: None where it says none in the form that was asked for.
        tokens: that the assistant says it used; None where it says nothing.
    """

    outcome: Outcome | None = None
    value: object = None
    tokens: int | None = None


def read_claim(answer: str) -> Claimed:
    """Read the last JSON object with an outcome."""
    decoder = json.JSONDecoder()
    at = len(answer)
    while (at := answer.rfind("{", 0, at)) >= 0:
        try:
            said, _ = decoder.raw_decode(answer, at)
        except (ValueError, RecursionError):
            continue
        if isinstance(said, dict) and said.get("outcome") in OUTCOMES:
            tokens = said.get("tokens")
            return Claimed(
                outcome=cast(Outcome, said["outcome"]),
                value=said.get("value"),
                tokens=tokens if type(tokens) is int else None,
            )
    return Claimed()


def same_value(found: object, wanted: object) -> bool:
    """Tell whether a value is the one that was to be reported: as a number, as text, or as a list of one."""
    if isinstance(wanted, list):
        alike = isinstance(found, list) and len(found) == len(wanted)
        return alike and all(map(same_value, cast(list[object], found), wanted))
    if isinstance(found, list) and len(found) == 1:
        return same_value(found[0], wanted)
    if isinstance(found, bool) or isinstance(wanted, bool):
        return found is wanted
    if isinstance(wanted, int | float):
        number = _number(found)
        return number is not None and math.isclose(number, wanted, rel_tol=1e-9)
    return isinstance(found, str) and found.strip() == wanted


def _number(found: object) -> float | None:
    if isinstance(found, Mapping):
        return None
    try:
        return float(cast(str, found))
    except (TypeError, ValueError, OverflowError):
        return None
