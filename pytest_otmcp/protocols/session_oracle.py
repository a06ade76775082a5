"""Oracles over the whole life of an adapter's session, however long it is. Pure.

Such an oracle carries what it needs to know from one entry of the journal to the next, so that no question costs more because
the session is older. A protocol names its own in its description; every session has one of each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

__all__ = ["SessionOracle"]


class SessionOracle(ABC):
    """Is fed with each journal entry since the session was opened, or since the device was started if that was later, once."""

    @abstractmethod
    def feed(self, entry: Mapping[str, Any]) -> None:
        """Take the next entry into account."""
