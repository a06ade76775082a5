"""Changes to the tool call that performs an operation: arguments that no assistant should send. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..record.schema import Altered

__all__ = ["DEEP", "ELEMENTS", "TEXT", "Alteration", "expanded", "filler", "in_words", "label"]

TEXT = "otmcp/filler"
ELEMENTS = "otmcp/elements"
DEEP = "otmcp/depth"

_LABEL = 160
"""Letters of a call's name in findings."""


def filler(size: int, kind: str = TEXT) -> dict[str, int]:
    """Return a value that stands for a large one, so that no record holds megabytes.

    Args:
        kind: a text of so many characters, without one; ``ELEMENTS`` for a list of so many numbers, ``DEEP`` for so many lists, each in
            the one before.
    """
    return {kind: size}


@dataclass(frozen=True, slots=True, kw_only=True)
class Alteration:
    """A change to the arguments that a binding makes of an operation's inputs.

    Attributes:
        given: arguments that get another value, or that the tool does not have.
        left_out: arguments that are not given.
        tool: another tool's name; None for the tool of the binding.
    """

    given: Mapping[str, Any] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    tool: str | None = None

    def applied(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments of the call as a record has them."""
        return {name: value for name, value in {**arguments, **self.given}.items() if name not in self.left_out}

    def as_record(self) -> Altered:
        """Return the change as a call of ``run.json`` has it."""
        return {"given": dict(self.given), "left_out": list(self.left_out), "tool": self.tool}


def expanded(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments as they are sent: with the values that fillers stand for."""
    return {name: _expanded(value) for name, value in arguments.items()}


class _Words(str):
    """Words in the place of a value; they are no text of a call."""

    def __repr__(self) -> str:
        return str(self)


_LARGE = {TEXT: "a text of {} characters", ELEMENTS: "a list of {} elements", DEEP: "a list that is nested {} deep"}


def in_words(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments with words in the place of what fillers stand for."""
    return {
        name: _Words(_LARGE[next(iter(value))].format(next(iter(value.values()))))
        if isinstance(value, Mapping) and len(value) == 1 and next(iter(value)) in _LARGE
        else value
        for name, value in arguments.items()
    }


def label(tool: object, arguments: Mapping[str, Any]) -> str:
    """Return the name that a call has in findings."""
    told = ", ".join(f"{name}={value!r}" for name, value in in_words(arguments).items())
    whole = f"{tool}({told})"
    return whole if len(whole) <= _LABEL else f"{whole[: _LABEL - 2]}…)"


def _expanded(value: Any) -> Any:
    if not isinstance(value, dict) or len(value) != 1:
        return value
    if TEXT in value:
        return "x" * value[TEXT]
    if ELEMENTS in value:
        return [0] * value[ELEMENTS]
    nested: list[Any] = []
    for _ in range(value.get(DEEP, 0)):
        nested = [nested]
    return nested if DEEP in value else value
