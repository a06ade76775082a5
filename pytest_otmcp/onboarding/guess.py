"""A guess: a tool that may perform an operation, and how it would be called. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice, product

__all__ = ["Guess"]

_MOST_TRIALS = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """A tool that may perform an operation.

    Attributes:
        score: higher is likelier.
        arguments: template as a subject file has it.
        convert: input to the type that the tool seems to expect.
        missing: required arguments for which no value is known.
        trials: further arguments, each with values to try.
    """

    operation: str
    tool: str
    score: float
    arguments: Mapping[str, object]
    convert: Mapping[str, str]
    missing: tuple[str, ...]
    trials: Mapping[str, tuple[str, ...]]

    def variations(self) -> list[Guess]:
        """Return one guess for each combination of the values to try; only this guess when there are none to try."""
        names = list(self.trials)
        combinations = islice(product(*self.trials.values()), _MOST_TRIALS)
        return [
            replace(self, arguments={**self.arguments, **dict(zip(names, values, strict=True))}, trials={})
            for values in combinations
        ]
