"""What a BACnet exchange gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import as_bacnet, label, property_name

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``invoke_ids``, ``object``, ``property``, ``priority``, ``error_class``, ``error_code``,
    ``reject_reason`` and ``abort_reason``."""
    message = as_bacnet(entry)
    if message["kind"] == "response":
        error_class, error_code = message.get("error", [None, None])
        return {
            "error_class": [error_class],
            "error_code": [error_code],
            "reject_reason": [message.get("reject")],
            "abort_reason": [message.get("abort")],
        }
    if message["kind"] != "request" or "invoke_id" not in message:
        return {}
    about = [*message.get("reads", []), *message.get("writes", [])]
    return {
        "invoke_ids": [message["invoke_id"]],
        "object": [label(one["object"]) for one in about],
        "property": [property_name(one["property"]) for one in about],
        "priority": [one["priority"] for one in about if "priority" in one],
    }
