"""Oracles on the journal and the image of an OPC UA server.

Journal kinds are service names (OPC 10000-4); requests list their ``nodes``, answers their ``results``. The image lists
the plant's data variables by node id, its folders by browse name.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from ...core.finding import Finding
from ...core.strict_json import same_json
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from .entries import answers, as_opcua, describe, holds_value, node_ids, statuses, values_asked

__all__ = [
    "accepted_writes",
    "browsed",
    "called_with",
    "children_of",
    "complete_enumeration",
    "exactly_one_call",
    "exactly_one_write",
    "folder_id",
    "held",
    "holds",
    "image_holds",
    "listed_once",
    "names_and_ids_agree",
    "no_state_changing_service",
    "nothing_changed_by",
    "only_changed",
    "open_points",
    "performed",
    "points_left",
    "reached",
    "read_from_device",
    "refused_with",
    "some_service",
    "written_as",
    "written_together",
    "written_with",
]

_WITNESS = Witness(noun="the server", describe=describe, holds_value=holds_value)

no_state_changing_service = _WITNESS.nothing_changed
nothing_changed_by = _WITNESS.nothing_changed_by
only_changed = _WITNESS.only_changed
holds = _WITNESS.holds


def folder_id(image: Image, name: str) -> str:
    """Return the node id of a folder of the plant."""
    return str(image["folders"][name])


def children_of(image: Image, name: str) -> dict[str, str]:
    """Return the data variables in a folder: browse name to node id."""
    parent = folder_id(image, name)
    return {
        variable["browse_name"]: node for node, variable in image["variables"].items() if variable["parent"] == parent
    }


def names_and_ids_agree(ids: object, names: object, expected: Mapping[str, str]) -> list[Finding]:
    """Expect that a browse result holds these nodes, each with its own name; a namespace prefix of a name (``2:``) is accepted.

    For an adapter whose answers have no names, ``names`` is None, and only the nodes are judged.
    """
    pairs: dict[str, str] = {}
    if names is None and isinstance(ids, list):
        pairs = {name: node for name, node in expected.items() if node in ids}
    if isinstance(ids, list) and isinstance(names, list) and len(ids) == len(names):
        pairs = {str(name).rpartition(":")[2]: str(node) for node, name in zip(ids, names, strict=True)}
    wrong = {name: (node, pairs.get(name)) for name, node in expected.items() if pairs.get(name) != node}
    if not wrong:
        return []
    name, (node, found) = next(iter(wrong.items()))
    return [
        Finding(
            code="browse_differs",
            message=f"{len(wrong)} of {len(expected)} nodes are missing or wrong; {name} should be {node}, it is {found}",
            requirement="OUA-006",
        )
    ]


def browsed(entries: Entries, node: str) -> list[Finding]:
    """Expect that the server was asked to browse this node during the call."""
    if any(node in node_ids(entry) for entry in requests(entries, kind="Browse")):
        return []
    return [_missing(f"a Browse of {node}", entries)]


def some_service(entries: Entries) -> list[Finding]:
    """Expect that the server received a service request during the call."""
    return [] if requests(entries) else [_missing("a service request", entries)]


def read_from_device(entries: Entries, node: str) -> list[Finding]:
    """Expect that the server was asked for the value of ``node``, or sent it as a notification."""
    if any(node in values_asked(entry) for entry in entries):
        return []
    return [_missing(f"a read of {node} during the call", entries)]


def _missing(what: str, entries: Entries) -> Finding:
    return Finding(
        code="no_exchange",
        message=f"the server should have seen {what}",
        requirement="RD-004",
        evidence=_WITNESS.seen(entries),
    )


def reached(entries: Entries, node: str) -> bool:
    """Tell whether a request that names the node reached the server."""
    return any(node in node_ids(entry) for entry in requests(entries))


def refused_with(entries: Entries, node: str, symbol: str) -> list[Finding]:
    """Expect that the server answered a request that names the node with this status code, for an item or as a whole."""
    asked = {entry["seq"] for entry in requests(entries) if node in node_ids(entry)}
    found = [code for entry in entries if entry["answers"] in asked for code in _codes(entry)]
    if symbol in found:
        return []
    return _WITNESS.no_refusal(entries, f"{symbol} for {node}", found, requirement="ERR-003")


def _codes(entry: JournalEntry) -> list[str]:
    result = as_opcua(entry).get("service_result")
    return [*statuses(entry), *([str(result)] if result not in (None, "Good") else [])]


def exactly_one_write(entries: Entries, node: str, value: object) -> list[Finding]:
    """Expect that exactly one Write reached the server and was accepted: of this value, and nothing else, to this node."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        write = as_opcua(entry)
        items = write.get("nodes", [])
        written = [[item["node_id"], item["attribute"], item.get("value")] for item in items]
        refused = [status for answer in answers(entries, "Write") for status in statuses(answer) if status != "Good"]
        if write["kind"] == "Write" and "BadTypeMismatch" in refused:
            # The value and its type are in one Variant: a Boolean that was sent as a number is no other value.
            sent = f"{items[0].get('value')!r} as {items[0].get('variant_type')}" if items else "nothing"
            return "OUA-001", f"the adapter sent {sent}, which is not the node's data type"
        if write["kind"] != "Write" or not same_json(written, [[node, "Value", value]]):
            return "WR-001", f"it saw {write['kind']} {written}"
        if items[0].get("has_status"):
            # OPC 10000-4, section 5.11.4.1: servers may refuse to have a status written.
            return "OUA-005", "a status was written with it"
        if refused and not refused[0].startswith("Good"):
            return "WR-001", f"the server refused it with {refused[0]}"
        return None

    return [
        *_WITNESS.exactly_one_write(entries, f"Write of {value!r} to {node}", problem),
        *_timestamps_written(entries),
    ]


