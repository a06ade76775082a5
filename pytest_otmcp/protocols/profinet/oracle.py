"""Oracles on the journal and the image of a PROFINET IO device."""

from __future__ import annotations

from collections.abc import Callable

from ...core.finding import Finding
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from ..session_oracle import SessionOracle
from .entries import ProfinetEntry, as_profinet, describe

__all__ = [
    "WITNESS",
    "Drives",
    "cleared",
    "has_controller",
    "has_name",
    "holds",
    "inputs_were_read",
    "mac_of",
    "module_in",
    "name_of",
    "named_once",
    "no_state_changing_request",
    "nothing_changed_by",
    "nothing_driven",
    "nothing_driven_by",
    "only_changed",
    "outputs_written_once",
    "reached",
    "record_was_read",
    "record_written_once",
    "refused_with",
    "signalled",
    "some_exchange",
    "station_answered",
    "written",
]

Place = tuple[int, int]
"""Slot and subslot."""

WITNESS = Witness(noun="the device", describe=describe)
_INPUT_DATA = 0x8028
_KEPT = 10

some_exchange = WITNESS.answered
no_state_changing_request = WITNESS.nothing_changed
nothing_changed_by = WITNESS.nothing_changed_by
only_changed = WITNESS.only_changed
holds = WITNESS.holds


def _reads(entry: JournalEntry, place: Place, index: int) -> bool:
    asked = as_profinet(entry)
    where = asked.get("slot"), asked.get("subslot"), asked.get("index")
    return asked.get("service") == "read" and where == (*place, index)


def inputs_were_read(entries: Entries, place: Place) -> list[Finding]:
    """Expect that the device sent the inputs of a subslot: as the record 8028, or in a cyclic frame."""
    key = f"{place[0]}.{place[1]}"
    if any(entry["kind"] == "inputs" and key in as_profinet(entry).get("subslots", {}) for entry in entries):
        return []
    return record_was_read(entries, place, _INPUT_DATA)


def record_was_read(entries: Entries, place: Place, index: int) -> list[Finding]:
    """Expect that the device was asked for a record, and answered."""
    return WITNESS.was_asked(
        entries,
        f"the record {index:X} of the subslot {place[0]}/{place[1]}",
        lambda asked: any(_reads(entry, place, index) for entry in asked),
    )


def reached(entries: Entries, place: Place, index: int = _INPUT_DATA) -> bool:
    """Tell whether a request for a record was sent."""
    return any(_reads(entry, place, index) for entry in requests(entries))


def station_answered(entries: Entries, mac: str) -> list[Finding]:
    """Expect that a station answered an Identify."""
    answers = [as_profinet(entry) for entry in entries if entry["answers"] is not None]
    if any(one.get("service") == "identify" and one.get("mac") == mac for one in answers):
        return []
    return [
        Finding(
            code="no_exchange",
            message=f"the station {mac} should have been asked to identify itself during the call, it was not",
            requirement="RD-004",
            evidence=WITNESS.seen(entries),
        )
    ]


def refused_with(entries: Entries, status: str) -> list[Finding]:
    """Expect that the device refused with this status."""
    sent = [as_profinet(entry)["status"] for entry in entries if "status" in entry]
    if status in sent:
        return []
    return WITNESS.no_refusal(entries, f"the error {status.upper()}", sent, requirement="ERR-002")


def written(entries: Entries) -> list[JournalEntry]:
    """Return the requests that write a record, or send other outputs than the device has, each once."""
    return [
        entry
        for entry in entries
        if entry["state_changing"] and as_profinet(entry).get("service") in ("write", "outputs")
    ]


def outputs_written_once(entries: Entries, place: Place, content: bytes) -> list[Finding]:
    """Expect that exactly one request changed the plant: a cyclic frame with these outputs. What makes the relation comes before it."""
    key = f"{place[0]}.{place[1]}"

    def problem(sent: ProfinetEntry) -> str | None:
        if sent.get("service") != "outputs":
            return "WR-002"
        found = sent.get("subslots", {}).get(key)
        return _difference(found, content, "ADR-001" if content.hex() in sent.get("subslots", {}).values() else None)

    return _once(entries, f"frame with the outputs {content.hex()} of {place[0]}/{place[1]}", problem)


