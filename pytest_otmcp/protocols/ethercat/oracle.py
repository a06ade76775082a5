"""Oracles on the journal and the image of an EtherCAT segment."""

from __future__ import annotations

from typing import Any

from pytest_otmcp.wire.ethercat import ADDRESS_OF, READS

from ...core.finding import Finding
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, has, requests
from ..session_oracle import SessionOracle
from .entries import as_ethercat, describe

__all__ = [
    "WITNESS",
    "Drives",
    "answered_by",
    "cleared",
    "drives",
    "has_watchdog",
    "holds",
    "inputs_were_read",
    "no_state_changing_request",
    "nothing_changed_by",
    "nothing_driven",
    "nothing_driven_by",
    "object_was_read",
    "one_write_of_object",
    "one_write_of_outputs",
    "only_changed",
    "refused_with",
    "some_exchange",
    "was_sent",
    "watchdog_s",
]

WITNESS = Witness(noun="the segment", describe=describe)
_KEPT = 10
_READS_ALL = {command for command in READS if ADDRESS_OF.get(command) == "all"}

some_exchange = WITNESS.answered
no_state_changing_request = WITNESS.nothing_changed
nothing_changed_by = WITNESS.nothing_changed_by
only_changed = WITNESS.only_changed
holds = WITNESS.holds


def object_was_read(entries: Entries, *, slave: int, index: int, subindex: int) -> list[Finding]:
    """Expect that a slave was asked for an object, and answered."""
    wanted = {"service": "sdo_upload", "slave": slave, "index": index, "subindex": subindex}
    what = f"the object {index:04X}:{subindex} of slave {slave}"
    return WITNESS.was_asked(entries, what, lambda found: any(has(one, **wanted) for one in found))


def inputs_were_read(entries: Entries, *, slave: int) -> list[Finding]:
    """Expect that a slave sent its inputs: out of its memory, or in a frame with process data."""
    answered = {entry["answers"] for entry in entries}
    for entry in entries:
        asked = as_ethercat(entry)
        own = asked.get("service") == "inputs" and asked.get("slave") == slave
        if entry["seq"] in answered and (own or asked.get("service") == "process_data"):
            return []
    message = f"slave {slave} should have been asked for its inputs during the call, it was not"
    return [Finding(code="no_exchange", message=message, requirement="RD-004", evidence=WITNESS.seen(entries))]


def answered_by(entries: Entries, slave: int) -> list[Finding]:
    """Expect that a slave was asked for anything, by itself or with all others at once, and answered."""
    return WITNESS.was_asked(
        entries,
        f"anything of slave {slave}",
        lambda asked: any(has(one, slave=slave) or as_ethercat(one).get("command") in _READS_ALL for one in asked),
    )


def was_sent(entries: Entries, *, index: int) -> bool:
    """Tell whether a value was sent for an object with this index."""
    return bool(requests(entries, service="sdo_download", index=index))


def refused_with(entries: Entries, abort: int, *, requirement: str = "ERR-002") -> list[Finding]:
    """Expect that a slave aborted a transfer with this code."""
    found = [code for entry in entries if (code := as_ethercat(entry).get("abort")) is not None]
    if abort in found:
        return []
    return WITNESS.no_refusal(entries, f"{abort:08X}", [f"{code:08X}" for code in found], requirement=requirement)


def one_write_of_object(
    entries: Entries, *, slave: int, index: int, subindex: int, data: bytes, is_text: bool = False
) -> list[Finding]:
    """Expect that exactly one request that changes the plant was sent: this value, to this object. A text may be filled up with zeros."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        sent = as_ethercat(entry)
        saw = f"it saw {describe(entry)}"
        if sent.get("service") != "sdo_download":
            return "WR-002", saw
        if (sent.get("slave"), sent["index"], sent["subindex"]) != (slave, index, subindex):
            return "ADR-001", saw
        if sent["data"] == data.hex() or (is_text and bytes.fromhex(sent["data"]).rstrip(b"\0") == data):
            return None
        return ("ENC-001" if sent["data"] == data[::-1].hex() else "WR-001"), saw

    what = f"SDO download of {data.hex()} to {index:04X}:{subindex} of slave {slave}"
    return WITNESS.exactly_one_write(entries, what, problem)


def one_write_of_outputs(entries: Entries, *, slave: int, outputs: bytes) -> list[Finding]:
    """Expect that exactly one frame changed outputs: those of this slave, to these. What takes it to OP comes before it."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        sent = as_ethercat(entry)
        saw = f"it saw {describe(entry)}"
        if sent.get("service") == "sdo_download":
            return "WR-002", saw
        if sent.get("slave") != slave:
            return "ADR-001", saw
        if sent.get("outputs") == outputs.hex():
            return None
        return ("ENC-001" if sent.get("outputs") == outputs[::-1].hex() else "WR-001"), saw

    return WITNESS.exactly_one_write(entries, f"frame with the outputs {outputs.hex()} of slave {slave}", problem)


def drives(entry: JournalEntry) -> bool:
    """Tell whether a request changes the plant, or takes a slave to OP, in which it takes outputs."""
    return entry["state_changing"] or has(entry, kind="request", service="state", state="OP")


def nothing_driven(entries: Entries) -> list[Finding]:
    """Expect that nothing was sent that drives a slave."""
    found = [entry for entry in entries if drives(entry)]
    if not found:
        return []
    message = f"the segment should have seen nothing that drives a slave, it saw {_shown(found)}"
    return [Finding(code="driven", message=message, requirement="WR-004")]


class Drives(SessionOracle):
    """What a session sent that drives a slave.

    Attributes:
        first: the first few of these requests.
    """

    def __init__(self) -> None:
        self.first: list[JournalEntry] = []

    def feed(self, entry: JournalEntry) -> None:
        """Keep the entry if it is such a request."""
        if len(self.first) < _KEPT and drives(entry):
            self.first.append(entry)


def nothing_driven_by(session: Drives) -> list[Finding]:
    """Expect that nothing was sent in the whole life of a session that drives a slave."""
    return nothing_driven(session.first)


def _shown(found: Entries) -> str:
    return "; ".join(describe(entry) for entry in found[:_KEPT])


def _slave(image: Image, slave: int) -> dict[str, Any]:
    found: dict[str, Any] = image["slaves"][slave]
    return found


def watchdog_s(image: Image, slave: int) -> float | None:
    """Return the watchdog of a slave in OP, in seconds; None without one."""
    found: float | None = _slave(image, slave)["watchdog_s"]
    return found


def has_watchdog(image: Image, slave: int) -> list[Finding]:
    """Expect that a slave is in OP, with a watchdog."""
    found = _slave(image, slave)
    if found["watchdog_s"] is not None:
        return []
    message = f"slave {slave} should have a watchdog, it has none and is in the state {found['state']}"
    return [Finding(code="no_watchdog", message=message, requirement="WR-001")]


def cleared(image: Image, slave: int, *, requirement: str) -> list[Finding]:
    """Expect that all outputs of a slave are zero."""
    held = {name: 0 for name in image["points"] if name.startswith(f"{slave}.output.")}
    return [
        Finding(code=found.code, message=found.message, requirement=requirement) for found in WITNESS.holds(image, held)
    ]
