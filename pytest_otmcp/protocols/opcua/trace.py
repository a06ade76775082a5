"""What a service call on an OPC UA server gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import as_opcua, node_ids, statuses

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``node_ids`` and ``status_code.symbol``."""
    if entry["direction"] == "in":
        named = node_ids(entry)
        return {"node_ids": named} if named else {}
    found = statuses(entry)
    result = as_opcua(entry).get("service_result")
    if result is not None:
        found.append(result)
    return {"status_code.symbol": found} if found else {}
