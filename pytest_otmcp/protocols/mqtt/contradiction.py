"""Comparison of a broker's journal entry with the payload that it holds. Pure.

The oracles read payloads by themselves; the decoded Sparkplug message beside a payload is for readers of the record. A value
of a type that is written in several ways, such as a data set, is compared by nobody.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from typing import Any

from ..journal import JournalEntry
from ..reread import difference
from .sparkplug_decoder import DATA_TYPES, decode_message

__all__ = ["contradiction"]

_OF_MESSAGE = ("group", "type", "edge_node", "device", "seq", "timestamp")
_OF_METRIC = ("name", "alias", "datatype", "is_null")
_COMPARED = frozenset({"UInt8", "UInt16", "UInt32", "UInt64", "Float", "Double", "Boolean", "String", "DateTime"})
"""Data types whose values every decoder shows alike."""


def contradiction(entry: JournalEntry) -> str | None:
    """Say where an entry, or the will that it declares, differs from its payload; None where it does not."""
    members: Mapping[str, Any] = dict(entry)
    found = _of_message(entry, members)
    will = members.get("will")
    if found is None and isinstance(will, Mapping) and (of_will := _of_message(entry, will)) is not None:
        found = f"has a will that {of_will}"
    return found


def _of_message(entry: JournalEntry, message: Mapping[str, Any]) -> str | None:
    payload = message.get("payload")
    if payload is None:
        return "has a topic but no payload" if entry["kind"] == "PUBLISH" and "topic" in message else None
    try:
        content = base64.b64decode(payload, validate=True)
    except (TypeError, binascii.Error, ValueError):
        return f"has the payload {payload!r}, which is no base64"
    stated = message.get("sparkplug")
    shown = decode_message(str(message.get("topic")), content)
    if stated is None or "error" in stated or shown is None or "error" in shown:
        return None
    return _of_sparkplug(stated, shown)


def _of_sparkplug(stated: Mapping[str, Any], shown: Mapping[str, Any]) -> str | None:
    found = difference(stated, {name: shown[name] for name in _OF_MESSAGE}, "payload")
    if found is None and len(stated["metrics"]) != len(shown["metrics"]):
        found = f"says {len(stated['metrics'])} metrics, its payload says {len(shown['metrics'])}"
    if found is not None:
        return found
    for one, other in zip(stated["metrics"], shown["metrics"], strict=True):
        datatype = other["datatype"]
        names = [*_OF_METRIC]
        if datatype is not None and datatype < len(DATA_TYPES) and DATA_TYPES[datatype] in _COMPARED:
            names.append("value")
        if (found := difference(one, {name: other[name] for name in names}, "payload")) is not None:
            return f"{found} of the metric {other['name']!r}"
    return None
