"""The abstract operations on BACnet/IP. Objects are named by type, as the standard writes it, and instance."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

_OBJECT = ("device", "type", "instance")

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(meaning="is the device reachable", outputs=("reachable",), status=True, tells="reachable"),
    "read": Operation(
        meaning="read the present value of an object",
        inputs=_OBJECT,
        outputs=("value",),
        needed=("value",),
        voluntary_outputs=("data_type", "special"),
    ),
    "write": Operation(
        meaning="write the present value of an object at a priority; null relinquishes it",
        inputs=(*_OBJECT, "value", "priority"),
        outputs=("value",),
        writes=True,
        optional=("priority",),
    ),
    "discover": Operation(meaning="find devices by Who-Is", outputs=("devices",), needed=("devices",), voluntary=True),
    "list_objects": Operation(
        meaning="list the objects of a device",
        inputs=("device",),
        outputs=("types", "instances"),
        needed=("types", "instances"),
        voluntary=True,
    ),
    "read_alias": Operation(
        meaning="read a property by a name of the adapter's own",
        inputs=("name",),
        outputs=("value",),
        needed=("value",),
        voluntary=True,
    ),
    "write_alias": Operation(
        meaning="write a property by a name of the adapter's own",
        inputs=("name", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
    ),
}
