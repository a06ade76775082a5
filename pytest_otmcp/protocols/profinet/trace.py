"""What a PROFINET exchange gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import as_profinet

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``service``, ``slot``, ``subslot``, ``index`` and ``pnio_error``."""
    message = as_profinet(entry)
    found: dict[str, Sequence[object]] = {}
    if message["kind"] == "response":
        status = message.get("status")
        return {"pnio_error": [status, None if status is None else status.upper()]}
    if message["kind"] in ("request", "cycle", "inputs"):
        service = message["service"]
        found["service"] = [service, service.capitalize()]
        found |= {name: [message[name]] for name in ("slot", "subslot", "index") if name in message}
        if "subslots" in message:
            # A cyclic frame is about each of its subslots.
            places = [[int(number) for number in place.split(".")] for place in message["subslots"]]
            found |= {"slot": [slot for slot, _ in places], "subslot": [subslot for _, subslot in places]}
    return found
