"""What an EtherNet/IP exchange gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import UNTOLD, JournalEntry
from .entries import SYMBOL, as_ethernetip

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``service``, ``tag``, ``sequences``, ``status`` and ``extended_status``."""
    message = as_ethernetip(entry)
    items = message.get("items", [])
    if message["kind"] == "response":
        statuses: list[object] = [item.get("status") for item in items]
        extended: list[object] = [item.get("extended") for item in items]
        return {
            "status": [*statuses, message.get("status")],
            "extended_status": [*extended, message.get("extended")],
        }
    if message["kind"] != "request":
        return {}
    found: dict[str, Sequence[object]] = {
        "service": [*(item.get("code") for item in items), _outer(message["service"])]
    }
    # The instance of a symbol stands for a name that the message does not have.
    found["tag"] = [
        UNTOLD if item.get("class") == SYMBOL else item["tag"]
        for item in items
        if item.get("class") == SYMBOL or "tag" in item
    ]
    if "sequence" in message:
        found["sequences"] = [message["sequence"]]
    return found


def _outer(service: str) -> int | None:
    return 0x0A if service == "multiple" else None
