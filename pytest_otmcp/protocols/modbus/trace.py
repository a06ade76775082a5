"""What a Modbus exchange gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import as_modbus

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message says of the members ``unit``, ``function``, ``address``, ``transaction_ids``, ``exception_code``."""
    message = as_modbus(entry)
    if message["kind"] == "response":
        return {"exception_code": [message.get("exception")]}
    if message["kind"] != "request":
        return {}
    addresses = [message["address"]] if "address" in message else []
    return {
        "unit": [message["unit"]],
        "function": [message["function"]],
        "transaction_ids": [message["transaction_id"]],
        **({"address": addresses} if addresses else {}),
    }
