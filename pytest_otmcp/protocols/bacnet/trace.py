"""What a BACnet exchange gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..journal import JournalEntry
from .entries import ALL, as_bacnet, label, property_name

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``invoke_ids``, ``object``, ``property``, ``priority``, ``error_class``, ``error_code``,
    ``reject_reason`` and ``abort_reason``."""
    message = as_bacnet(entry)
    if message["kind"] == "response":
        # A ReadPropertyMultiple is answered by an acknowledgement that has errors among its results.
        errors = [error for part in (message, *message.get("results", ())) if (error := part.get("error"))]
        return {
            **(_about(message["results"]) if message.get("results") else {}),
            "error_class": [error_class for error_class, _ in errors] or [None],
            "error_code": [error_code for _, error_code in errors] or [None],
            "reject_reason": [message.get("reject")],
            "abort_reason": [message.get("abort")],
        }
    if message["kind"] != "request" or "invoke_id" not in message:
        return {}
    about = [*message.get("reads", []), *message.get("writes", [])]
    return {
        "invoke_ids": [message["invoke_id"]],
        **_about(about),
        "priority": [one["priority"] for one in about if "priority" in one],
    }


def _about(parts: Sequence[Mapping[str, Any]]) -> dict[str, Sequence[object]]:
    found: dict[str, Sequence[object]] = {"object": [label(one["object"]) for one in parts]}
    # What stands for all properties of an object stands for the one that the trace is about; an answer names each.
    if not any(one["property"] == ALL for one in parts):
        found["property"] = [property_name(one["property"]) for one in parts]
    return found
