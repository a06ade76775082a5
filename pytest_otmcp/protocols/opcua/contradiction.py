"""Comparison of an OPC UA server's journal entry with the chunks that it holds, and with itself. Pure.

The kind of an entry is the name of a service (OPC 10000-4, annex A of OPC 10000-6), or one of the few that are none. It says
whether the entry is a request and may change the plant, and which members the entry can have.
"""

from __future__ import annotations

import re

from ...wire.framing import Framer
from ...wire.opcua import chunk_length
from ..journal import JournalEntry
from ..reread import difference
from .decoder import SERVICES, SESSION_KEEPING, STATE_CHANGING, OpcUaConversation
from .entries import as_opcua

__all__ = ["contradiction", "is_answer"]

_NO_SERVICE = frozenset(
    {"CONNECTED", "DISCONNECTED", "lost", "mangled", "malformed", "network"}
    | {"Hello", "Acknowledge", "Error", "ReverseHello", "Abort"}
)
"""Events, and messages of the connection protocol (OPC 10000-6, section 7.1.2)."""
_SEALED = "Sealed"
_SERVICES = frozenset(SERVICES.values()) | {
    *("CallMethod", "MonitoredItemCreate", "MonitoredItemModify"),
}
"""What a client may send, also what it should not: every structure of annex A whose name ends like a request's."""
_UNNAMED = re.compile(r"(ns=\d+;)?[isgb]=.*")
"""A service without a name: the node id of its request."""

_NAMES_NODES = frozenset({"Read", "Write", "Browse", "TranslateBrowsePaths", "Call", "CreateMonitoredItems"})
_NOTIFICATION = "Publish"
_OF_ATTRIBUTES = frozenset({"Read", "Write", "CreateMonitoredItems", _NOTIFICATION})
_WITH_RESULTS = frozenset(
    {"Read", "Write", "Browse", "BrowseNext", "TranslateBrowsePaths", "Call", "CreateMonitoredItems"}
    | {"AddReferences", "DeleteNodes", "DeleteReferences"}
)
_WRITTEN = frozenset({"value", "variant_type", "has_status", "has_timestamp"})
_WAYS = {True: "received", False: "sent"}


def is_answer(kind: str, asked: str) -> bool:
    """Tell whether an entry of one kind can be the answer to an entry of another: an answer is of the same service."""
    return kind == asked


def contradiction(entry: JournalEntry) -> str | None:
    """Say where the members of an entry are not those of its kind; None where they are."""
    kind, asks = entry["kind"], entry["direction"] == "in"
    if kind in _NO_SERVICE:
        shown = {"request": False, "state_changing": False}
    elif kind == _SEALED:
        # It may ask for anything, or keep the session.
        shown = {"state_changing": entry["request"]}
    elif kind in _SERVICES or _UNNAMED.fullmatch(kind):
        shown = {"request": asks and kind not in SESSION_KEEPING, "state_changing": asks and kind in STATE_CHANGING}
    else:
        return f"is of the kind {kind!r}, which is no service"
    found = difference(dict(entry), shown, f"kind {kind!r}")
    return found or _unwanted(entry) or _wrong_node(entry) or _of_chunks(entry)


def _of_chunks(entry: JournalEntry) -> str | None:
    """Say where an entry differs from its chunks; None where it does not, or has none."""
    chunks = as_opcua(entry).get("chunks")
    if chunks is None:
        return None
    framer, conversation = Framer(chunk_length), OpcUaConversation()
    try:
        frames = framer.feed(bytes.fromhex(chunks))
    except (TypeError, ValueError):
        return f"has no chunks but {chunks!r}"
    messages = [message for frame in frames for message in conversation.decode(entry["direction"], frame)]
    if framer.pending or len(messages) != 1 or messages[0].kind == "malformed":
        return "has chunks that are no message"
    (message,) = messages
    shown = {"kind": message.kind, "request": message.request, "state_changing": message.state_changing}
    if entry["direction"] == "out" and message.kind not in SERVICES.values():
        # Of which service it is the fault, the request says.
        del shown["kind"]
    return difference(dict(entry), {**shown, **message.fields}, "message")


def _unwanted(entry: JournalEntry) -> str | None:
    """Say which member the entry cannot have."""
    kind, came = entry["kind"], entry["direction"] == "in"
    browses = not came and kind in ("Browse", "BrowseNext")
    allowed = {
        "nodes": kind in _NAMES_NODES if came else kind == _NOTIFICATION,
        "methods": came and kind == "Call",
        "results": not came and kind in _WITH_RESULTS,
        "counts": browses,
        "open_points": browses,
        "service_result": not came and kind not in _NO_SERVICE,
    }
    found = next((name for name, can_be in allowed.items() if name in entry and not can_be), None)
    return None if found is None else f"has {found!r}, which a {kind!r} that was {_WAYS[came]} does not have"


def _wrong_node(entry: JournalEntry) -> str | None:
    kind = entry["kind"]
    for node in as_opcua(entry).get("nodes", []):
        if kind not in _OF_ATTRIBUTES:
            if not isinstance(node, str):
                return f"is called {kind!r}, and names more than the node: {node!r}"
        elif not isinstance(node, dict) or not {"node_id", "attribute"} <= node.keys():
            return f"is called {kind!r}, and names the node {node!r} without its attribute"
        elif (kind == "Write") != bool(_WRITTEN & node.keys()):
            return f"is called {kind!r}, and has {'no value' if kind == 'Write' else 'a value'} of {node['node_id']!r}"
    return None
