"""Oracles over the whole life of an adapter's session, however long it is. Pure.

Such an oracle keeps what it needs to know from one journal entry to the next, so that neither the cost of a question nor the
memory grows with the age of the session. A protocol names its oracles in its description; every session has one of each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping

from ..core.finding import Finding
from .journal import JournalEntry

__all__ = ["Exchanges", "SessionOracle", "StateChanges"]

_KEPT = 10
_ANSWERS_KEPT = 1000


class SessionOracle(ABC):
    """An oracle that gets each journal entry once, since the session was opened or, if that was later, the device started."""

    def restarted(self) -> SessionOracle:
        """Return the oracle that goes on after the device was started again; by default one that knows nothing."""
        return type(self)()

    def renewed(self) -> SessionOracle:
        """Return the oracle of the adapter's next session; by default one that knows nothing."""
        return type(self)()

    def failed(self, inputs: Mapping[str, object]) -> None:  # noqa: B027 - most oracles have nothing to note
        """Take into account that a write was reported as failed while the device was away.

        Args:
            inputs: of the operation.
        """

    def take_faults(self) -> list[Finding]:
        """Return what is wrong whatever the tasks ask for, each fault once."""
        return []

    @abstractmethod
    def feed(self, entry: JournalEntry) -> None:
        """Take the next entry into account."""


class StateChanges(SessionOracle):
    """The requests that may change the plant.

    Attributes:
        count: number of such requests.
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


class Exchanges(SessionOracle):
    """The moments at which the device answered the adapter, as far back as an answer from memory may go."""

    def __init__(self) -> None:
        self._answered_ns: deque[int] = deque(maxlen=_ANSWERS_KEPT)

    def feed(self, entry: JournalEntry) -> None:
        """Note the time of an answer."""
        if entry["answers"] is not None and entry["origin"] == "client":
            self._answered_ns.append(entry["t_ns"])

    def between(self, begin_ns: int, end_ns: int) -> bool:
        """Tell whether the device answered in this time."""
        return any(begin_ns <= moment <= end_ns for moment in self._answered_ns)
