"""The abstract operations on EtherCAT. ``slave`` is a position, from 0; process data are lists of numbers from 0 to 255."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

_OBJECT = ("slave", "index", "subindex", "type")

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(
        meaning="is a slave of the line reachable", outputs=("reachable",), status=True, tells="reachable"
    ),
    "read_sdo": Operation(
        meaning="read an object of a slave; `type` is BOOL, UINT8 to UINT64, INT8 to INT64, FLOAT32, FLOAT64 or STRING",
        inputs=_OBJECT,
        outputs=("value",),
        needed=("value",),
        voluntary_outputs=("special",),
    ),
    "write_sdo": Operation(
        meaning="write an object of a slave",
        inputs=(*_OBJECT, "value"),
        outputs=("value",),
        writes=True,
    ),
    "read_inputs": Operation(
        meaning="read the input bytes of a slave, as a list of numbers from 0 to 255",
        inputs=("slave",),
        outputs=("values",),
        needed=("values",),
        voluntary=True,
    ),
    "write_outputs": Operation(
        meaning="write all output bytes of a slave",
        inputs=("slave", "data"),
        outputs=("values",),
        writes=True,
        voluntary=True,
    ),
    "scan_network": Operation(
        meaning="find the slaves of the line",
        outputs=("positions",),
        needed=("positions",),
        voluntary=True,
    ),
    "read_state": Operation(
        meaning="read the state of a slave: INIT, PREOP, SAFEOP or OP",
        inputs=("slave",),
        outputs=("state",),
        needed=("state",),
        voluntary=True,
    ),
    "read_alias": Operation(
        meaning="read a value by a name of the adapter's",
        inputs=("name",),
        outputs=("value",),
        needed=("value",),
        voluntary_outputs=("special",),
        voluntary=True,
    ),
    "write_alias": Operation(
        meaning="write a value by a name of the adapter's",
        inputs=("name", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
    ),
}
