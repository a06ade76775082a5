"""Oracles on the journal and the image of a Modbus device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ...core.error_registry import wire_codes
from ...core.finding import Finding
from ...core.strict_json import same_json
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from .entries import as_modbus, describe, points

__all__ = [
    "asked_of_unit",
    "codes_of_refusals",
    "exactly_one_mask_write",
    "exactly_one_write",
    "held",
    "holds",
    "identified",
    "image_holds",
    "in_one_request",
    "no_state_changing_request",
    "nothing_changed_by",
    "only_changed",
    "reached",
    "read_from_device",
    "read_where_asked",
    "refused_nothing_else",
    "refused_with",
    "some_exchange",
    "stored_otherwise",
    "torn",
    "values_sent",
    "within_limits",
]

_WITNESS = Witness(noun="the device", describe=describe)
_READS = (1, 2, 3, 4)
_MOST = {1: 2000, 2: 2000, 3: 125, 4: 125}
"""Reads to the number of bits or registers that one may ask for."""
_MASK_WRITE, _IDENTIFICATION = 22, 43

some_exchange = _WITNESS.answered
no_state_changing_request = _WITNESS.nothing_changed
nothing_changed_by = _WITNESS.nothing_changed_by
only_changed = _WITNESS.only_changed
holds = _WITNESS.holds


def read_from_device(entries: Entries, *, function: int, address: int, count: int) -> list[Finding]:
    """Expect that the device answered reads by this function that cover these cells, by whatever requests."""
    what = f"{count} cell(s) from {address} by function {function}"
    findings = _WITNESS.was_asked(entries, what, lambda asked: _covered(asked, function, address, count))
    requirement = _misdirected(entries, function, address)
    return [replace(finding, requirement=requirement or finding.requirement) for finding in findings]


def read_where_asked(entries: Entries, *, function: int, address: int) -> list[Finding]:
    """Expect that no read went to another cell, or another table, instead of this one."""
    requirement = _misdirected(entries, function, address)
    if requirement is None:
        return []
    return [
        Finding(
            code="read_elsewhere",
            message=f"the device should have seen a read of address {address} with function {function}, it saw others",
            requirement=requirement,
            evidence=_WITNESS.seen(entries),
        )
    ]


def _misdirected(entries: Entries, function: int, address: int) -> str | None:
    """Return the requirement that reads break which should have gone to this cell and went elsewhere; None without any."""
    reads = [read for read in requests(entries) if as_modbus(read).get("function") in _READS]
    if any(_covered([read], function, address, 1) for read in reads):
        return None
    if any(_covered([read], other, address, 1) for read in reads for other in _READS):
        return "RD-002"
    return "ADR-001" if any(as_modbus(read)["function"] == function for read in reads) else None


def reached(entries: Entries, *, function: int, address: int, count: int) -> bool:
    """Tell whether requests by this function that cover these cells reached the device."""
    return _covered(requests(entries), function, address, count)


def asked_of_unit(entries: Entries, unit: int) -> list[Finding]:
    """Expect that a request to this unit reached the device."""
    asked = [as_modbus(entry).get("unit") for entry in requests(entries)]
    if unit in asked:
        return []
    message = f"the device should have seen a request to unit {unit}, it saw requests to {asked or 'none'}"
    return [Finding(code="read_elsewhere", message=message, requirement="RD-003", evidence=_WITNESS.seen(entries))]


def within_limits(entries: Entries) -> list[Finding]:
    """Expect that each read asks for at least one value, and for no more than one request may."""
    for request in map(as_modbus, requests(entries)):
        limit, quantity = _MOST.get(request["function"]), request.get("quantity", 1)
        if limit is not None and not 1 <= quantity <= limit:
            message = (
                f"a read by function {request['function']} should ask for 1 to {limit} values, one asked for {quantity}"
            )
            shown = _WITNESS.seen([request])
            return [Finding(code="over_limit", message=message, requirement="RD-007", evidence=shown)]
    return []


def torn(what: str) -> Finding:
    """Return the finding about a value that several requests have read, in these words."""
    return Finding(code="torn_value", message=what, requirement="RD-007")


def in_one_request(entries: Entries, *, function: int, address: int, count: int) -> bool:
    """Tell whether one request by this function covers these cells."""
    return any(_covered([request], function, address, count) for request in requests(entries))


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
        written, at = write.get("values"), write.get("address")
        if write["function"] not in functions:
            return "WR-001", f"it saw {describe(entry)}"
        if same_json(written, values):
            return None if at == address else ("ADR-001", f"it saw the same write to {at}")
        requirement = "ENC-001" if at == address and _swapped(written, values) else "WR-001"
        return requirement, f"it saw a write of {written} to {at}"

    return _WITNESS.exactly_one_write(entries, f"write of {values} to {table} {address}", problem)


def exactly_one_mask_write(entries: Entries, address: int, *, and_mask: int, or_mask: int) -> list[Finding]:
    """Expect that exactly one request that may change the device reached it: this mask write, by the device's own function."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        write = as_modbus(entry)
        if write["function"] != _MASK_WRITE:
            return "WR-001", f"it saw {describe(entry)}"
        if (write.get("and_mask"), write.get("or_mask")) != (and_mask, or_mask):
            return "WR-001", f"it saw the masks {write.get('and_mask')} and {write.get('or_mask')}"
        return None if write.get("address") == address else ("ADR-001", f"it saw one of {write.get('address')}")

    what = f"mask write of holding_registers {address} with the masks {and_mask} and {or_mask}"
    return _WITNESS.exactly_one_write(entries, what, problem)


