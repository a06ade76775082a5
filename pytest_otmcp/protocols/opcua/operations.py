"""The abstract operations on OPC UA."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

OPERATIONS: Mapping[str, Operation] = {
    "read": Operation(
        meaning="read a variable's value",
        inputs=("node",),
        outputs=("value", "status"),
        needed=("value",),
        voluntary_outputs=("data_type", "quality", "source_timestamp", "server_timestamp", "special"),
    ),
    "read_many": Operation(
        meaning="read several variables' values, in the order asked for",
        inputs=("nodes",),
        outputs=("values",),
        needed=("values",),
        voluntary_outputs=("statuses", "data_types"),
    ),
    "browse": Operation(
        meaning="list the children of a node",
        inputs=("node",),
        outputs=("node_ids", "browse_names"),
        needed=("node_ids",),
        requirement="OUA-006",
        voluntary_outputs=("truncated",),
    ),
    "write": Operation(
        meaning="write a variable's value",
        inputs=("node", "value"),
        outputs=("value",),
        writes=True,
        requirement="OUA-001",
        voluntary_outputs=("status", "clamped", "verified"),
    ),
    "variables": Operation(
        meaning="enumerate every variable of the plant",
        outputs=("node_ids",),
        needed=("node_ids",),
        requirement="OUA-006",
        voluntary_outputs=("truncated",),
    ),
    "write_many": Operation(
        meaning="write several variables' values; each of items has node_id and value",
        inputs=("items",),
        outputs=("statuses",),
        writes=True,
        voluntary=True,
        requirement="OUA-001",
    ),
    "call_method": Operation(
        meaning="call a method of an object with its input arguments",
        inputs=("object", "method", "arguments"),
        outputs=("outputs", "status"),
        writes=True,
        voluntary=True,
        voluntary_outputs=("data_types",),
        requirement="OUA-008",
    ),
}
