"""The account of a device that speaks the secure form of its protocol: who gets in, and who may read and write.

A device knows one account: ``account.json`` in the folder with its certificates, a list of user and password. The journal has each login, as an entry
``login`` with ``user``, null for none, and ``accepted``, and each thing that the account may not do, as an entry ``denied``; never a password. The poke
``{"account": STATE}`` says who gets in from now on, and cuts every connection:

============  =====================================================================================================================
``any``       everybody, with any account or none: the state of the start
``required``  who knows the account
``refused``   everybody but who knows the account; another account would do, and so would none
``denied``    who knows the account, and he may neither read nor write
============  =====================================================================================================================
"""

from __future__ import annotations

import json
from pathlib import Path

from .journal import Journal

__all__ = ["Accounts"]

_STATES = _ANY, _REQUIRED, _REFUSED, _DENIED = "any", "required", "refused", "denied"


class Accounts:
    """The one account of a device, and what is presently made of it; without a folder everybody gets in."""

    def __init__(self, journal: Journal, folder: Path | None = None) -> None:
        self._journal = journal
        file = None if folder is None else folder / "account.json"
        self._known: list[str] | None = json.loads(file.read_text()) if file is not None and file.is_file() else None
        self._state = _ANY

    def denies(self, connection: int) -> bool:
        """Tell whether a client may neither read nor write, and record that it has tried."""
        if self._state == _DENIED:
            self._journal.event(connection=connection, direction="in", kind="denied")
        return self._state == _DENIED

    def restored(self) -> None:
        """Be as at the start."""
        self._state = _ANY

    def become(self, state: object) -> None:
        """Change the state.

        Raises:
            ValueError: there is no such state, or the device knows no account.
        """
        if self._known is None or state not in _STATES:
            known = ", ".join(_STATES)
            raise ValueError(
                f"account: expected one of {known}, of a device that was started with an account, found {state!r}"
            )
        self._state = str(state)
        self._journal.event(connection=0, direction="out", kind="account", origin="kit", state=self._state)

    def lets_in(self, connection: int, user: str | None, password: str | bytes | None) -> bool:
        """Tell whether a client gets in, and record that it has asked."""
        given = password.decode("utf-8", "replace") if isinstance(password, bytes) else password
        knows = [user, given] == self._known
        accepted = self._state == _ANY or knows is (self._state != _REFUSED)
        if self._known is not None:
            self._journal.event(connection=connection, direction="in", kind="login", user=user, accepted=accepted)
        return accepted
