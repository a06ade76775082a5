"""What an S7 exchange gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import as_s7

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``function``, ``area``, ``db``, ``start``, ``references``, ``error_code`` and
    ``return_code``."""
    message = as_s7(entry)
    if message["kind"] == "response":
        codes = [item["code"] for item in message.get("items", []) if "code" in item]
        return {"error_code": [message.get("error")], "return_code": codes or [message.get("code")]}
    if message["kind"] != "request":
        return {}
    found: dict[str, Sequence[object]] = {"references": [message["reference"]]}
    if "function" in message:
        found["function"] = [message["function"]]
    items = message.get("items", [])
    if items:
        members = {"area": "area", "db": "db", "start": "byte"}
        found |= {name: [item.get(member) for item in items] for name, member in members.items()}
    return found
