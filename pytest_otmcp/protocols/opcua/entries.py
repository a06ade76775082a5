"""Journal entries of an OPC UA server (services of OPC 10000-4), and the comparison of values that its points hold."""

from __future__ import annotations

import struct
from typing import Any, TypedDict, cast

from ...core.strict_json import same_json
from ..journal import Entries, Image, JournalEntry

__all__ = [
    "Item",
    "OpcUaEntry",
    "answers",
    "as_opcua",
    "carried_out",
    "describe",
    "holds_value",
    "node_ids",
    "statuses",
    "values_asked",
]


class Item(TypedDict, total=False):
    """A node that a Read or Write names.

    Members:
        node_id, attribute: of the node.
        value: the value that is written.
        variant_type: name of the built-in type with which it is written.
        has_status, has_timestamp: a status or a timestamp is written with it.
    """

    node_id: str
    attribute: str
    value: Any
    variant_type: str
    has_status: bool
    has_timestamp: bool


class OpcUaEntry(JournalEntry, total=False):
    """An entry whose kind is the name of a service.

    Members:
        nodes: the nodes that a request names, or whose values a Publish notifies of; for other services than Read, Write,
            CreateMonitoredItems and Publish only their node ids.
        methods: of a Call: for each method ``object_id``, ``method_id``, ``arguments`` and the ``types`` of these.
        results: of an answer, one for each item: an object with ``status``, the symbol of a status code.
        open_points: of an answer to Browse or BrowseNext: how many continuation points the session has open; missing for none.
        service_result: symbol of the status code of the service as a whole.
    """

    nodes: list[Any]
    methods: list[Any]
    results: list[Any]
    open_points: int
    service_result: str


def as_opcua(entry: JournalEntry) -> OpcUaEntry:
    """Return an entry of an OPC UA server's journal with its own type."""
    return cast(OpcUaEntry, entry)


def node_ids(entry: JournalEntry) -> list[str]:
    """Return the node ids that a request names."""
    return [node["node_id"] if isinstance(node, dict) else node for node in as_opcua(entry).get("nodes", [])]


def values_asked(entry: JournalEntry) -> list[str]:
    """Return the node ids whose value a request asks for, or a notification has."""
    asks = entry["request"] and entry["kind"] in ("Read", "CreateMonitoredItems")
    if not asks and not (entry["direction"] == "out" and entry["kind"] == "Publish"):
        return []
    return [node["node_id"] for node in as_opcua(entry).get("nodes", []) if node["attribute"] == "Value"]


def statuses(entry: JournalEntry) -> list[str]:
    """Return the symbols of the status codes of an answer, one for each item."""
    results = as_opcua(entry).get("results", [])
    return [str(result["status"] if isinstance(result, dict) else result) for result in results]


def answers(entries: Entries, kind: str) -> list[JournalEntry]:
    """Return the answers of one service."""
    return [entry for entry in entries if entry["direction"] == "out" and entry["kind"] == kind]


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether the server did at least a part of what a request asked for."""
    if answer is None:
        return None
    results = statuses(answer) or [as_opcua(answer).get("service_result", "Good")]
    return any(not status.startswith("Bad") for status in results)


def describe(entry: JournalEntry) -> str:
    """Describe a service request in a few words."""
    return f"{entry['kind']} {', '.join(node_ids(entry)[:4])}".strip()


def holds_value(image: Image, node: str, held: object, wanted: object) -> bool:
    """Tell whether the node holds the wanted value, or the nearest value that its data type can hold."""
    if image["variables"].get(node, {}).get("data_type") == "Float" and isinstance(wanted, float):
        # Such a node can only hold the nearest number of four bytes.
        wanted = struct.unpack("<f", struct.pack("<f", wanted))[0]
    return same_json(held, wanted)
