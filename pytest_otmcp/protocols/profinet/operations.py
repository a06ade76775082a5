"""The abstract operations on PROFINET IO. ``station`` is the name of a station; data are lists of numbers from 0 to 255."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(
        meaning="is a station of the network reachable", outputs=("reachable",), status=True, tells="reachable"
    ),
    "read_inputs": Operation(
        meaning="read the inputs of a subslot, as a list of numbers from 0 to 255",
        inputs=("station", "slot", "subslot"),
        outputs=("values",),
        needed=("values",),
    ),
    "write_outputs": Operation(
        meaning="write all outputs of a subslot, and keep them",
        inputs=("station", "slot", "subslot", "data"),
        outputs=("values",),
        writes=True,
    ),
    "read_record": Operation(
        meaning="read a record, as a list of numbers from 0 to 255",
        inputs=("station", "slot", "subslot", "index"),
        outputs=("values",),
        needed=("values",),
        voluntary=True,
    ),
    "write_record": Operation(
        meaning="write a whole record",
        inputs=("station", "slot", "subslot", "index", "data"),
        outputs=("values",),
        writes=True,
        voluntary=True,
    ),
    "discover": Operation(
        meaning="find the stations of the network",
        outputs=("names",),
        needed=("names",),
        voluntary=True,
    ),
    "identify": Operation(
        meaning="let a station show itself, by a blinking light, for some seconds",
        inputs=("mac", "seconds"),
        voluntary=True,
    ),
    "set_name": Operation(
        meaning="give a station a name",
        inputs=("mac", "name"),
        outputs=("name",),
        writes=True,
        voluntary=True,
    ),
    "read_alias": Operation(
        meaning="read a value of a station by a name of the adapter's",
        inputs=("name",),
        outputs=("value",),
        needed=("value",),
        voluntary_outputs=("special",),
        voluntary=True,
    ),
    "write_alias": Operation(
        meaning="write a value of a station by a name of the adapter's",
        inputs=("name", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
    ),
}
