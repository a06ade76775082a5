"""Journal entries and device images, whatever the protocol: their contract. Pure.

Every witness, mock or tap, writes entries of this shape, with further members of its protocol. Images have ``points``, a
flat mapping of names to values, beside the further members that a protocol's image has.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..core.journal_entry import JournalEntry

__all__ = ["ADAPTER", "Entries", "Image", "JournalEntry", "judged"]


Entries = Sequence[JournalEntry]
Image = Mapping[str, Any]

ADAPTER = "client"
"""Origin of what the adapter under test caused in its session."""
_NOT_JUDGED = frozenset({"former", "stranger", "unknown"})


def judged(entries: Iterable[JournalEntry]) -> list[JournalEntry]:
    """Return the entries that may accuse the adapter and may prove something for it.

    What another program caused is left out, and what a session caused that is over. This is the one place that says so: steps
    and oracles are given nothing else.
    """
    return [entry for entry in entries if entry["origin"] not in _NOT_JUDGED]
