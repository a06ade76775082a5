"""Oracles on the journal and the image of a BACnet device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ...core.finding import Finding
from ...core.strict_json import same_json
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from .entries import ALL, PRESENT_VALUE, Target, as_bacnet, changes, describe, label

__all__ = [
    "WITNESS",
    "array",
    "exactly_one_write",
    "held",
    "holds",
    "invented",
    "no_state_changing_request",
    "not_effective",
    "nothing_changed_by",
    "only_changed",
    "present",
    "reached",
    "read_from_device",
    "refused_with",
    "slot",
    "some_exchange",
]

WITNESS = Witness(noun="the device", describe=describe)

some_exchange = WITNESS.answered
no_state_changing_request = WITNESS.nothing_changed
nothing_changed_by = WITNESS.nothing_changed_by
only_changed = WITNESS.only_changed
holds = WITNESS.holds


def present(target: Target) -> str:
    """Return the point of an object's present value."""
    return f"{target[0]},{target[1]}/present-value"


def slot(target: Target, priority: int) -> str:
    """Return the point of a slot of an object's priority array."""
    return f"{target[0]},{target[1]}/priority-array/{priority}"


def array(image: Image, target: Target) -> Sequence[object]:
    """Return the priority array of an object, priority 1 first."""
    return [image["points"][slot(target, priority)] for priority in range(1, 17)]


def held(image: Image, target: Target) -> object:
    """Return the present value that an object has."""
    return image["points"].get(present(target))


def _asks_for(entry: JournalEntry, target: Target) -> bool:
    return any(
        label(one["object"]) == f"{target[0]},{target[1]}" and one["property"] in (PRESENT_VALUE, ALL)
        for one in as_bacnet(entry).get("reads", [])
    )


def reached(entries: Entries, target: Target) -> bool:
    """Tell whether a request for the present value of this object reached the device."""
    return any(_asks_for(entry, target) for entry in requests(entries))


def read_from_device(entries: Entries, target: Target) -> list[Finding]:
    """Expect that the device answered a read of the present value of this object, alone or among others."""
    return WITNESS.was_asked(
        entries, f"{target[0]},{target[1]}", lambda asked: any(_asks_for(entry, target) for entry in asked)
    )


def exactly_one_write(
    entries: Entries, target: Target, kind: str, value: object, *, priority: int | None = None
) -> list[Finding]:
    """Expect that one request that may change the device reached it: this write of the present value. A request that was sent again with
    its own invoke id is the same request.

    Args:
        kind: datatype of the value: the tag is a part of what was asked for.
        priority: that the request names; None where any will do.
    """
    name = f"{target[0]},{target[1]}"

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        writes = as_bacnet(entry).get("writes", [])
        if len(writes) != 1:
            return "WR-001", f"it saw {describe(entry)}"
        write = writes[0]
        if label(write["object"]) != name or write["property"] != PRESENT_VALUE:
            return "ADR-001", f"it saw {describe(entry)}"
        if priority is not None and write.get("priority") != priority:
            return "WR-001", f"it saw priority {write.get('priority')}"
        values: Sequence[Mapping[str, object]] = write["values"]
        if len(values) != 1 or values[0]["type"] != kind:
            return "ENC-001", f"it saw the datatypes {[one['type'] for one in values]}"
        return None if same_json(values[0]["value"], value) else ("WR-001", f"it saw the value {values[0]['value']}")

    return WITNESS.exactly_one_write(changes(entries), f"write of {value} ({kind}) to {name}", problem)


def refused_with(entries: Entries, error_class: int, error_code: int) -> list[Finding]:
    """Expect that the device answered with this error: for the request, or for a property of a ReadPropertyMultiple."""
    answers = [as_bacnet(entry) for entry in entries if entry["kind"] == "response"]
    # The answer to a ReadPropertyMultiple is an acknowledgement that has the errors among its results (clause 15.7).
    sent = [error for one in answers for part in (one, *one.get("results", ())) if (error := part.get("error"))]
    if [error_class, error_code] in sent:
        return []
    shown = [f"{one},{code}" for one, code in sent]
    return WITNESS.no_refusal(entries, f"the error {error_class},{error_code}", shown, requirement="ERR-002")


def not_effective(told: object, before: object, label: str) -> Finding:
    """Return the finding about a write that was told as a success although a higher priority keeps the present value.

    Args:
        told: the value that the reply says is in effect; None where it says none.
    """
    said = "success, and not which value is in effect" if told is None else f"{told!r} with success"
    return Finding(
        code="not_effective",
        message=f"{label}: the device acknowledged the write, a higher priority keeps {before!r}, and the reply says {said}",
        requirement="WR-001",
    )


def invented(devices: object, known: int) -> list[Finding]:
    """Expect that this device alone was found."""
    if isinstance(devices, list) and devices == [known]:
        return []
    return [
        Finding(
            code="other_devices",
            message=f"the device {known} alone answers a Who-Is, the reply says {devices!r}",
            requirement="RD-001",
        )
    ]
