"""The abstract operations on PROFIBUS DP. ``slave`` is a station address; data are lists of numbers from 0 to 255."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(
        meaning="is a slave of the line reachable", outputs=("reachable",), status=True, tells="reachable"
    ),
    "read_inputs": Operation(
        meaning="read the input bytes of a slave, as a list of numbers from 0 to 255",
        inputs=("slave",),
        outputs=("values",),
        needed=("values",),
    ),
    "write_outputs": Operation(
        meaning="write all output bytes of a slave",
        inputs=("slave", "data"),
        outputs=("values",),
        writes=True,
    ),
    "scan_bus": Operation(
        meaning="find the stations of the line",
        outputs=("addresses",),
        needed=("addresses",),
        voluntary=True,
    ),
    "read_diagnosis": Operation(
        meaning="read the diagnosis of a slave",
        inputs=("slave",),
        outputs=("states",),
        needed=("states",),
        voluntary=True,
    ),
    "read_alias": Operation(
        meaning="read a value of a slave's data by a name of the adapter's",
        inputs=("name",),
        outputs=("value",),
        needed=("value",),
        voluntary_outputs=("special",),
        voluntary=True,
    ),
    "write_alias": Operation(
        meaning="write a value of a slave's outputs by a name of the adapter's",
        inputs=("name", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
    ),
}