def written_together(entries: Entries, values: Mapping[str, object]) -> list[Finding]:
    """Expect that exactly one Write reached the server and was accepted: of these values, by node id, and nothing else."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        items = as_opcua(entry).get("nodes", [])
        refused = [status for answer in answers(entries, "Write") for status in statuses(answer)]
        written = {item["node_id"]: item.get("value") for item in items} if entry["kind"] == "Write" else {}
        whole = len(items) == len(written) and all(item["attribute"] == "Value" for item in items)
        if not whole or not same_json(written, dict(values)):
            return "WR-001", f"it saw {entry['kind']} {written}"
        bad = [status for status in refused if not status.startswith("Good")]
        return ("WR-001", f"the server refused a part of it with {bad[0]}") if bad else None

    return [
        *_WITNESS.exactly_one_write(entries, f"Write of {len(values)} values together", problem),
        *_timestamps_written(entries),
    ]


def exactly_one_call(entries: Entries, owner: str, method: str, arguments: Sequence[object]) -> list[Finding]:
    """Expect that exactly one Call reached the server and was accepted: of this method of this object, with these arguments."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        called = [[one["object_id"], one["method_id"], one["arguments"]] for one in as_opcua(entry).get("methods", [])]
        if entry["kind"] != "Call" or not same_json(called, [[owner, method, list(arguments)]]):
            return "WR-001", f"it saw {entry['kind']} {called or ''}".rstrip()
        bad = [status for reply in answers(entries, "Call") for status in statuses(reply) if status.startswith("Bad")]
        return ("WR-001", f"the server refused it with {bad[0]}") if bad else None

    return _WITNESS.exactly_one_write(entries, f"Call of {method} with {list(arguments)}", problem)


def called_with(entries: Entries, kinds: Sequence[str]) -> list[Finding]:
    """Expect that every method that the server was asked to perform got arguments of these built-in types."""
    types = [called["types"] for entry in requests(entries, kind="Call") for called in as_opcua(entry)["methods"]]
    return [
        Finding(
            code="wrong_type",
            message=f"the server should have got arguments of the types {', '.join(kinds)}, it got {', '.join(found)}",
            requirement="OUA-008",
        )
        for found in types
        if list(found) != list(kinds)
    ]


def performed(image: Image, method: str) -> int:
    """Return how often the server has performed a method.

    Raises:
        KeyError: it has no such method.
    """
    return int(image["methods"][method]["calls"])


def _timestamps_written(entries: Entries) -> list[Finding]:
    # OPC 10000-4, section 5.11.4.1: a client may write them, a server may refuse the value then.
    items = [item for entry in requests(entries, kind="Write") for item in as_opcua(entry).get("nodes", [])]
    return [
        Finding(
            code="timestamp_written",
            message=f"the value of {item['node_id']} should be written alone, a timestamp was written with it",
            requirement="OUA-005",
            strength="SHOULD",
        )
        for item in items
        if item.get("has_timestamp")
    ]


