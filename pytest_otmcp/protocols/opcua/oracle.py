"""What an OPC UA server witnesses.

Journal kinds are service names (OPC 10000-4); requests list their ``nodes``, answers their ``results``. The image lists
the plant's data variables by node id, its folders by browse name.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from ...core.finding import Finding
from ...core.strict_json import same_json

__all__ = [
    "accepted_writes",
    "browsed",
    "children_of",
    "complete_enumeration",
    "describe",
    "exactly_one_service",
    "exactly_one_write",
    "folder_id",
    "image_holds",
    "names_and_ids_agree",
    "no_service",
    "no_state_changing_service",
    "only_changed",
    "read_from_device",
    "result_status",
    "service_count",
    "some_service",
]

Entries = Sequence[Mapping[str, Any]]
Image = Mapping[str, Any]

# What keeps a session alive is no sign that anything was asked of the plant.
_SESSION_SERVICES = frozenset(
    {"CONNECTED", "DISCONNECTED", "Hello", "OpenSecureChannel", "CloseSecureChannel", "FindServers", "GetEndpoints"}
    | {"CreateSession", "ActivateSession", "CloseSession", "CreateSubscription", "Publish", "DeleteSubscriptions"}
)


def _requests(entries: Entries, kind: str | None = None) -> list[Mapping[str, Any]]:
    return [
        entry
        for entry in entries
        if entry["direction"] == "in" and entry["kind"] not in _SESSION_SERVICES and kind in (None, entry["kind"])
    ]


def _nodes(entry: Mapping[str, Any]) -> list[str]:
    return [node["node_id"] if isinstance(node, Mapping) else node for node in entry.get("nodes", [])]


def _values_read(entry: Mapping[str, Any]) -> list[str]:
    return [node["node_id"] for node in entry.get("nodes", []) if node["attribute"] == "Value"]


def _statuses(entry: Mapping[str, Any]) -> list[str]:
    results = entry.get("results", [])
    return [str(result["status"] if isinstance(result, Mapping) else result) for result in results]


def describe(entry: Mapping[str, Any]) -> str:
    """Describe a service request in a few words."""
    return f"{entry['kind']} {', '.join(_nodes(entry)[:4])}".strip()


def _seen(entries: Entries) -> str:
    services = [describe(entry) for entry in _requests(entries)]
    return "; ".join(services[:8]) + (" …" if len(services) > 8 else "") if services else "no service request"


def folder_id(image: Image, name: str) -> str:
    """Node id of a folder of the plant."""
    return str(image["folders"][name])


def children_of(image: Image, name: str) -> dict[str, str]:
    """Browse name to node id of the data variables in a folder."""
    parent = folder_id(image, name)
    return {
        variable["browse_name"]: node for node, variable in image["variables"].items() if variable["parent"] == parent
    }


def names_and_ids_agree(ids: Any, names: Any, expected: Mapping[str, str]) -> list[Finding]:
    """A browse result holds these nodes, each with its own name; a namespace prefix of a name (``2:``) is accepted.

    An adapter whose answers have no names gives None for them, and is judged by the nodes alone.
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
    """The server was asked to browse this node during the call."""
    if any(node in _nodes(entry) for entry in _requests(entries, "Browse")):
        return []
    return [_missing(f"a Browse of {node}", entries)]


def some_service(entries: Entries) -> list[Finding]:
    """The server was asked something during the call."""
    return [] if _requests(entries) else [_missing("a service request", entries)]


def read_from_device(entries: Entries, node: str | None, at_least: int = 1) -> list[Finding]:
    """The value of ``node`` was read from the server at least that often.

    Args:
        node: node id; None for any node of the plant (those of namespace 0 are the server's own: a client that
            watches the server's state does not read the plant).
    """
    read = [found for entry in _requests(entries, "Read") for found in _values_read(entry)]
    count = sum(found == node or (node is None and found.startswith("ns=")) for found in read)
    if count >= at_least:
        return []
    return [_missing(f"{at_least} read(s) of {node or 'a value'}, there were {count}", entries)]


def _missing(what: str, entries: Entries) -> Finding:
    return Finding(
        code="no_exchange",
        message=f"the server should have seen {what}",
        requirement="RD-004",
        evidence=_seen(entries),
    )


def exactly_one_service(entries: Entries, kind: str, *, node: str) -> list[Finding]:
    """Exactly one request of this service named the node."""
    count = sum(node in _nodes(entry) for entry in _requests(entries, kind))
    if count == 1:
        return []
    return [
        Finding(
            code="request_count",
            message=f"the server should have seen one {kind} of {node}, it saw {count}",
            requirement="ENV-005",
            evidence=_seen(entries),
        )
    ]


def service_count(entries: Entries) -> dict[str, int]:
    """How often each service was called, session keeping left out; a bound that no machine's speed changes."""
    counts: dict[str, int] = {}
    for entry in _requests(entries):
        counts[entry["kind"]] = counts.get(entry["kind"], 0) + 1
    return counts


