"""The abstract operations on DNP3. Outstations are named by link address, points by index, from 0."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

_RANGE = ("outstation", "start", "count")

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(meaning="is the outstation reachable", outputs=("reachable",), status=True, tells="reachable"),
    "read_binary": Operation(
        meaning="read binary inputs, as a list of true and false; events are those that the outstation told unasked meanwhile",
        inputs=_RANGE,
        outputs=("values",),
        needed=("values",),
        voluntary_outputs=("flags", "events"),
    ),
    "read_analog": Operation(
        meaning="read analog inputs, as a list of numbers; events are those that the outstation told unasked meanwhile",
        inputs=_RANGE,
        outputs=("values",),
        needed=("values",),
        voluntary_outputs=("flags", "events"),
    ),
    "write_binary": Operation(
        meaning="latch a binary output on or off; control: another code, which fits the value, and count and times of a pulse",
        inputs=("outstation", "index", "value"),
        outputs=("value",),
        writes=True,
        voluntary_inputs=("control", "count", "on_time_ms", "off_time_ms"),
        voluntary_outputs=("status",),
    ),
    "poll": Operation(
        meaning="poll a class: 0 for every point, 1 to 3 for events; each event has type, index and value",
        inputs=("outstation", "event_class"),
        outputs=("events",),
        needed=("events",),
        voluntary=True,
    ),
    "read_alias": Operation(
        meaning="read a point by a name of the adapter's own",
        inputs=("name",),
        outputs=("value",),
        needed=("value",),
        voluntary=True,
        voluntary_outputs=("special",),
    ),
    "write_alias": Operation(
        meaning="operate or write a point by a name of the adapter's own",
        inputs=("name", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
    ),
}
