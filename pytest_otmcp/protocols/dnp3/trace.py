"""What a DNP3 exchange gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import as_dnp3, commands

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``outstation``, ``functions``, ``sequences``, ``iin`` and ``status``."""
    message = as_dnp3(entry)
    if message["kind"] == "response":
        return {"iin": [message["iin"]], "status": [one["status"] for one in commands(entry)]}
    if message["kind"] != "request":
        return {}
    return {
        "outstation": [message.get("destination")],
        "functions": [message["function"]],
        "sequences": [message["sequence"]],
    }