def identified(entries: Entries) -> list[Finding]:
    """Expect that the device was asked for its identification during the call, and answered."""
    asked = "its identification by function 43"
    return _WITNESS.was_asked(
        entries, asked, lambda seen: any(as_modbus(entry).get("function") == _IDENTIFICATION for entry in seen)
    )


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
            requirement=_misdirected(other, function, address) or "RD-001",
        )
    ]


def _swapped(found: object, wanted: list[object]) -> bool:
    """Tell whether these are the wanted registers, each with its bytes in the other order."""
    words = [value for value in wanted if isinstance(value, int)]
    return found == [(word & 0xFF) << 8 | word >> 8 for word in words]


def stored_otherwise(
    image: Image, table: str, address: int, asked: float, *, told: object, requirement: str = "ADR-003"
) -> list[Finding]:
    """Return the finding about a value that the register cannot hold, although its write was told as a success."""
    name = f"{table.removesuffix('s').replace('_', ' ')} {address}"
    claim = "success" if told is None else f"that it wrote {told}"
    return [
        Finding(
            code="not_refused",
            message=f"asked to write {asked}; the adapter said {claim}; {name} holds {held(image, table, address)}",
            requirement=requirement,
        )
    ]


def held(image: Image, table: str, address: int, unit: int = 1) -> object:
    """Return the value that a cell of the device holds."""
    (point,) = points(table, address, [None], unit=unit)
    return image["points"].get(point)


def values_sent(entries: Entries) -> list[int]:
    """Return the registers or bits that the device sent, in the order of its answers."""
    return [value for entry in entries if entry["kind"] == "response" for value in as_modbus(entry).get("values", [])]


def refused_with(entries: Entries, code: int) -> list[Finding]:
    """Expect that the device answered with this exception code."""
    answers = (as_modbus(entry) for entry in entries if entry["kind"] == "response")
    sent = [exception for answer in answers if (exception := answer.get("exception")) is not None]
    if code in sent:
        return []
    shown = [f"{exception:02X}" for exception in sent]
    return _WITNESS.no_refusal(entries, f"exception {code:02X}", shown, requirement="ERR-002")


def codes_of_refusals(entries: Entries) -> tuple[str, ...]:
    """Return the error codes that the exceptions which the device answered with stand for; a quantity that it refuses is its 3."""
    answers = (as_modbus(entry) for entry in entries if entry["kind"] == "response")
    known = wire_codes(__package__)
    sent = {str(exception) for answer in answers if (exception := answer.get("exception")) is not None}
    return tuple(code for exception in sorted(sent & known.keys()) for code in known[exception].codes)


def image_holds(image: Image, table: str, address: int, values: list[Any], unit: int = 1) -> list[Finding]:
    """Expect that the device's memory holds these values."""
    return _WITNESS.holds(image, points(table, address, values, unit=unit))
