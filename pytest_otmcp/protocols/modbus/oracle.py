"""Oracles on the journal and the image of a Modbus device."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...core.finding import Finding
from ...core.strict_json import same_json
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from .entries import as_modbus, describe, points

__all__ = [
    "exactly_one_write",
    "exception_sent",
    "image_holds",
    "no_state_changing_request",
    "nothing_changed_by",
    "only_changed",
    "reached",
    "read_from_device",
    "refused_nothing_else",
    "some_exchange",
]

_WITNESS = Witness(noun="the device", describe=describe)

some_exchange = _WITNESS.answered
no_state_changing_request = _WITNESS.nothing_changed
nothing_changed_by = _WITNESS.nothing_changed_by
only_changed = _WITNESS.only_changed


def read_from_device(entries: Entries, *, function: int, address: int, count: int) -> list[Finding]:
    """Expect that the device answered reads by this function that cover these cells, by whatever requests."""
    what = f"{count} cell(s) from {address} by function {function}"
    return _WITNESS.was_asked(entries, what, lambda asked: _covered(asked, function, address, count))


def reached(entries: Entries, *, function: int, address: int, count: int) -> bool:
    """Tell whether requests by this function that cover these cells reached the device."""
    return _covered(requests(entries), function, address, count)


def _covered(asked: Sequence[JournalEntry], function: int, address: int, count: int) -> bool:
    cells: set[int] = set()
    for request in map(as_modbus, asked):
        if request.get("function") == function:
            first = request.get("address", 0)
            cells.update(range(first, first + request.get("quantity", 0)))
    return cells.issuperset(range(address, address + count))


def exactly_one_write(entries: Entries, table: str, *, address: int, values: list[object]) -> list[Finding]:
    """Expect that exactly one request that may change the device reached it: this write, by a single or multiple function."""
    functions = (6, 16) if table == "holding_registers" else (5, 15)

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        write = as_modbus(entry)
        right = write["function"] in functions and write.get("address") == address
        return None if right and same_json(write.get("values"), values) else ("WR-001", "it saw another write")

    return _WITNESS.exactly_one_write(entries, f"write of {values} to {table} {address}", problem)


def refused_nothing_else(entries: Entries, *, function: int, address: int, count: int) -> list[Finding]:
    """Expect that every read that the device refused was of these cells by this function, among others."""
    refused = {entry["answers"] for entry in entries if as_modbus(entry).get("exception")}
    other = [
        entry
        for entry in requests(entries)
        if entry["seq"] in refused and not entry["state_changing"] and not _covered([entry], function, address, count)
    ]
    if not other:
        return []
    return [
        Finding(
            code="refused_other",
            message=f"the device should have refused {count} cell(s) from {address} by function {function}, "
            f"it refused {describe(other[0])}",
            requirement="RD-001",
        )
    ]


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
