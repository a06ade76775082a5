"""What a fault rule is made of: the fields that a protocol's rules have, and how a rule of the control channel is read by them.

A rule arrives as ``{condition: value, …, "skip": k, "times": n, "action": {action: value, …}}``. A protocol describes its
conditions and actions as tables of fields; reading is the same for all.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["FLAG", "SKIP", "TEXT", "Field", "Table", "hexadecimal", "integer", "number", "one_of"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """A value that a rule may have.

    Attributes:
        accepts: tells whether the field can have a value.
        expected: description of the values that it can have, for the sentence that refuses another value.
        convert: makes of an accepted value, which is one of JSON's, that of the rule.
    """

    accepts: Callable[[Any], bool]
    expected: str
    convert: Callable[[Any], Any] = lambda value: value


def integer(lowest: int, highest: int = sys.maxsize) -> Field:
    """Return a field for whole numbers; true and false are not accepted."""
    expected = f"an integer from {lowest}" + (f" to {highest}" if highest < sys.maxsize else "")
    return Field(accepts=lambda value: type(value) is int and lowest <= value <= highest, expected=expected)


def number(lowest: float = -math.inf, highest: float = math.inf) -> Field:
    """Return a field for numbers; true and false are not accepted."""
    bounds = f" from {lowest:g} to {highest:g}" if math.isfinite(highest) else ""
    return Field(
        accepts=lambda value: type(value) in (int, float) and lowest <= value <= highest, expected=f"a number{bounds}"
    )


def one_of(*names: str) -> Field:
    """Return a field for one of these names."""
    return Field(accepts=lambda value: isinstance(value, str) and value in names, expected=f"one of {', '.join(names)}")


def hexadecimal(most: int) -> Field:
    """Return a field for so many bytes at most, as pairs of hexadecimal digits in lower case."""
    pattern = re.compile(f"(?:[0-9a-f]{{2}}){{0,{most}}}")
    return Field(
        accepts=lambda value: isinstance(value, str) and bool(pattern.fullmatch(value)),
        expected=f"at most {most} bytes as hexadecimal digits",
        convert=bytes.fromhex,
    )


FLAG = Field(accepts=lambda value: isinstance(value, bool), expected="true or false")
TEXT = Field(accepts=lambda value: isinstance(value, str), expected="a string")

SKIP = integer(0)
"""The condition ``skip``: how many requests that fit pass before the rule applies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """The rules of one protocol.

    Attributes:
        conditions: fields that say which requests a rule is about; ``times``, how often it applies, is always one.
        actions: fields that say what is done to these requests.
        example: an action, for the sentence that refuses a rule without one.
        required: conditions that every rule has to have.
        one_action: a rule has exactly one action.
        qualifiers: members of an action that say how another one is done.
    """

    conditions: Mapping[str, Field]
    actions: Mapping[str, Field]
    example: str
    required: Sequence[str] = ()
    one_action: bool = False
    qualifiers: Collection[str] = ()

    def read(self, source: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of a rule, conditions and actions together. A null is left out, as if it were missing.

        Raises:
            ValueError: there is no action, an unknown name, or a value that the name cannot have.
        """
        action = source.get("action")
        names = action.keys() - {*self.qualifiers} if isinstance(action, Mapping) else ()
        if not isinstance(action, Mapping) or not names or (self.one_action and len(names) != 1):
            count = "one action" if self.one_action else "an action"
            raise ValueError(f"a fault rule needs {count}, for instance {{'action': {self.example}}}")
        conditions = {name: value for name, value in source.items() if name != "action"}
        values: dict[str, Any] = {}
        for known, given in (({**self.conditions, "times": integer(0)}, conditions), (self.actions, action)):
            for name, value in given.items():
                if name not in known:
                    raise ValueError(f"unknown member {name!r} of a fault rule; known are {', '.join(known)}")
                if value is None:
                    continue
                if not known[name].accepts(value):
                    raise ValueError(f"a fault rule cannot have {value!r} as {name!r}: expected {known[name].expected}")
                values[name] = known[name].convert(value)
        for name in self.required:
            if name not in values:
                raise ValueError(f"a fault rule needs {name!r}, {self.conditions[name].expected}")
        return values
