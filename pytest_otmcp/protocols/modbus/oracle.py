"""Oracles on the journal and the image of a Modbus device."""

from __future__ import annotations

from typing import Any

from ...core.finding import Finding
from ...core.strict_json import same_json
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness
from .entries import as_modbus, describe, points

__all__ = [
    "exactly_one_request",
    "exactly_one_write",
    "exception_sent",
    "image_holds",
    "no_state_changing_request",
    "nothing_changed_by",
    "only_changed",
    "request_count",
    "some_exchange",
]

_WITNESS = Witness(noun="the device", describe=describe)

some_exchange = _WITNESS.answered
exactly_one_request = _WITNESS.exactly_one
request_count = _WITNESS.request_count
no_state_changing_request = _WITNESS.nothing_changed
nothing_changed_by = _WITNESS.nothing_changed_by
only_changed = _WITNESS.only_changed


def exactly_one_write(entries: Entries, table: str, *, address: int, values: list[object]) -> list[Finding]:
    """Expect that exactly one request that may change the device reached it: this write, by a single or multiple function."""
    functions = (6, 16) if table == "holding_registers" else (5, 15)

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        write = as_modbus(entry)
        right = write["function"] in functions and write.get("address") == address
        return None if right and same_json(write.get("values"), values) else ("WR-001", "it saw another write")

    return _WITNESS.exactly_one_write(entries, f"write of {values} to {table} {address}", problem)


def exception_sent(entries: Entries, code: int) -> list[Finding]:
    """Expect that the device answered with this exception code."""
    sent = [as_modbus(entry).get("exception") for entry in entries if entry["kind"] == "response"]
    if code in sent:
        return []
    return [
        Finding(
            code="no_exception",
            message=f"the device should have answered with exception {code:02X}, its answers were {sent or 'none'}",
            requirement="ERR-002",
        )
    ]


def image_holds(image: Image, table: str, address: int, values: list[Any], unit: int = 1) -> list[Finding]:
    """Expect that the device's memory holds these values."""
    return _WITNESS.holds(image, points(table, address, values, unit=unit))
