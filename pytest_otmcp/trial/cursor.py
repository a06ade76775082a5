"""Where an adapter is in the journal of its device: what has been taken, and what its session's oracles have seen. Pure.

The same object serves a bench and the judging of a stored run again: journals are looked at in the same order in both.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from ..protocols.registry import protocols
from ..protocols.session_oracle import SessionOracle
from .ledger import Entry

__all__ = ["JournalCursor", "Oracle"]

Oracle = TypeVar("Oracle", bound=SessionOracle)


class JournalCursor:
    """Position of one adapter in the journal of its device.

    Args:
        protocol: of the adapter; its description names the session oracles.

    Attributes:
        next: sequence number at which the next slice begins.
        fed: sequence number before which the session's oracles have seen everything.
        starts: how often the device was started again.
        session: sequence number at which the adapter's last session began; None when there was none.
        connected: that session is open.
        looked_through: everything before ``next`` has been looked at, and since then nobody has called the adapter.
    """

    def __init__(self, protocol: str) -> None:
        self._kinds = protocols()[protocol].session_oracles
        self._oracles: dict[type[SessionOracle], SessionOracle] = {}
        self.next = 0
        self.fed = 0
        self.starts = 0
        self.session: int | None = None
        self.connected = False
        self.looked_through = False

    @property
    def quiet(self) -> bool:
        """What comes from ``next`` on, comes by itself."""
        return self.connected and self.looked_through

    def open_session(self, seq: int) -> None:
        """Begin a session at this sequence number."""
        self.session = seq
        self.connected = True
        self._oracles = {kind: kind() for kind in self._kinds}

    def close_session(self) -> None:
        """End the session; its oracles still answer for it."""
        self.connected = False

    def restart(self) -> None:
        """Begin a journal that counts from 0 again, as a device that was started has it."""
        self.starts += 1
        self.next = self.fed = 0
        if self.session is not None:
            self.session = 0
            self._oracles = {kind: kind() for kind in self._kinds}

    def feed(self, entries: Iterable[Entry], until: int) -> None:
        """Show the session's oracles the entries that they have not seen, which are all before ``until``."""
        for entry in entries:
            if self.session is not None and entry["seq"] >= max(self.fed, self.session):
                for oracle in self._oracles.values():
                    oracle.feed(entry)
        self.fed = max(self.fed, until)

    def take(self, entries: Iterable[Entry], until: int) -> None:
        """Take a slice: the next one begins where this one ends."""
        self.feed(entries, until)
        self.next = until

    def oracle(self, kind: type[Oracle]) -> Oracle:
        """Return the session's oracle of this kind, which has seen everything before ``fed``.

        Raises:
            LookupError: the protocol does not name it, or there never was a session.
        """
        found = self._oracles[kind]
        assert isinstance(found, kind)
        return found
