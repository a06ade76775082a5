"""Kinds of single values in a subject file. Pure.

A kind states once which values are right. It reads a value and refuses a wrong one in one sentence, and it writes itself as
JSON Schema. ``tables`` has the kinds that consist of other kinds, ``grammar`` has the file.
"""

from __future__ import annotations

import datetime
import difflib
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jmespath

__all__ = [
    "ANYTHING",
    "DATE",
    "FLAG",
    "NUMBER",
    "PATH",
    "REASON",
    "REGEX",
    "SECONDS",
    "STRING",
    "TEXT",
    "Definitions",
    "Expression",
    "Kind",
    "OneOf",
    "Refusal",
    "Scalar",
    "at_most",
    "nearest",
    "strings",
    "toml_type",
]

Definitions = dict[str, Any]
"""The ``$defs`` of a schema, by name."""


class Refusal(Exception):
    """A value is not what the grammar expects.

    Args:
        key: dotted path of the value in the file; empty for the whole document.
        message: what was expected, and what was found instead.
    """

    def __init__(self, key: str, message: str) -> None:
        super().__init__(f"{key}: {message}" if key else message)


def toml_type(value: object) -> str:
    """Name the type of a value in TOML's words."""
    if value is None:
        return "nothing"
    if isinstance(value, datetime.date | datetime.time):
        return "a date"
    if value == "":
        return "an empty string"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return {dict: "a table", list: "a list", str: "a string", bool: "a boolean"}.get(type(value), "a number")


def nearest(name: object, known: Iterable[str]) -> str:
    """Say which of the known names is the nearest; name all of them where none is near."""
    names = list(known)
    near = difflib.get_close_matches(str(name), names, 1)
    return f"did you mean {near[0]!r}?" if near else f"known are {', '.join(sorted(names))}"


class Kind(ABC):
    """A kind of value: it knows which values are right."""

    @abstractmethod
    def read(self, value: object, key: str) -> Any:
        """Return the value, checked, with the defaults of its tables filled in.

        Args:
            value: None when the file lacks a required key.
            key: dotted path of the value.

        Raises:
            Refusal: the value is wrong.
        """

    @abstractmethod
    def schema(self, definitions: Definitions) -> dict[str, Any]:
        """Return the JSON Schema of right values, and add the definitions that it refers to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scalar(Kind):
    """A value with no structure that the kit has to know.

    Attributes:
        expected: a right value in words.
        accepts: tells whether the value is right.
        described: the same in JSON Schema, as far as JSON Schema can express it.
        shown: names a wrong value.
    """

    expected: str
    accepts: Callable[[Any], bool]
    described: Mapping[str, Any]
    shown: Callable[[Any], str] = toml_type

    def read(self, value: object, key: str) -> Any:
        if not self.accepts(value):
            raise Refusal(key, f"expected {self.expected}, found {self.shown(value)}")
        return value

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        return dict(self.described)


def _is_number(value: object) -> bool:
    # True is no number in JSON, but it is one in Python.
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_strings(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(part, str) for part in value)


def strings(meaning: str, *, filled: bool = False) -> Scalar:
    """Return the kind of a list of strings; with ``filled`` the list must not be empty."""
    return Scalar(
        expected=f"a {'non-empty ' if filled else ''}list of strings, {meaning}",
        accepts=lambda value: _is_strings(value) and (bool(value) or not filled),
        described={"type": "array", "items": {"type": "string"}} | ({"minItems": 1} if filled else {}),
        shown=_shown_list,
    )


def _shown_list(value: object) -> str:
    if not isinstance(value, list):
        return toml_type(value)
    wrong = [part for part in value if not isinstance(part, str)]
    return f"a list with {toml_type(wrong[0])}" if wrong else "an empty list"


STRING = Scalar(expected="a string", accepts=lambda value: isinstance(value, str), described={"type": "string"})
TEXT = Scalar(
    expected="a non-empty string",
    accepts=lambda value: isinstance(value, str) and value != "",
    described={"type": "string", "minLength": 1},
)
REASON = Scalar(
    expected="the reason in a string",
    accepts=lambda value: isinstance(value, str) and value.strip() != "",
    described={"type": "string", "pattern": r"\S"},
    shown=lambda value: "a blank string" if isinstance(value, str) else toml_type(value),
)
COUNT = Scalar(
    expected="a whole number above 0",
    accepts=lambda value: isinstance(value, int) and not isinstance(value, bool) and value > 0,
    described={"type": "integer", "minimum": 1},
    shown=repr,
)
NUMBER = Scalar(expected="a number", accepts=_is_number, described={"type": "number"})


def at_most(seconds: float) -> Scalar:
    """Return the kind of a time in seconds that must not be longer than this."""
    return Scalar(
        expected=f"seconds above 0 and up to {seconds:g}",
        accepts=lambda value: _is_number(value) and 0 < value <= seconds,
        described={"type": "number", "exclusiveMinimum": 0, "maximum": seconds},
        shown=repr,
    )


SECONDS = at_most(300)
FLAG = Scalar(expected="true or false", accepts=lambda value: isinstance(value, bool), described={"type": "boolean"})
# JSON has no dates: an editor gives a validator a string or a value of its own type.
DATE = Scalar(
    expected="a date such as 2027-03-31 without quotes",
    accepts=lambda value: isinstance(value, datetime.date) and not isinstance(value, datetime.datetime),
    described={},
)
ANYTHING = Scalar(expected="a value", accepts=lambda value: value is not None, described={})


@dataclass(frozen=True, slots=True, kw_only=True)
class Expression(Kind):
    """A string in a language of its own.

    Attributes:
        language: name of such a string, with its article.
        compile: raises when the string is not of that language.
    """

    language: str
    compile: Callable[[str], object]

    def read(self, value: object, key: str) -> Any:
        if not isinstance(value, str) or not value:
            raise Refusal(key, f"expected {self.language} in a string, found {toml_type(value)}")
        try:
            self.compile(value)
        except (re.error, jmespath.exceptions.JMESPathError, OverflowError, RecursionError) as error:
            raise Refusal(key, f"not {self.language}: {str(error).partition(chr(10))[0]}") from None
        return value

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        return {"type": "string", "minLength": 1}


PATH = Expression(language="a JMESPath expression", compile=jmespath.compile)
REGEX = Expression(language="a regular expression", compile=re.compile)


@dataclass(frozen=True, slots=True)
class OneOf(Kind):
    """One of some strings."""

    known: tuple[str, ...]

    def read(self, value: object, key: str) -> Any:
        if value is None:
            raise Refusal(key, f"expected one of {', '.join(self.known)}, found nothing")
        if not isinstance(value, str) or value not in self.known:
            raise Refusal(key, f"unknown {value!r}; {nearest(value, self.known)}")
        return value

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        return {"enum": list(self.known)}
