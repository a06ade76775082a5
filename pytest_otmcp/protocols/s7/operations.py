"""The abstract operations on S7. Offsets are in bytes, from 0; ``type`` is INT, DINT, REAL, BOOL, …; numbers are big-endian."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(meaning="is the controller reachable", outputs=("reachable",), status=True, tells="reachable"),
    "read_db": Operation(
        meaning="read bytes of a data block, as a list of numbers from 0 to 255",
        inputs=("db", "start", "size"),
        outputs=("values",),
        needed=("values",),
    ),
    "read_typed": Operation(
        meaning="read one value of a data block",
        inputs=("db", "start", "type"),
        outputs=("value",),
        needed=("value",),
        voluntary_outputs=("special",),
    ),
    "write_db": Operation(
        meaning="write one value to a data block",
        inputs=("db", "start", "type", "value"),
        outputs=("value",),
        writes=True,
    ),
    "write_marker": Operation(
        meaning="write one bit of the flags (bit memory)",
        inputs=("byte", "bit", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
        requirement="WR-011",
    ),
    "read_cpu_state": Operation(
        meaning="read whether the CPU is in RUN or in STOP",
        outputs=("state",),
        needed=("state",),
        voluntary=True,
    ),
    "set_cpu_state": Operation(
        meaning="start the CPU's program, or stop it",
        inputs=("state",),
        outputs=("state",),
        writes=True,
        controls=True,
        voluntary=True,
    ),
}
