"""What a Modbus device witnesses.

Journal kinds: ``request`` and ``response``, with function, address, quantity, values and exception as decoded from the
PDU (MODBUS Application Protocol V1.1b3, section 6). Images: unit to table to cells.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...core.finding import Finding
from ...core.strict_json import same_json

__all__ = [
    "describe",
    "exactly_one_request",
    "exactly_one_write",
    "exception_sent",
    "image_holds",
    "no_state_changing_request",
    "only_changed",
    "request_count",
    "some_exchange",
]

Entries = Sequence[Mapping[str, Any]]
Image = Mapping[str, Any]


def _requests(entries: Entries, **fields: Any) -> list[Mapping[str, Any]]:
    return [
        entry
        for entry in entries
        if entry["kind"] == "request" and all(entry.get(name) == value for name, value in fields.items())
    ]


def describe(entry: Mapping[str, Any]) -> str:
    """Describe a journal entry in a few words; its function by its name where it has one."""
    if entry["kind"] != "request":
        return str(entry["kind"])
    text = f"FC {entry['function']:02d} address {entry.get('address')} quantity {entry.get('quantity')}"
    return text + (f" values {entry['values']}" if entry.get("values") else "")


def _seen(entries: Entries) -> str:
    requests = [describe(entry) for entry in _requests(entries)]
    return "; ".join(requests[:8]) + (" …" if len(requests) > 8 else "") if requests else "no request"


def some_exchange(entries: Entries) -> list[Finding]:
    """At least one request reached the device and was answered."""
    asked: set[tuple[Any, ...]] = set()
    for entry in entries:
        key = (entry["connection"], entry.get("unit"), entry.get("transaction_id"))
        if entry["kind"] == "request":
            asked.add(key)
        elif entry["kind"] == "response" and key in asked:
            return []
    return [
        Finding(
            code="no_exchange",
            message="the device should have seen an exchange during the call, it saw "
            + ("requests that got no answer" if asked else "none"),
            requirement="RD-004",
            evidence=_seen(entries),
        )
    ]


def exactly_one_request(entries: Entries, **fields: Any) -> list[Finding]:
    """Exactly one request with these fields reached the device."""
    return request_count(entries, count=1, **fields)


def request_count(entries: Entries, *, count: int, **fields: Any) -> list[Finding]:
    """``count`` requests with these fields reached the device."""
    found = len(_requests(entries, **fields))
    if found == count:
        return []
    wanted = ", ".join(f"{name} {value}" for name, value in fields.items())
    return [
        Finding(
            code="request_count",
            message=f"the device should have seen {count} request(s) with {wanted}, it saw {found}",
            requirement="ENV-005",
            evidence=_seen(entries),
        )
    ]


def exactly_one_write(entries: Entries, table: str, *, address: int, values: list[Any]) -> list[Finding]:
    """One state-changing request reached the device, and it was this one: whichever function code it used."""
    functions = (6, 16) if table == "holding_registers" else (5, 15)
    writes = [entry for entry in entries if entry["kind"] == "request" and entry.get("state_changing")]
    if len(writes) == 1 and writes[0]["function"] in functions:
        if writes[0].get("address") == address and same_json(writes[0].get("values"), values):
            return []
        problem = "it saw another write"
    else:
        problem = f"it saw {len(writes)}"
    return [
        Finding(
            code="not_written_once",
            message=f"the device should have seen one write of {values} to {table} {address}, {problem}",
            requirement="WR-003" if len(writes) > 1 else "WR-001",
            evidence=_seen(entries),
        )
    ]


def no_state_changing_request(entries: Entries) -> list[Finding]:
    """Nothing that could change the plant reached the device."""
    writes = [entry for entry in entries if entry["kind"] == "request" and entry.get("state_changing")]
    if not writes:
        return []
    return [
        Finding(
            code="wrote",
            message=f"the device should have seen no write, it saw {len(writes)}",
            requirement="WR-004",
            evidence=_seen(writes),
        )
    ]


def exception_sent(entries: Entries, code: int) -> list[Finding]:
    """The device answered with this exception code."""
    sent = [entry.get("exception") for entry in entries if entry["kind"] == "response"]
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
    """The device's memory holds these values."""
    held = image["units"].get(str(unit), {}).get(table, [])[address : address + len(values)]
    if same_json(held, values):
        return []
    return [
        Finding(
            code="device_differs",
            message=f"{table} {address} of the device should hold {values}, it holds {held}",
            requirement="WR-001",
        )
    ]


def only_changed(before: Image, after: Image, expected: Mapping[tuple[str, str, int], Any]) -> list[Finding]:
    """Between two images the cells ``(unit, table, address)`` got these values; every other one is as it was."""
    findings = []
    old, new = _cells(before), _cells(after)
    for cell in sorted(old.keys() | new.keys()):
        wanted, held = expected.get(cell, old.get(cell)), new.get(cell)
        if not same_json(held, wanted):
            unit, table, address = cell
            findings.append(
                Finding(
                    code="device_differs",
                    message=f"unit {unit} {table} {address} should hold {wanted}, the device holds {held}",
                    requirement="WR-001" if cell in expected else "WR-002",
                )
            )
    return findings[:5]


def _cells(image: Image) -> dict[tuple[str, str, int], Any]:
    return {
        (unit, table, address): value
        for unit, tables in image["units"].items()
        for table, cells in tables.items()
        for address, value in enumerate(cells)
    }
