"""The abstract operations on Modbus TCP."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(meaning="is the device reachable", outputs=("reachable",), status=True, tells="reachable"),
    "read_input": Operation(
        meaning="read input registers (function 4)",
        inputs=("address", "count"),
        outputs=("values",),
        needed=("values",),
    ),
    "read_holding": Operation(
        meaning="read holding registers (function 3)",
        inputs=("address", "count"),
        outputs=("values",),
        needed=("values",),
    ),
    "write_holding": Operation(
        meaning="write one holding register (function 6 or 16)",
        inputs=("address", "value"),
        outputs=("value",),
        writes=True,
    ),
}
