"""Oracles over the whole life of an adapter's session, however long it is. Pure.

Such an oracle carries what it needs to know from one entry of the journal to the next, so that no question costs more because
the session is older, and takes no more room. A protocol names its own in its description; every session has one of each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from .journal import JournalEntry

__all__ = ["SessionOracle", "StateChanges"]

_KEPT = 10


class SessionOracle(ABC):
    """Is fed with each journal entry since the session was opened, or since the device was started if that was later, once."""

    @abstractmethod
    def feed(self, entry: JournalEntry) -> None:
        """Take the next entry into account."""


class StateChanges(SessionOracle):
    """The requests that may change the plant.

    Attributes:
        count: how many there were.
        first: the first few of them.
    """

    def __init__(self) -> None:
        self.count = 0
        self.first: list[JournalEntry] = []

    def feed(self, entry: JournalEntry) -> None:
        """Count the entry if it is such a request."""
        if entry["state_changing"]:
            self.count += 1
            if len(self.first) < _KEPT:
                self.first.append(entry)
