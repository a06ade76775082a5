"""Journal entries and device images, whatever the protocol: their contract. Pure.

Every witness, mock or tap, writes entries of this shape, with further members of its protocol. Images have ``points``, a
flat mapping of names to values, beside the further members that a protocol's image has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..core.journal_entry import JournalEntry

__all__ = ["Entries", "Image", "JournalEntry"]


Entries = Sequence[JournalEntry]
Image = Mapping[str, Any]
