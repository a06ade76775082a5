"""Journal entries and points of a BACnet device. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

from ..journal import Entries, JournalEntry

__all__ = [
    "ALL",
    "PRESENT_VALUE",
    "PRIORITY_ARRAY",
    "BacnetEntry",
    "Target",
    "as_bacnet",
    "carried_out",
    "changes",
    "describe",
    "label",
    "property_name",
    "title",
]

Target = tuple[str, int]
"""An object: its type as the standard writes it, and its instance number."""

PRESENT_VALUE, PRIORITY_ARRAY = 85, 87
ALL = 8
"""The property identifier that stands for all properties of an object."""

_TYPES = {
    0: "analog-input",
    1: "analog-output",
    2: "analog-value",
    3: "binary-input",
    4: "binary-output",
    5: "binary-value",
    8: "device",
    13: "multi-state-input",
    14: "multi-state-output",
    17: "schedule",
    19: "multi-state-value",
    40: "characterstring-value",
    45: "integer-value",
    46: "large-analog-value",
    48: "positive-integer-value",
}
_PROPERTIES = {
    8: "all",
    75: "object-identifier",
    76: "object-list",
    77: "object-name",
    79: "object-type",
    81: "out-of-service",
    85: "present-value",
    87: "priority-array",
    104: "relinquish-default",
    111: "status-flags",
    112: "system-status",
}
_CONFIRMED = {
    0: "acknowledge alarm",
    5: "subscribe COV",
    7: "atomic write file",
    8: "add list element",
    9: "remove list element",
    10: "create object",
    11: "delete object",
    12: "read property",
    14: "read property multiple",
    15: "write property",
    16: "write property multiple",
    17: "device communication control",
    20: "reinitialize device",
    27: "life safety operation",
}
_UNCONFIRMED = {
    0: "I-Am",
    1: "I-Have",
    6: "time synchronization",
    7: "Who-Has",
    8: "Who-Is",
    9: "UTC time synchronization",
    10: "write group",
    12: "you-are",
}
_ACKS = {2: "simple ack", 3: "complex ack", 5: "error", 6: "reject", 7: "abort"}


class BacnetEntry(JournalEntry, total=False):
    """An entry of a BACnet device; members that the message does not have are absent.

    Members:
        pdu_type: type of the APDU, 0 for a confirmed and 1 for an unconfirmed request.
        service: number of the service, confirmed or unconfirmed by ``pdu_type``.
        invoke_id: of a confirmed request and its answer; a client that sends a request again keeps it.
        reads: references that a request reads: ``object`` (type and instance), ``property``, ``index``.
        writes: references that a request writes, with ``values`` (type and value) and ``priority``.
        results: references that an answer has, with ``values`` or ``error``.
        error: error class and code of an answer.
        reject, abort: reason of an answer.
        low, high: bounds of a Who-Is.
        device: instance of the device that an I-Am or I-Have is from.
        bytes: the datagram in hexadecimal digits.
    """

    pdu_type: int
    service: int
    invoke_id: int
    reads: list[dict[str, Any]]
    writes: list[dict[str, Any]]
    results: list[dict[str, Any]]
    error: list[int]
    reject: int
    abort: int
    low: int
    high: int
    device: int
    bytes: str


def as_bacnet(entry: JournalEntry) -> BacnetEntry:
    """Return an entry of a BACnet device's journal with its own type."""
    return cast(BacnetEntry, entry)


def label(target: Sequence[int]) -> str:
    """Return an object identifier, type and instance, as points have it, such as ``analog-input,1``."""
    return f"{_TYPES.get(target[0], target[0])},{target[1]}"


def property_name(number: int) -> str:
    """Return the name of a property; its number where the kit has no name."""
    return _PROPERTIES.get(number, str(number))


def _service(entry: BacnetEntry) -> str | None:
    names = _UNCONFIRMED if entry.get("pdu_type") == 1 else _CONFIRMED
    return names.get(entry["service"], f"service {entry['service']}") if "service" in entry else None


def title(entry: JournalEntry) -> str:
    """Return the title of an entry: its kind and its service."""
    message = as_bacnet(entry)
    ack = _ACKS.get(message.get("pdu_type", -1))
    parts = [part for part in (ack, _service(message)) if part]
    return f"{entry['kind']}: {' to '.join(parts)}" if parts else entry["kind"]


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    message = as_bacnet(entry)
    if entry["kind"] != "request":
        return entry["kind"]
    text = _service(message) or "request"
    for one in message.get("reads", []):
        text += f" {label(one['object'])} {property_name(one['property'])}"
    for one in message.get("writes", []):
        values = ", ".join(str(value["value"]) for value in one["values"])
        priority = f" at priority {one['priority']}" if "priority" in one else ""
        text += f" {label(one['object'])} {property_name(one['property'])} = {values}{priority}"
    return text


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether the device did what a request asked for: it acknowledged it. Nobody answers unconfirmed services."""
    if as_bacnet(request).get("pdu_type") == 1:
        return True
    return None if answer is None else as_bacnet(answer).get("pdu_type") in (2, 3)


def changes(entries: Entries) -> list[JournalEntry]:
    """Return the requests that may change the plant, each once: a client that misses an answer sends the request again with the same
    invoke id (clause 5.4), which is the same request."""
    found: dict[object, JournalEntry] = {}
    for entry in entries:
        if entry["state_changing"]:
            message = as_bacnet(entry)
            same = (entry["connection"], message["invoke_id"], message["bytes"]) if "invoke_id" in message else None
            found.setdefault(same or entry["seq"], entry)
    return list(found.values())
