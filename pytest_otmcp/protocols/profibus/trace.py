"""What a PROFIBUS exchange gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import as_profibus

__all__ = ["facts"]

_NAMES = {"rd_inp": "RD_Inp", "rd_outp": "RD_Outp", "fdl_status": "FDL_Status"}


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``station``, ``service``, ``dsap`` and ``fdl_status``."""
    message = as_profibus(entry)
    if message["kind"] == "response":
        return {"fdl_status": [message.get("status")]}
    if message["kind"] not in ("request", "cycle"):
        return {}
    service = message["service"]
    named = _NAMES.get(service) or "_".join(part.capitalize() for part in service.split("_"))
    return {"station": [message["station"]], "service": [named, service], "dsap": [message.get("dsap")]}
