"""Oracles on the journal and the image of a DNP3 outstation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...core.finding import Finding
from ...core.strict_json import same_json
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from .entries import DIRECT_OPERATE, GROUPS, OPERATE, SELECT, as_dnp3, changes, commands, describe, objects

__all__ = [
    "LATCH_OFF",
    "LATCH_ON",
    "WITNESS",
    "confirmed",
    "exactly_one_operation",
    "held",
    "holds",
    "named",
    "no_state_changing_request",
    "nothing_changed_by",
    "only_changed",
    "point",
    "polled",
    "reached",
    "read_from_device",
    "refused_with_iin",
    "refused_with_status",
    "selected_first",
    "some_exchange",
    "told_off_line",
]

WITNESS = Witness(noun="the outstation", describe=describe)
LATCH_ON, LATCH_OFF = 0x03, 0x04
"""Control codes."""
_CLASS, _ALL = 60, 0x06
"""Group of the classes, and the qualifier of all points."""
_PLANT = {"binary": 12, "analog": 41}

some_exchange = WITNESS.answered
no_state_changing_request = WITNESS.nothing_changed
nothing_changed_by = WITNESS.nothing_changed_by
only_changed = WITNESS.only_changed
holds = WITNESS.holds


def point(kind: str, index: int) -> str:
    """Return the name of a point in the image, such as ``analog_input/1``."""
    return f"{kind}/{index}"


def held(image: Image, kind: str, index: int) -> object:
    """Return what a point holds."""
    return image["points"].get(point(kind, index))


def _covers(entry: JournalEntry, kind: str, start: int, count: int) -> bool:
    """Tell whether a request reads these points: by their range, their indexes or their class."""
    wanted = set(range(start, start + count))
    for header in objects(entry):
        if (header["group"], header["variation"]) == (_CLASS, 1):
            return True
        if header["group"] != GROUPS[kind]:
            continue
        if header["qualifier"] == _ALL:
            return True
        if "start" in header:
            wanted -= set(range(header["start"], min(header["stop"], start + count) + 1))
        elif header.get("points"):
            wanted -= {one.get("index") for one in header["points"]}
        else:
            wanted -= set(range(header.get("count", 0)))
    return not wanted


def reached(entries: Entries, kind: str, start: int, count: int = 1) -> bool:
    """Tell whether a read of these points reached the outstation."""
    return any(_covers(entry, kind, start, count) for entry in requests(entries, function=1))


def named(entries: Entries, kind: str, start: int, count: int = 1) -> bool:
    """Tell whether a read reached the outstation that names these points by their indexes: a read of a class, or of all points of a kind,
    names none, and its answer has those that there are."""
    return any(
        header["group"] == GROUPS[kind] and header["qualifier"] != _ALL and _covers(entry, kind, start, count)
        for entry in requests(entries, function=1)
        for header in objects(entry)
    )


def read_from_device(entries: Entries, kind: str, start: int, count: int = 1) -> list[Finding]:
    """Expect that the outstation answered a read of these points, by one request or by several, alone or among others."""
    return WITNESS.was_asked(
        entries,
        f"{kind} {start} to {start + count - 1}",
        lambda asked: all(
            any(_covers(entry, kind, index, 1) for entry in asked if as_dnp3(entry).get("function") == 1)
            for index in range(start, start + count)
        ),
    )


def polled(entries: Entries, event_class: int) -> list[Finding]:
    """Expect that the outstation answered a poll of a class."""
    return WITNESS.was_asked(
        entries,
        f"class {event_class}",
        lambda asked: any(
            (header["group"], header["variation"]) == (_CLASS, event_class + 1)
            for entry in asked
            for header in objects(entry)
        ),
    )


def exactly_one_operation(entries: Entries, kind: str, index: int, value: object) -> list[Finding]:
    """Expect that one command reached the outstation: that this output is latched, or set, so. Its selection is a part of it, and so is
    the same request when it is sent again.

    Args:
        kind: ``binary`` or ``analog``.
        value: true or false; of an analog output the number.
    """

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        given = commands(entry)
        if as_dnp3(entry).get("function") not in (OPERATE, DIRECT_OPERATE) or len(given) != 1:
            return "WR-001", f"it saw {describe(entry)}"
        command: Mapping[str, Any] = given[0]
        if command["group"] != _PLANT[kind] or command["index"] != index:
            return "ADR-001", f"it saw {describe(entry)}"
        if kind == "analog":
            return None if same_json(command["value"], value) else ("WR-001", f"it saw the value {command['value']}")
        wanted = LATCH_ON if value else LATCH_OFF
        if command["code"] != wanted or command["count"] != 1:
            return "WR-001", f"it saw the code {command['code']:02X} {command['count']} times"
        return None

    return WITNESS.exactly_one_write(changes(entries), f"operation of {kind} output {index} to {value}", problem)


def selected_first(entries: Entries) -> list[Finding]:
    """Expect that every operation was selected: by the request just before it on its connection, with the same objects and the sequence
    number before."""
    before: dict[int, JournalEntry] = {}
    for entry in requests(entries):
        message, prior = as_dnp3(entry), before.get(entry["connection"])
        before[entry["connection"]] = entry
        function = message.get("function")
        if function not in (OPERATE, DIRECT_OPERATE):
            continue
        chosen = None if prior is None else as_dnp3(prior)
        if function == OPERATE and chosen is not None and chosen.get("apdu") == message["apdu"]:
            continue
        if (
            function == OPERATE
            and chosen is not None
            and chosen.get("function") == SELECT
            and chosen["apdu"][4:] == message["apdu"][4:]
            and (chosen["sequence"] + 1) % 16 == message["sequence"]
        ):
            continue
        return [
            Finding(
                code="not_selected",
                message=f"the outstation should have seen a SELECT of the same objects just before, it saw {describe(entry)} without it",
                requirement="WR-001",
                evidence=WITNESS.seen(entries),
            )
        ]
    return []


def confirmed(entries: Entries) -> list[Finding]:
    """Expect that every response that had to be confirmed was, before the next one of its kind and with its sequence number."""
    due: dict[tuple[int, bool], JournalEntry] = {}
    for entry in entries:
        message = as_dnp3(entry)
        if entry["kind"] in ("response", "unsolicited") and message.get("confirm"):
            due[entry["connection"], entry["kind"] == "unsolicited"] = entry
        elif entry["kind"] == "confirm":
            key = entry["connection"], message["unsolicited"]
            if key in due and as_dnp3(due[key])["sequence"] == message["sequence"]:
                del due[key]
    return [
        Finding(
            code="not_confirmed",
            message=f"the outstation should have got a confirmation of its {entry['kind']} with the sequence number "
            f"{as_dnp3(entry)['sequence']}, it got none",
            requirement="RD-001",
        )
        for entry in due.values()
    ]


def refused_with_iin(entries: Entries, bit: int) -> list[Finding]:
    """Expect that the outstation answered with this internal indication."""
    sent = [as_dnp3(entry).get("iin", 0) for entry in entries if entry["kind"] == "response"]
    if any(iin & bit for iin in sent):
        return []
    shown = [f"{iin:04X}" for iin in sent]
    return WITNESS.no_refusal(entries, f"the internal indication {bit:04X}", shown, requirement="ERR-002")


def refused_with_status(entries: Entries, status: int) -> list[Finding]:
    """Expect that the outstation answered a command with this status."""
    sent = [one["status"] for entry in entries if entry["kind"] == "response" for one in commands(entry)]
    if status in sent:
        return []
    return WITNESS.no_refusal(entries, f"the status {status}", [str(one) for one in sent], requirement="ERR-002")


def told_off_line(flags: object, label: str) -> list[Finding]:
    """Expect that the flags of one point, which is off line, are told: lists of names, without ONLINE among them."""
    if isinstance(flags, list) and len(flags) == 1 and isinstance(flags[0], list) and "ONLINE" not in flags[0]:
        return []
    return [
        Finding(
            code="quality_lost",
            message=f"{label}: the point is off line, and the reply tells its value with success and the flags {flags!r}",
            requirement="RD-001",
        )
    ]
