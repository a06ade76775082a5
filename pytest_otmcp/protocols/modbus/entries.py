"""Journal entries and points of a Modbus device (MODBUS Application Protocol V1.1b3, section 6)."""

from __future__ import annotations

from typing import cast

from ..journal import JournalEntry

__all__ = ["ModbusEntry", "as_modbus", "carried_out", "describe", "points", "title"]

_FUNCTIONS = {
    1: "read coils",
    2: "read discrete inputs",
    3: "read holding registers",
    4: "read input registers",
    5: "write single coil",
    6: "write single register",
    15: "write multiple coils",
    16: "write multiple registers",
    22: "mask write register",
    23: "read/write multiple registers",
}
"""Names of the functions, as in section 6 of the specification."""


class ModbusEntry(JournalEntry, total=False):
    """An entry of the kind ``request`` or ``response``; members that the PDU does not have are absent.

    Members:
        unit: unit identifier.
        transaction_id: of the MBAP header.
        function: function code, without the bit that marks an exception.
        address, quantity: first address, from 0 as in the PDU, and number of registers or bits.
        values: registers or bits written by a request, or read by a response.
        and_mask, or_mask: of a mask write.
        exception: exception code of a response, or None.
        pdu: function code and data in hexadecimal digits.
    """

    unit: int
    transaction_id: int
    function: int
    address: int
    quantity: int
    values: list[int] | list[bool]
    and_mask: int
    or_mask: int
    exception: int | None
    pdu: str


def as_modbus(entry: JournalEntry) -> ModbusEntry:
    """Return an entry of a Modbus device's journal with its own type."""
    return cast(ModbusEntry, entry)


def title(entry: JournalEntry) -> str:
    """Return the title of an entry: its kind and, where it has one, its function."""
    function = _FUNCTIONS.get(as_modbus(entry).get("function", 0))
    return entry["kind"] if function is None else f"{entry['kind']}: {function}"


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    if entry["kind"] != "request":
        return entry["kind"]
    request = as_modbus(entry)
    text = f"FC {request['function']:02d} address {request.get('address')} quantity {request.get('quantity')}"
    return text + (f" values {request['values']}" if request.get("values") else "")


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether the device did what a request asked for: it did not answer with an exception."""
    return None if answer is None else as_modbus(answer).get("exception") is None


def points(table: str, address: int, values: list[object], *, unit: int = 1) -> dict[str, object]:
    """Return the points of an image that hold these values, one after the other from ``address``.

    Args:
        table: ``holding_registers``, ``input_registers``, ``coils`` or ``discrete_inputs``.
        address: of the first cell, from 0 as in the PDU.
    """
    return {f"{unit}/{table}/{address + index}": value for index, value in enumerate(values)}