def record_written_once(entries: Entries, place: Place, index: int, content: bytes) -> list[Finding]:
    """Expect that exactly one request changed the plant: the write of this record."""

    def problem(sent: ProfinetEntry) -> str | None:
        if sent.get("service") != "write":
            return "WR-002"
        if (sent.get("slot"), sent.get("subslot"), sent.get("index")) != (*place, index):
            return "ADR-001"
        return _difference(sent.get("data"), content)

    return _once(entries, f"Write of {content.hex()} to {place[0]}/{place[1]}/{index:X}", problem)


def _difference(found: str | None, content: bytes, otherwise: str | None = None) -> str | None:
    if found == content.hex():
        return None
    return "ENC-001" if found == content[::-1].hex() else otherwise or "WR-001"


def _once(entries: Entries, what: str, problem: Callable[[ProfinetEntry], str | None]) -> list[Finding]:
    def told(entry: JournalEntry) -> tuple[str, str] | None:
        requirement = problem(as_profinet(entry))
        return None if requirement is None else (requirement, f"it saw {describe(entry)}")

    return WITNESS.exactly_one_write(entries, what, told)


def _drives(entry: JournalEntry) -> bool:
    """Tell whether only a controller sends this, or who changes a station: outputs, and a relation for them, of whatever values."""
    sent = as_profinet(entry)
    service = sent.get("service")
    return entry["direction"] == "in" and (
        service in ("set", "write") or service == "outputs" or (service == "connect" and bool(sent.get("cyclic")))
    )


def nothing_driven(entries: Entries) -> list[Finding]:
    """Expect that nothing was sent that changes a station, or that only its controller sends."""
    found = [entry for entry in entries if _drives(entry)]
    if not found:
        return []
    shown = "; ".join(describe(entry) for entry in found[:_KEPT])
    message = f"the device should have seen nothing that drives it, it saw {shown}"
    return [Finding(code="driven", message=message, requirement="WR-004")]


class Drives(SessionOracle):
    """What a session sent that changes a station, or that only its controller sends.

    Attributes:
        first: the first few of these requests.
    """

    def __init__(self) -> None:
        self.first: list[JournalEntry] = []

    def feed(self, entry: JournalEntry) -> None:
        """Keep the entry if it is such a request."""
        if len(self.first) < _KEPT and _drives(entry):
            self.first.append(entry)


def nothing_driven_by(session: Drives) -> list[Finding]:
    """Expect that nothing was sent in the whole life of a session that drives the device."""
    return nothing_driven(session.first)


def mac_of(image: Image, name: str) -> str:
    """Return the hardware address of the station with a name."""
    return str(image["stations"][name]["mac"])


def name_of(image: Image, mac: str) -> str:
    """Return the name of the station with a hardware address."""
    return next(str(known) for known, one in image["stations"].items() if one["mac"] == mac)


def module_in(image: Image, slot: int) -> str:
    """Return the identifier of the module in a slot, as hexadecimal digits."""
    return str(image["modules"][str(slot)])


def named_once(entries: Entries, mac: str, name: str) -> list[Finding]:
    """Expect that exactly one request changed the plant: a Set of this name at this station."""

    def problem(sent: ProfinetEntry) -> str | None:
        if sent.get("service") != "set" or sent.get("mac") != mac:
            return "WR-002"
        return None if sent.get("name") == name else "WR-001"

    return _once(entries, f"DCP Set of the name {name}", problem)


def signalled(entries: Entries, mac: str) -> list[Finding]:
    """Expect that a station was asked to show itself, and answered."""
    return WITNESS.was_asked(
        entries,
        f"a Signal of the station {mac}",
        lambda asked: any(
            (as_profinet(entry).get("service"), as_profinet(entry).get("mac")) == ("signal", mac) for entry in asked
        ),
    )


def has_name(image: Image, mac: str, name: str, *, requirement: str = "WR-001") -> list[Finding]:
    """Expect that a station has this name."""
    held = name_of(image, mac)
    if held == name:
        return []
    message = f"the station {mac} should have the name {name!r}, it has {held!r}"
    return [Finding(code="device_differs", message=message, requirement=requirement)]


def has_controller(image: Image) -> list[Finding]:
    """Expect that the device has a controller."""
    if image["controller"]:
        return []
    message = "the device should have a controller that keeps its outputs alive, it has none"
    return [Finding(code="no_controller", message=message, requirement="WR-001")]


def cleared(image: Image, *, requirement: str) -> list[Finding]:
    """Expect that all outputs of the device are zero."""
    held = {name: 0 for name in image["points"] if ".output." in name}
    found = WITNESS.holds(image, held)
    return [Finding(code=one.code, message=one.message, requirement=requirement) for one in found]
