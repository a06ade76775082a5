"""The error registry (``errors.toml``) as frozen data. Pure."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

__all__ = ["ErrorCode", "registry"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorCode:
    """One code of the registry.

    Attributes:
        classes: acceptable values of ``error.class``.
        meaning: one phrase.
        retry_read, retry_write: ``yes``, ``no``, ``verify``, or None where the code cannot occur.
    """

    code: str
    classes: tuple[str, ...]
    meaning: str
    retry_read: str | None
    retry_write: str | None

    def allows_retryable(self, value: bool) -> bool:
        """``error.retryable`` may have this value: it says that the same request may simply be repeated, so it must
        not be true where no kind of request may be, nor false where every kind may."""
        rules = {rule for rule in (self.retry_read, self.retry_write) if rule is not None}
        return "yes" in rules if value else rules != {"yes"}


@cache
def registry() -> Mapping[str, ErrorCode]:
    """Code to entry."""
    document = tomllib.loads((resources.files(__package__) / "errors.toml").read_text(encoding="utf-8"))
    return {
        code: ErrorCode(
            code=code,
            classes=tuple(entry["class"]),
            meaning=entry["meaning"],
            retry_read=entry.get("retry_read"),
            retry_write=entry.get("retry_write"),
        )
        for code, entry in document.items()
    }
