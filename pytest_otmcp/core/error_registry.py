"""The error registry (``errors.toml``) as frozen data, and the mapping of a protocol's own codes to it. Pure."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

__all__ = ["ErrorCode", "WireCode", "registry", "wire_codes"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorCode:
    """One code of the registry.

    Attributes:
        classes: acceptable values of ``error.class``.
        meaning: one phrase.
        outcomes: acceptable values of ``error.outcome`` for a call that changes state.
        retry_read, retry_write: ``yes``, ``no``, ``verify``, or None where the code cannot occur.
        label: name in the paper's tables, or None.
    """

    code: str
    classes: tuple[str, ...]
    meaning: str
    outcomes: tuple[str, ...]
    retry_read: str | None
    retry_write: str | None
    label: str | None

    def allows_retryable(self, value: bool) -> bool:
        """Tell whether ``error.retryable`` may have this value.

        ``retryable`` says that the same request may simply be repeated. It must not be true where no kind of request may
        be repeated, nor false where every kind may.
        """
        rules = {rule for rule in (self.retry_read, self.retry_write) if rule is not None}
        return "yes" in rules if value else rules != {"yes"}

    def allows_outcome(self, value: str) -> bool:
        """Tell whether ``error.outcome`` may have this value; ``not_applicable`` is right for every call that changes
        nothing."""
        return value == "not_applicable" or value in self.outcomes


@dataclass(frozen=True, slots=True, kw_only=True)
class WireCode:
    """One code of a protocol and its meaning in the envelope.

    Attributes:
        key: as in the data file: a number in decimal, a symbol of the specification, or a socket condition.
        name: the specification's own name.
        value: the number on the wire, None for socket conditions.
        codes: acceptable error codes; empty for a code of success.
        outcome: of a write, or None where it cannot occur.
        retry: of a write: ``yes``, ``no``, ``verify`` or None.
    """

    key: str
    name: str
    value: int | None
    codes: tuple[str, ...]
    outcome: str | None
    retry: str | None


@cache
def _document() -> Mapping[str, Any]:
    return tomllib.loads((resources.files(__package__) / "errors.toml").read_text(encoding="utf-8"))


@cache
def registry() -> Mapping[str, ErrorCode]:
    """Return the error registry, code to entry."""
    return {
        code: ErrorCode(
            code=code,
            classes=tuple(entry["class"]),
            meaning=entry["meaning"],
            outcomes=tuple(entry["outcome"]),
            retry_read=entry.get("retry_read"),
            retry_write=entry.get("retry_write"),
            label=entry.get("label"),
        )
        for code, entry in _document()["codes"].items()
    }


@cache
def wire_codes(package: str, file: str = "codes.toml", table: str = "codes") -> Mapping[str, WireCode]:
    """Read a protocol's own codes and their meaning in the envelope, key to entry.

    Args:
        package: the package that holds the file, such as that of a protocol; ``pytest_otmcp.core`` with ``errors.toml``
            and the table ``socket`` for conditions of sockets.
        file: name of the file.
        table: name of the table in the file.

    Raises:
        KeyError: there is no such table.
    """
    document = tomllib.loads((resources.files(package) / file).read_text(encoding="utf-8"))
    return {
        key: WireCode(
            key=key,
            name=entry.get("name", key),
            value=entry.get("value", int(key) if key.isdecimal() else None),
            codes=tuple(entry.get("code", ())),
            outcome=entry.get("outcome"),
            retry=entry.get("retry"),
        )
        for key, entry in document[table].items()
    }
