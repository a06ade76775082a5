"""Comparison of a broker's journal entry with the payload that it holds, and of its members with its kind. Pure.

Of other packets than messages no bytes are kept: the kind of an entry, which is the packet's name, says whether it is a request
and may change the plant, and which members it can have (MQTT 3.1.1 and 5, chapter 3). What the simulated plant and the kit send
is no request.

The oracles read payloads by themselves; the decoded Sparkplug message beside a payload is for readers of the record. A value
of a type that is written in several ways, such as a data set, is compared by nobody.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from typing import Any

from ...wire.mqtt.sparkplug import DATA_TYPES, decode_message
from ..journal import JournalEntry
from ..reread import difference
from .decoder import ANSWERS, KINDS, REQUESTS

__all__ = ["contradiction", "is_answer"]

_EVENTS = frozenset({"CONNECTED", "DISCONNECTED", "lost", "mangled", "malformed", "network", "WILL", "BURST"})
_MESSAGES = frozenset({"PUBLISH", "WILL"})
_ACKNOWLEDGEMENTS = frozenset({"PUBACK", "PUBREC", "PUBREL", "PUBCOMP"})
_SUBSCRIPTIONS = frozenset({"SUBSCRIBE", "UNSUBSCRIBE"})
_KINDS_WITH = {
    "topic": _MESSAGES | {"BURST"},
    "payload": _MESSAGES,
    "sparkplug": _MESSAGES,
    "qos": _MESSAGES,
    "retain": _MESSAGES,
    "dup": frozenset({"PUBLISH"}),
    "will_sent": frozenset({"PUBLISH"}),
    "will": frozenset({"CONNECT"}),
    "clean_start": frozenset({"CONNECT"}),
    "keepalive": frozenset({"CONNECT"}),
    "filters": _SUBSCRIPTIONS,
    "packet_id": _ACKNOWLEDGEMENTS | _SUBSCRIPTIONS | {"PUBLISH", "SUBACK", "UNSUBACK"},
    "reason_codes": _ACKNOWLEDGEMENTS | {"CONNACK", "SUBACK", "UNSUBACK", "DISCONNECT", "AUTH"},
    "session_present": frozenset({"CONNACK"}),
    "count": frozenset({"BURST", "lost"}),
}
"""The kinds of entry that can have a member."""
_NEEDED = {"PUBLISH": ("topic", "payload", "qos"), "SUBSCRIBE": ("filters",), "UNSUBSCRIBE": ("filters",)}

_OF_MESSAGE = ("group", "type", "edge_node", "device", "seq", "timestamp")
_OF_METRIC = ("name", "alias", "datatype", "is_null")
_COMPARED = frozenset({"UInt8", "UInt16", "UInt32", "UInt64", "Float", "Double", "Boolean", "String", "DateTime"})
"""Data types whose values every decoder shows alike."""


def is_answer(kind: str, asked: str) -> bool:
    """Tell whether an entry of one kind can be the answer to an entry of another."""
    return ANSWERS.get(kind) == asked


def contradiction(entry: JournalEntry) -> str | None:
    """Say where an entry, or the will that it declares, differs from its kind or its payload; None where it does not."""
    members: Mapping[str, Any] = dict(entry)
    found = _of_kind(entry, members) or _of_message(entry, members)
    will = members.get("will")
    if found is None and isinstance(will, Mapping) and (of_will := _of_message(entry, will)) is not None:
        found = f"has a will that {of_will}"
    return found


def _of_kind(entry: JournalEntry, members: Mapping[str, Any]) -> str | None:
    kind = entry["kind"]
    if kind not in KINDS and kind not in _EVENTS:
        return f"is of the kind {kind!r}, which is no packet"
    asks = entry["direction"] == "in" and entry["origin"] not in ("plant", "kit")
    shown = {"request": asks and kind in REQUESTS, "state_changing": asks and kind == "PUBLISH"}
    if (found := difference(members, shown, f"kind {kind!r}")) is not None:
        return found
    for name, kinds in _KINDS_WITH.items():
        if name in members and kind not in kinds:
            return f"has {name!r}, which a {kind!r} does not have"
    missing = next((name for name in _NEEDED.get(kind, ()) if name not in members), None)
    return None if missing is None else f"is called {kind!r}, and has no {missing!r}"


def _of_message(entry: JournalEntry, message: Mapping[str, Any]) -> str | None:
    payload = message.get("payload")
    if payload is None:
        return "has a topic but no payload" if entry["kind"] == "PUBLISH" else None
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
