"""Journal entries and device images, whatever the protocol: their contract. Pure.

Every witness, mock or tap, writes entries of this shape, with further members of its protocol. Images have ``points``, a
flat mapping of names to values, beside the further members that a protocol's image has.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..core.journal_entry import JournalEntry

__all__ = ["ADAPTER", "CYCLIC", "HANDSHAKES", "UNTOLD", "Entries", "Image", "JournalEntry", "judged"]


Entries = Sequence[JournalEntry]
Image = Mapping[str, Any]

ADAPTER = "client"
"""Origin of what the adapter under test caused in its session."""
CYCLIC = frozenset({"cycle", "inputs"})
"""Kinds of entries about process data, which come and go without being asked for each time: who reads them has read the device."""
HANDSHAKES = frozenset({"tls", "tls_open", "tls_ended", "tls_alert", "tls_plaintext", "account", "login", "denied"})
"""Kinds of entries about a device's end of TLS and its account (``mocks/tls``, ``mocks/accounts``): none of them asks the device for anything.
``tls``, of the kit, presents another certificate; ``account`` lets others in."""
UNTOLD = object()
"""A fact (``OtProtocol.facts``) that a message refers to without telling it, as a number stands for a name agreed upon before."""
_NOT_JUDGED = frozenset({"former", "stranger", "unknown"})


def judged(entries: Iterable[JournalEntry]) -> list[JournalEntry]:
    """Return the entries that may accuse the adapter and may prove something for it.

    What another program caused is left out, and what a session caused that is over. This is the one place that says so: steps
    and oracles are given nothing else.
    """
    return [entry for entry in entries if entry["origin"] not in _NOT_JUDGED]
