"""The abstract operations on Modbus TCP. Addresses are those of the PDU, from 0."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

_UNIT = ("unit",)

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(meaning="is the device reachable", outputs=("reachable",), status=True, tells="reachable"),
    "read_input": Operation(
        meaning="read input registers (function 4)",
        inputs=("address", "count"),
        outputs=("values",),
        needed=("values",),
        voluntary_inputs=_UNIT,
    ),
    "read_holding": Operation(
        meaning="read holding registers (function 3)",
        inputs=("address", "count"),
        outputs=("values",),
        needed=("values",),
        voluntary_inputs=_UNIT,
    ),
    "write_holding": Operation(
        meaning="write one holding register (function 6 or 16)",
        inputs=("address", "value"),
        outputs=("value",),
        writes=True,
        voluntary_inputs=_UNIT,
    ),
    "read_coils": Operation(
        meaning="read coils (function 1)",
        inputs=("address", "count"),
        outputs=("values",),
        needed=("values",),
        voluntary=True,
        voluntary_inputs=_UNIT,
    ),
    "read_discrete_inputs": Operation(
        meaning="read discrete inputs (function 2)",
        inputs=("address", "count"),
        outputs=("values",),
        needed=("values",),
        voluntary=True,
        voluntary_inputs=_UNIT,
    ),
    "read_typed": Operation(
        meaning="read a number that spans holding registers",
        inputs=("address", "type"),
        outputs=("value",),
        needed=("value",),
        voluntary=True,
        voluntary_inputs=("byte_order", "unit"),
        voluntary_outputs=("special", "raw"),
        requirement="ENC-001",
    ),
    "read_typed_input": Operation(
        meaning="read a number that spans input registers",
        inputs=("address", "type"),
        outputs=("value",),
        needed=("value",),
        voluntary=True,
        voluntary_inputs=("byte_order", "unit"),
        voluntary_outputs=("special", "raw"),
        requirement="ENC-001",
    ),
    "read_device_information": Operation(
        meaning="read the objects of the device's identification (function 2B/0E)",
        outputs=("objects",),
        needed=("objects",),
        voluntary=True,
        voluntary_inputs=_UNIT,
    ),
    "read_tag": Operation(
        meaning="read a tag's engineering value",
        inputs=("name",),
        outputs=("value",),
        needed=("value",),
        voluntary=True,
        voluntary_outputs=("special", "raw"),
    ),
    "write_registers": Operation(
        meaning="write holding registers in one request (function 16)",
        inputs=("address", "values"),
        outputs=("values",),
        writes=True,
        voluntary=True,
        voluntary_inputs=_UNIT,
    ),
    "write_coil": Operation(
        meaning="write one coil (function 5 or 15)",
        inputs=("address", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
        voluntary_inputs=_UNIT,
    ),
    "write_coils": Operation(
        meaning="write coils in one request (function 15)",
        inputs=("address", "values"),
        outputs=("values",),
        writes=True,
        voluntary=True,
        voluntary_inputs=_UNIT,
    ),
    "mask_write": Operation(
        meaning="change bits of one holding register in the device (function 22)",
        inputs=("address", "and_mask", "or_mask"),
        outputs=("and_mask", "or_mask"),
        writes=True,
        voluntary=True,
        voluntary_inputs=_UNIT,
    ),
    "write_tag": Operation(
        meaning="write a tag's engineering value",
        inputs=("name", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
        voluntary_outputs=("raw",),
    ),
}
