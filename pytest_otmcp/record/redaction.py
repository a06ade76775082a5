"""Removal of secrets from everything that a run keeps or shows. Pure.

A record is read by people who must not know the plant's passwords; an adapter may print them on stderr, in an error or in an
envelope.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable
from typing import TypeVar, cast
from urllib.parse import quote, quote_plus

__all__ = ["REDACTED", "Redactor"]

REDACTED = "[redacted]"

_SHORTEST = 4
"""Characters of the shortest secret: a shorter one would be found in the middle of ordinary words and numbers."""

_NO_SECRETS = {"true", "false", "none", "null", "enabled", "disabled", "required", "optional"}


T = TypeVar("T")


class Redactor:
    """Replacement of secrets, also where they are written in JSON, in a URL or in base64."""

    def __init__(self, secrets: Iterable[str]) -> None:
        forms: set[str] = set()
        for secret in secrets:
            if len(secret) >= _SHORTEST and secret.lower() not in _NO_SECRETS:
                encoded = base64.b64encode(secret.encode()).decode()
                forms |= {secret, json.dumps(secret)[1:-1], quote(secret, safe=""), quote_plus(secret), encoded}
        # Longer forms first: one form may be part of another.
        self._forms = sorted(forms, key=lambda form: (-len(form), form))

    def text(self, text: str) -> str:
        """Return ``text`` without secrets."""
        for form in self._forms:
            text = text.replace(form, REDACTED)
        return text

    def apply(self, value: T) -> T:
        """Return a JSON value without secrets in its texts and member names."""
        return cast(T, self._applied(value)) if self._forms else value

    def _applied(self, value: object) -> object:
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, dict):
            return {self.text(name): self._applied(member) for name, member in value.items()}
        if isinstance(value, list):
            return [self._applied(element) for element in value]
        return value