def written_as(
    entries: Entries, node: str, kind: str, value: object, *, same: Callable[[object, Any], bool]
) -> list[Finding]:
    """Expect that the server was asked to write this value to the node, as a Variant of its own built-in type.

    Args:
        same: tells whether what was written is the value.
    """
    items = [item for entry in requests(entries, kind="Write") for item in as_opcua(entry)["nodes"]]
    written = [(item.get("value"), item["variant_type"]) for item in items if item["node_id"] == node]
    if any(found == kind and same(held, value) for held, found in written):
        return []
    shown = ", ".join(f"{held!r} as {found}" for held, found in written)
    return [
        Finding(
            code="device_differs" if kind in (found for _, found in written) else "wrong_type",
            message=f"the server should have seen a Write of {value!r} to {node} as {kind}, it saw {shown or 'none'}",
            requirement="OUA-001",
            evidence=_WITNESS.seen(entries),
        )
    ]


def written_with(entries: Entries) -> list[Finding]:
    """Expect that values are written alone: a status is a fault; a timestamp, which a server may refuse, is a warning."""
    items = [item for entry in requests(entries, kind="Write") for item in as_opcua(entry).get("nodes", [])]
    statuses_written = [
        Finding(
            code="status_written",
            message=f"the value of {item['node_id']} should be written alone, a status was written with it",
            requirement="OUA-005",
        )
        for item in items
        if item.get("has_status")
    ]
    return [*statuses_written, *_timestamps_written(entries)]


def open_points(entries: Entries) -> int:
    """Return how many continuation points the session had open when the server sent its last answer."""
    pages = [entry for entry in entries if entry["direction"] == "out" and entry["kind"] in ("Browse", "BrowseNext")]
    return as_opcua(pages[-1]).get("open_points", 0) if pages else 0


def points_left(entries: Entries, *, before: int = 0) -> list[Finding]:
    """Expect that the session has no further continuation point open when the server has sent its last answer.

    Args:
        before: how many were open before these entries.
    """
    left = open_points(entries) - before
    if left <= 0:
        return []
    return [
        Finding(
            code="points_left",
            message=f"every continuation point should be used up or released, {left} were left open",
            requirement="OUA-006",
            evidence=_WITNESS.seen(entries),
        )
    ]


def accepted_writes(entries: Entries, count: int, *, requirement: str) -> list[Finding]:
    """Expect that the server accepted a value from so many Writes; it may have refused others.

    Args:
        requirement: id of the requirement that another number breaks.
    """
    accepted = [
        entry for entry in answers(entries, "Write") if any(status.startswith("Good") for status in statuses(entry))
    ]
    if len(accepted) == count:
        return []
    return [
        Finding(
            code="wrote",
            message=f"the server should have accepted {count} Write(s), it accepted {len(accepted)}",
            requirement=requirement,
            evidence=_WITNESS.seen(entries),
        )
    ]


def held(image: Image, node: str) -> object:
    """Return the value that the node holds at the server."""
    return image["points"].get(node)


def image_holds(image: Image, node: str, value: Any) -> list[Finding]:
    """Expect that the node holds this value at the server."""
    return _WITNESS.holds(image, {node: value})


def complete_enumeration(ids: object, image: Image) -> list[Finding]:
    """Expect that an enumeration lists every data variable of the plant, each once."""
    listed = [str(node) for node in ids] if isinstance(ids, list) else []
    missing = sorted(set(image["variables"]) - set(listed))
    twice = sorted({node for node in listed if listed.count(node) > 1})
    if not missing and not twice:
        return []
    problem = f"{len(missing)} missing, for instance {missing[0]}" if missing else f"{twice[0]} is listed twice"
    return [
        Finding(
            code="enumeration_differs",
            message=f"all {len(image['variables'])} variables should be listed once: {problem}",
            requirement="OUA-006",
        )
    ]


def listed_once(ids: object, wanted: Collection[str], *, part: bool) -> list[Finding]:
    """Expect that a list has each of these nodes, once.

    Args:
        part: the answer says that it is a part; then nodes may be missing.
    """
    listed = [str(node) for node in ids] if isinstance(ids, list) else []
    missing = [] if part else sorted(set(wanted) - set(listed))
    twice = len(listed) - len(set(listed))
    if not missing and not twice:
        return []
    problem = f"{len(missing)} are missing, for instance {missing[0]}" if missing else f"{twice} are listed again"
    return [
        Finding(
            code="browse_differs",
            message=f"{len(wanted)} nodes should be listed once, or the answer should say that it is a part; {problem}",
            requirement="OUA-006",
        )
    ]
