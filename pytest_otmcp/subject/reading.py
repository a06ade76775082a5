"""Typed access to a TOML document; every objection is one sentence: file, key, what was expected, nearest known name."""

from __future__ import annotations

import datetime
import difflib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jmespath

from ..core.errors import UsageError

__all__ = ["Reader"]


class Reader:
    """Checks the values of one file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def refuse(self, key: str, message: str) -> UsageError:
        """The objection to raise."""
        return UsageError(f"{self.path}: {key}: {message}" if key else f"{self.path}: {message}")

    def table(self, value: Any, key: str, known: Iterable[str] | None = None) -> dict[str, Any]:
        """A table that has only ``known`` keys."""
        if not isinstance(value, dict):
            raise self.refuse(key, f"expected a table, found {kind(value)}")
        if known is not None:
            names = list(known)
            for name in value:
                self.choice(name, f"{key}.{name}" if key else name, names, "unknown key")
        return value

    def choice(self, value: Any, key: str, known: Iterable[str], what: str = "unknown") -> str:
        """One of ``known``."""
        names = list(known)
        if value in names and isinstance(value, str):
            return value
        near = difflib.get_close_matches(str(value), names, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(sorted(names))}"
        raise self.refuse(key, f"{what} {value!r}; {hint}" if what == "unknown" else f"{what}; {hint}")

    def text(self, table: Mapping[str, Any], name: str, key: str) -> str:
        """A string that is not empty."""
        value = table.get(name)
        if not isinstance(value, str) or not value:
            raise self.refuse(f"{key}.{name}", f"expected a non-empty string, found {kind(value)}")
        return value

    def texts(self, value: Any, key: str) -> dict[str, str]:
        """A table of strings."""
        table = self.table(value, key)
        for name, entry in table.items():
            if not isinstance(entry, str):
                raise self.refuse(f"{key}.{name}", f"expected a string, found {kind(entry)}")
        return table

    def text_list(self, value: Any, key: str, what: str) -> tuple[str, ...]:
        """A list of strings."""
        if not isinstance(value, list) or not all(isinstance(part, str) for part in value):
            raise self.refuse(key, f"expected a list of strings, {what}, found {kind(value)}")
        return tuple(value)

    def seconds(self, table: Mapping[str, Any], name: str, key: str, default: float) -> float:
        """Seconds, above 0 and up to 300."""
        value = table.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= 300:
            raise self.refuse(f"{key}.{name}", f"expected seconds above 0 and up to 300, found {value!r}")
        return float(value)

    def flag(self, table: Mapping[str, Any], name: str, key: str) -> bool | None:
        """True, false, or absent."""
        value = table.get(name)
        if value is not None and not isinstance(value, bool):
            raise self.refuse(f"{key}.{name}", f"expected true or false, found {kind(value)}")
        return value

    def path_expression(self, value: Any, key: str) -> str:
        """A JMESPath expression."""
        if not isinstance(value, str):
            raise self.refuse(key, f"expected a JMESPath expression in a string, found {kind(value)}")
        try:
            jmespath.compile(value)
        except jmespath.exceptions.JMESPathError as error:
            raise self.refuse(key, f"not a JMESPath expression: {str(error).splitlines()[0]}") from None
        return value

    def regex(self, value: Any, key: str) -> str:
        """A regular expression as Python's ``re`` has them."""
        if not isinstance(value, str) or not value:
            raise self.refuse(key, f"expected a regular expression in a string, found {kind(value)}")
        try:
            re.compile(value)
        except re.error as error:
            raise self.refuse(key, f"not a regular expression: {error}") from None
        return value

    def date(self, table: Mapping[str, Any], name: str, key: str) -> datetime.date:
        """A day, as TOML writes it: 2027-03-31."""
        value = table.get(name)
        if isinstance(value, datetime.datetime) or not isinstance(value, datetime.date):
            raise self.refuse(
                f"{key}.{name}", f"expected a date such as 2027-03-31 without quotes, found {kind(value)}"
            )
        return value


def kind(value: Any) -> str:
    """What a value is, in TOML's words."""
    if value is None:
        return "nothing"
    if isinstance(value, datetime.date):
        return "a date"
    return {dict: "a table", list: "a list", str: "a string", bool: "a boolean"}.get(type(value), "a number")
