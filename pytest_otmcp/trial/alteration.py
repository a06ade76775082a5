"""Changes to the tool call that performs an operation: arguments that no assistant should send. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..record.schema import Altered

__all__ = ["Alteration", "expanded", "filler"]

_FILLER = "otmcp/filler"


def filler(characters: int) -> dict[str, int]:
    """Return a value that stands for a text of so many characters, so that no record holds megabytes."""
    return {_FILLER: characters}


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
    """Return arguments as they are sent: with the texts that fillers stand for."""
    return {
        name: "x" * value[_FILLER] if isinstance(value, dict) and _FILLER in value else value
        for name, value in arguments.items()
    }
