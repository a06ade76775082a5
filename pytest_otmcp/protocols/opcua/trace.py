"""What a service call on an OPC UA server gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import node_ids

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the member ``node_ids``.

    Nothing is said of status codes: the journal does not have those of every service, such as CreateMonitoredItems.
    """
    named = node_ids(entry) if entry["direction"] == "in" else []
    return {"node_ids": named} if named else {}
