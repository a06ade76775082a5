"""Settings from the environment, read strictly: a value that is not understood stops the start. Only the write switch
differs: a value that is not understood leaves writes disabled."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

__all__ = ["ConfigError", "Environment"]

_TRUE = ("1", "true", "yes", "on")
_FALSE = ("0", "false", "no", "off", "")


_Entry = TypeVar("_Entry", bound=BaseModel)


class ConfigError(Exception):
    """A setting cannot be used; the message names the variable and what it expects."""


class Environment:
    """The reader of settings from environment variables."""

    def __init__(self, values: Mapping[str, str] | None = None) -> None:
        self._values = os.environ if values is None else values

    def text(self, name: str, default: str | None = None) -> str:
        """Return a string; without a default the variable is required."""
        value = self._values.get(name, default)
        if value is None:
            raise ConfigError(f"{name} is not set")
        return value

    def optional(self, name: str) -> str | None:
        """Return a string, or None when the variable is unset or empty."""
        return self._values.get(name) or None

    def entries(self, name: str, kind: type[_Entry]) -> dict[str, _Entry]:
        """Return the entries of the JSON object in the file that the variable names, by their names; none when it is unset or empty.

        Args:
            kind: what each entry is.
        """
        path = self.optional(name)
        if path is None:
            return {}
        # mypy takes no variable in the place of a type.
        entries: TypeAdapter[dict[str, _Entry]] = TypeAdapter(dict[str, kind])  # type: ignore[valid-type]
        try:
            return entries.validate_json(Path(path).read_bytes())
        except OSError as error:
            raise ConfigError(f"{name}: {path} cannot be read: {error.strerror}") from None
        except ValidationError as error:
            fault = error.errors(include_url=False, include_input=False)[0]
            place = "/".join(map(str, fault["loc"]))
            raise ConfigError(f"{name}: {path}: {place or 'the file'}: {fault['msg']}") from None

    def whole(self, name: str, default: int, minimum: int, maximum: int) -> int:
        """Return a whole number within bounds."""
        text = self._values.get(name, str(default))
        try:
            number = int(text)
        except ValueError:
            raise ConfigError(f"{name}: expected a whole number, found {text!r}") from None
        if not minimum <= number <= maximum:
            raise ConfigError(f"{name}: expected {minimum} to {maximum}, found {number}")
        return number

    def seconds(self, name: str, default: float) -> float:
        """Return a positive number of seconds, at most an hour."""
        text = self._values.get(name, str(default))
        try:
            number = float(text)
        except ValueError:
            raise ConfigError(f"{name}: expected seconds, found {text!r}") from None
        if not 0 < number <= 3600:
            raise ConfigError(f"{name}: expected seconds above 0 and up to 3600, found {text}")
        return number

    def writes_enabled(self, name: str) -> bool:
        """Return whether the write switch is on. Unset means no; so does a value that is not understood, with a warning."""
        text = self._values.get(name, "").lower()
        if text not in _TRUE + _FALSE:
            print(f"{name}: {text!r} is not understood; writes stay disabled", file=sys.stderr)
        return text in _TRUE
