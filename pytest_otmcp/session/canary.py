"""Secrets that an adapter is given so that they can be looked for in everything that it says.

An adapter may tell a secret in an error, in a log or to a process that it starts. So each session gets random values: one in
every variable that the subject file names as a secret, and one more in a variable that no adapter has any reason to read, which
shows that a whole environment is told. A value of a session is worth nothing when the session is over.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from ..core.text import printable
from ..record.redaction import secret_forms

__all__ = ["CANARY_VARIABLE", "STDERR", "STDOUT", "Leak", "SecretSearch", "new_canary", "place_of"]

CANARY_VARIABLE = "OTMCP_CANARY_TOKEN"
"""Environment variable that every adapter gets and none needs."""

STDOUT, STDERR = "standard output", "standard error"
"""Places at which secrets are looked for."""

_CHARACTERS = 32
"""Letters and digits of a canary, which mean nothing in a URL, in JSON or to a shell; half of them are enough to know it by."""
_KEPT = 6
"""Leaks of one session that are told; an adapter may tell a secret with every answer."""
_LONGEST_PLACE = 120


def new_canary() -> str:
    """Return a random secret."""
    return secrets.token_hex(_CHARACTERS // 2)


@dataclass(frozen=True, slots=True)
class Leak:
    """A secret that an adapter has told.

    Attributes:
        variable: that has the secret.
        place: where it was found, in words.
        form: how it was written.
    """

    variable: str
    place: str
    form: str


@dataclass(frozen=True, slots=True)
class _Form:
    variable: str
    name: str
    data: bytes


class SecretSearch:
    """The search for the secrets of one session.

    Args:
        canaries: variable to the random value that it has in this session; half of one is looked for as well.
        fixed: variable to a value that is always the same; it is looked for as a whole.

    Attributes:
        leaks: what was found, each variable at each place once.
    """

    def __init__(self, canaries: Mapping[str, str] | None = None, fixed: Mapping[str, str] | None = None) -> None:
        self.leaks: list[Leak] = []
        self._values = {**(fixed or {}), **(canaries or {})}
        self._forms = list(_forms(canaries or {}, fixed or {}))
        self._overlap = max((len(form.data) for form in self._forms), default=1) - 1

    @property
    def told(self) -> set[str]:
        """The secrets that were found."""
        return {self._values[leak.variable] for leak in self.leaks}

    def __bool__(self) -> bool:
        """Tell whether there is anything to look for."""
        return bool(self._forms)

    def look(self, data: bytes, place: Callable[[], str]) -> None:
        """Look for the secrets in bytes; ``place`` is asked where they are from when there is one."""
        for form in self._forms:
            if form.data in data:
                self._found(form, place())

    def stream(self, place: str) -> Callable[[bytes], None]:
        """Return what takes the parts of a stream in their order."""
        kept = b""

        def take(part: bytes) -> None:
            nonlocal kept
            self.look(kept + part, lambda: place)
            kept = (kept + part)[-self._overlap :] if self._overlap else b""

        return take

    def _found(self, form: _Form, place: str) -> None:
        known = any((leak.variable, leak.place) == (form.variable, place) for leak in self.leaks)
        if not known and len(self.leaks) < _KEPT:
            self.leaks.append(Leak(form.variable, place, form.name))


def _forms(canaries: Mapping[str, str], fixed: Mapping[str, str]) -> Iterable[_Form]:
    for variable, value in canaries.items():
        for half in (value[: _CHARACTERS // 2], value[_CHARACTERS // 2 :]):
            yield from _spelt(variable, half)
            yield _Form(variable, "in capitals", half.upper().encode())
            yield _Form(variable, "backwards", half[::-1].encode())
    for variable, value in fixed.items():
        yield from _spelt(variable, value)


def _spelt(variable: str, text: str) -> list[_Form]:
    # The plainest name last in the table is the one to tell first.
    return [_Form(variable, name, form.encode()) for form, name in reversed(secret_forms(text).items())]


def place_of(message: object, request: bytes) -> str:
    """Return in words what a message of the adapter is.

    Args:
        message: as it was parsed; None for what cannot be.
        request: that it answers, where that is a call of the kit's; else empty.
    """
    if not isinstance(message, dict):
        return "a line that is no message"
    if "method" in message:
        return printable(f"the message {message['method']}")[:_LONGEST_PLACE]
    if request:
        asked = json.loads(request).get("params", {})
        return printable(f"the answer of {asked.get('name') or asked.get('uri')}")[:_LONGEST_PLACE]
    result = message.get("result")
    return "the list of tools" if isinstance(result, dict) and "tools" in result else "an answer to the client"
