"""The places of the mock Modbus device that hold one value: a cell of a table, or a number in several registers of unit 1."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

from ..journal import Image
from ..point import BOOL, UINT16, Kind, Point
from ..proof import Call
from .entries import points
from .registers import FORMATS, ORDERS, registers

__all__ = ["PLACES"]

_CELLS = {
    "read_coils": ("coils", 1, BOOL),
    "read_discrete_inputs": ("discrete_inputs", 2, BOOL),
    "read_holding": ("holding_registers", 3, UINT16),
    "read_input": ("input_registers", 4, UINT16),
}
"""Operation to table, function and type."""
_NUMBERS = {"read_typed": ("holding_registers", 3), "read_typed_input": ("input_registers", 4)}
_SIZE = 100
"""Cells of a table of the mock."""

Place = Callable[[Mapping[str, Any]], Point | None]


def _cell(operation: str) -> Place:
    table, function, kind = _CELLS[operation]

    def place(inputs: Mapping[str, Any]) -> Point | None:
        address = inputs["address"]
        if inputs["count"] != 1 or not _is_there(inputs, address, 1):
            return None
        return Point(
            kind=kind,
            reading=Call(operation, inputs),
            pokes=lambda value: ({"unit": 1, "table": table, "address": address, "values": [value]},),
            held=lambda value: points(table, address, [value]),
            found=lambda image: image["points"][f"1/{table}/{address}"],
            output="values",
            listed=True,
            condition={"function": function},
        )

    return place


def _number(operation: str) -> Place:
    table, function = _NUMBERS[operation]

    def place(inputs: Mapping[str, Any]) -> Point | None:
        address, kind, order = inputs["address"], inputs["type"], inputs.get("byte_order", "ABCD")
        if not isinstance(kind, str) or kind not in FORMATS or order not in ORDERS:
            return None
        form = FORMATS[kind]
        count = struct.calcsize(form) // 2
        if not _is_there(inputs, address, count):
            return None

        def words(value: Any) -> list[int]:
            return registers(value, kind, order)

        def found(image: Image) -> object:
            held = [image["points"][f"1/{table}/{address + index}"] for index in range(count)]
            # To bring registers and bytes into an order and back is the same.
            as_if: float = struct.unpack(form, struct.pack(f">{count}H", *held))[0]
            value: object = struct.unpack(form, struct.pack(f">{count}H", *registers(as_if, kind, order)))[0]
            return value

        return Point(
            kind=Kind(form[1:]),
            reading=Call(operation, inputs),
            pokes=lambda value: ({"unit": 1, "table": table, "address": address, "values": words(value)},),
            held=lambda value: points(table, address, [*words(value)]),
            found=found,
            condition={"function": function},
        )

    return place


def _is_there(inputs: Mapping[str, Any], address: object, count: int) -> bool:
    if not isinstance(address, int) or isinstance(address, bool):
        return False
    return inputs.get("unit", 1) == 1 and 0 <= address <= _SIZE - count


PLACES: Mapping[str, Place] = {**{name: _cell(name) for name in _CELLS}, **{name: _number(name) for name in _NUMBERS}}
