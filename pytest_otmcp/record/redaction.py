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

__all__ = ["REDACTED", "Redactor", "secret_forms"]

REDACTED = "[redacted]"

_SHORTEST = 4
"""Characters of the shortest secret: a shorter one would be found in the middle of ordinary words and numbers."""

_NO_SECRETS = {"true", "false", "none", "null", "enabled", "disabled", "required", "optional"}


T = TypeVar("T")


def secret_forms(secret: str) -> dict[str, str]:
    """Return every spelling of a secret that is looked for, each with its name."""
    data = secret.encode()
    forms = {"".join(f"%{byte:{style}}" for byte in data): "percent-encoded" for style in ("02x", "02X")} | {
        data.hex(): "in hexadecimal digits",
        data.hex().upper(): "in hexadecimal digits",
    }
    for before in range(3):
        # What stands before it, such as a user name and a colon, moves it within the groups of three bytes: the characters that
        # depend on its neighbours are left out (RFC 4648, section 4).
        padded = bytes(before) + data
        whole = len(padded) // 3 * 4
        for encode in (base64.b64encode, base64.urlsafe_b64encode):
            forms[encode(padded).decode()[(0, 2, 3)[before] : whole]] = "in base64"
    for form in (json.dumps(secret)[1:-1], quote(secret, safe=""), quote_plus(secret)):
        forms[form] = "escaped"
    return forms | {base64.b64encode(data).decode(): "in base64", secret: "as it is"}


class Redactor:
    """Replacement of secrets, also where they are written in JSON, in a URL, in hexadecimal digits or in base64."""

    def __init__(self, secrets: Iterable[str]) -> None:
        forms: set[str] = set()
        for secret in secrets:
            if len(secret) >= _SHORTEST and secret.lower() not in _NO_SECRETS:
                # A part of a short one in base64 may be any word.
                forms |= {form for form in secret_forms(secret) if len(form) >= len(secret)}
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
            shown = {self.text(name): self._applied(member) for name, member in value.items()}
            if "frame" in shown and shown != value:
                # A message that held a secret is kept as it was read: its bytes without the secret are no message.
                del shown["frame"]
            return shown
        if isinstance(value, list):
            return [self._applied(element) for element in value]
        return value
