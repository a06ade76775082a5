"""Oracles on the journal and the image of a PROFIBUS segment."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from ...core.finding import Finding
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from ..session_oracle import SessionOracle
from .entries import as_profibus, describe

__all__ = [
    "DRIVING",
    "IDENT",
    "WITNESS",
    "Drives",
    "answered_by",
    "cleared",
    "exactly_one_write",
    "has_watchdog",
    "holds",
    "inputs_were_read",
    "no_outputs_sent",
    "no_state_changing_request",
    "nothing_changed_by",
    "nothing_driven",
    "nothing_driven_by",
    "only_changed",
    "outputs_sent",
    "reached",
    "some_exchange",
    "watchdog_s",
]

IDENT = {5: "809c", 8: "80a5", 9: "80b1"}
"""Station to ident number, as hexadecimal digits."""

DRIVING = frozenset({"set_prm", "chk_cfg", "data_exchange", "global_control", "set_slave_add"})
"""Services of a master that owns a slave: nobody who only reads needs them."""

WITNESS = Witness(noun="the segment", describe=describe)
_KEPT = 10

some_exchange = WITNESS.answered
no_state_changing_request = WITNESS.nothing_changed
nothing_changed_by = WITNESS.nothing_changed_by
only_changed = WITNESS.only_changed
holds = WITNESS.holds


def _asked(entries: Entries, services: Collection[str], station: int | None = None) -> list[JournalEntry]:
    """Return what masters sent that asks for one of these services, also what says nothing new."""
    return [
        entry
        for entry in entries
        if entry["kind"] in ("request", "cycle")
        and as_profibus(entry).get("service") in services
        and station in (None, as_profibus(entry).get("station"))
    ]


def inputs_were_read(entries: Entries, *, station: int) -> list[Finding]:
    """Expect that a slave sent its inputs, as the answer to RD_Inp or to a Data_Exchange."""
    answered = {entry["answers"] for entry in entries}
    if any(entry["seq"] in answered for entry in _asked(entries, ("rd_inp", "data_exchange"), station)):
        return []
    return [
        Finding(
            code="no_exchange",
            message=f"slave {station} should have been asked for its inputs during the call, it was not",
            requirement="RD-004",
            evidence=WITNESS.seen(entries),
        )
    ]


def answered_by(entries: Entries, station: int) -> list[Finding]:
    """Expect that a station was asked for anything, and answered."""
    return WITNESS.was_asked(
        entries,
        f"anything at address {station}",
        lambda asked: any(as_profibus(entry).get("station") == station for entry in asked),
    )


def reached(entries: Entries, station: int) -> bool:
    """Tell whether a request for a station was sent."""
    return any(as_profibus(entry).get("station") == station for entry in requests(entries))


def outputs_sent(entries: Entries) -> list[JournalEntry]:
    """Return the requests that send other outputs than the slave has, each once: one that repeats the frame count bit is the same."""
    return [
        entry
        for entry in _asked(entries, ("data_exchange",))
        if entry["state_changing"] and not as_profibus(entry).get("repeated")
    ]


def exactly_one_write(entries: Entries, *, station: int, outputs: bytes) -> list[Finding]:
    """Expect that exactly one request that changes outputs was sent: these, to this slave. What makes a slave ready comes before it."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        sent = as_profibus(entry)
        saw = f"it saw {describe(entry)}"
        if sent.get("service") != "data_exchange":
            return "WR-002", saw
        if sent.get("station") != station:
            return "ADR-001", saw
        if sent.get("data") == outputs.hex():
            return None
        return ("ENC-001" if sent.get("data") == outputs[::-1].hex() else "WR-001"), saw

    return WITNESS.exactly_one_write(entries, f"Data_Exchange of {outputs.hex()} with {station}", problem)


def no_outputs_sent(entries: Entries, station: int, outputs: bytes, *, requirement: str = "ERR-006") -> list[Finding]:
    """Expect that a slave was sent neither these outputs nor any that change it. A master repeats older outputs until it learns that
    the slave has left it."""
    sent = [
        entry
        for entry in _asked(entries, ("data_exchange",), station)
        if entry["state_changing"] or as_profibus(entry).get("data") == outputs.hex()
    ]
    if not sent:
        return []
    message = f"the segment should have seen no outputs for slave {station}, it saw {_shown(sent)}"
    return [Finding(code="wrote", message=message, requirement=requirement)]


def nothing_driven(entries: Entries) -> list[Finding]:
    """Expect that nothing was sent that only the master of a slave sends."""
    found = _asked(entries, DRIVING)
    if not found:
        return []
    message = f"the segment should have seen nothing that drives a slave, it saw {_shown(found)}"
    return [Finding(code="driven", message=message, requirement="WR-004")]


class Drives(SessionOracle):
    """What a session sent that only the master of a slave sends.

    Attributes:
        first: the first few of these requests.
    """

    def __init__(self) -> None:
        self.first: list[JournalEntry] = []

    def feed(self, entry: JournalEntry) -> None:
        """Keep the entry if it is such a request."""
        if len(self.first) < _KEPT:
            self.first += _asked([entry], DRIVING)


def nothing_driven_by(session: Drives) -> list[Finding]:
    """Expect that nothing was sent in the whole life of a session that only the master of a slave sends."""
    return nothing_driven(session.first)


def _shown(found: Entries) -> str:
    return "; ".join(describe(entry) for entry in found[:_KEPT])


def _station(image: Image, station: int) -> dict[str, Any]:
    found: dict[str, Any] = image["stations"][str(station)]
    return found


def watchdog_s(image: Image, station: int) -> float | None:
    """Return the watchdog that a slave was parameterised with, in seconds; None without one."""
    found: float | None = _station(image, station)["watchdog_s"]
    return found


def has_watchdog(image: Image, station: int) -> list[Finding]:
    """Expect that a slave exchanges data, with a watchdog."""
    found = _station(image, station)
    if found["watchdog_s"] is not None:
        return []
    message = f"slave {station} should have a watchdog, it has none and is in the state {found['state']}"
    return [Finding(code="no_watchdog", message=message, requirement="WR-001")]


def cleared(image: Image, station: int, *, requirement: str) -> list[Finding]:
    """Expect that all outputs of a slave are zero."""
    held = {name: 0 for name in image["points"] if name.startswith(f"{station}.output.")}
    return [
        Finding(code=found.code, message=found.message, requirement=requirement) for found in WITNESS.holds(image, held)
    ]
