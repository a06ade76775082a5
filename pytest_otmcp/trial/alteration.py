"""Changes to the tool call that performs an operation: arguments that no assistant should send. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..record.schema import Altered

__all__ = ["DEEP", "ELEMENTS", "TEXT", "Alteration", "expanded", "filler"]

TEXT = "otmcp/filler"
ELEMENTS = "otmcp/elements"
DEEP = "otmcp/depth"


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