def no_service(entries: Entries, *kinds: str) -> list[Finding]:
    """None of these services was called."""
    called = [entry for kind in kinds for entry in _requests(entries, kind)]
    if not called:
        return []
    return [
        Finding(
            code="unexpected_service",
            message=f"the server should have seen no {' and no '.join(kinds)}, it saw {len(called)}",
            requirement="ERR-006",
            evidence=_seen(called),
        )
    ]


def result_status(entries: Entries, kind: str, symbol: str) -> list[Finding]:
    """The server answered a request of this service with this status code, for an item or as a whole."""
    found: list[str] = []
    for entry in entries:
        if entry["direction"] == "out" and entry["kind"] == kind:
            found += _statuses(entry)
            if entry.get("service_result") not in (None, "Good"):
                found.append(str(entry["service_result"]))
    if symbol in found:
        return []
    return [
        Finding(
            code="no_status",
            message=f"the server should have answered {kind} with {symbol}, its answers were {found or 'none'}",
            requirement="ERR-003",
        )
    ]


def exactly_one_write(entries: Entries, node: str, value: Any) -> list[Finding]:
    """One Write reached the server, of this value to this node and of nothing but the value, and was accepted."""
    changing = [entry for entry in _requests(entries) if entry.get("state_changing")]
    requirement = "WR-003" if len(changing) > 1 else "WR-001"
    problem = f"it saw {len(changing)} state-changing request(s)"
    if len(changing) == 1 and changing[0]["kind"] == "Write":
        items = changing[0].get("nodes", [])
        written = [[item["node_id"], item["attribute"], item["value"]] for item in items]
        refused = [status for entry in _answers(entries, "Write") for status in _statuses(entry) if status != "Good"]
        if not same_json(written, [[node, "Value", value]]):
            problem = f"it saw {written}"
        elif items[0].get("has_status") or items[0].get("has_timestamp"):
            # OPC 10000-4, section 5.11.4.1: servers may refuse to have status or timestamps written.
            what = " and ".join(name for name in ("status", "timestamp") if items[0].get(f"has_{name}"))
            requirement, problem = "OUA-005", f"a {what} was written with it"
        elif refused and not refused[0].startswith("Good"):
            problem = f"the server refused it with {refused[0]}"
        else:
            return []
    return [
        Finding(
            code="not_written_once",
            message=f"the server should have seen one Write of {value!r} to {node}, {problem}",
            requirement=requirement,
            evidence=_seen(entries),
        )
    ]


def _answers(entries: Entries, kind: str) -> list[Mapping[str, Any]]:
    return [entry for entry in entries if entry["direction"] == "out" and entry["kind"] == kind]


def no_state_changing_service(entries: Entries) -> list[Finding]:
    """Nothing that could change the plant reached the server."""
    changing = [entry for entry in _requests(entries) if entry.get("state_changing")]
    if not changing:
        return []
    return [
        Finding(
            code="wrote",
            message=f"the server should have seen no state-changing request, it saw {len(changing)}",
            requirement="WR-004",
            evidence=_seen(changing),
        )
    ]


def accepted_writes(entries: Entries, count: int) -> list[Finding]:
    """The server accepted a value from so many Writes; it may have refused others."""
    accepted = [
        entry for entry in _answers(entries, "Write") if any(status.startswith("Good") for status in _statuses(entry))
    ]
    if len(accepted) == count:
        return []
    return [
        Finding(
            code="wrote",
            message=f"the server should have accepted {count} Write(s), it accepted {len(accepted)}",
            requirement="WR-004",
            evidence=_seen(entries),
        )
    ]


def image_holds(image: Image, node: str, value: Any) -> list[Finding]:
    """The server holds this value."""
    variable = image["variables"].get(node)
    if variable is not None and _holds(variable, value):
        return []
    held = "has no such node" if variable is None else f"holds {variable['value']!r}"
    return [
        Finding(
            code="device_differs",
            message=f"{node} should hold {value!r}, the server {held}",
            requirement="WR-001",
        )
    ]


def _holds(variable: Mapping[str, Any], value: Any) -> bool:
    if variable.get("data_type") == "Float" and isinstance(value, float):
        # The nearest number of four bytes is all that such a node can hold.
        value = struct.unpack("<f", struct.pack("<f", value))[0]
    return same_json(variable["value"], value)


def only_changed(before: Image, after: Image, expected: Mapping[str, Any]) -> list[Finding]:
    """Between two images these nodes got these values; every other variable is as it was, and none is gone."""
    findings = []
    for node in before["variables"].keys() | after["variables"].keys():
        old, new = before["variables"].get(node), after["variables"].get(node)
        wanted = expected[node] if node in expected else None if old is None else old["value"]
        if new is not None and _holds(new, wanted):
            continue
        held = "is gone" if new is None else f"holds {new['value']!r} on the server"
        findings.append(
            Finding(
                code="device_differs",
                message=f"{node} should hold {wanted!r}, it {held}",
                requirement="WR-001" if node in expected else "WR-002",
            )
        )
    return sorted(findings, key=lambda finding: finding.message)[:5]


def complete_enumeration(ids: Any, image: Image) -> list[Finding]:
    """An enumeration lists every data variable of the plant, each once."""
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
