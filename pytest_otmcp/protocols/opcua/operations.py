"""The abstract operations on OPC UA."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

OPERATIONS: Mapping[str, Operation] = {
    "read": Operation(
        meaning="read a variable's value", inputs=("node",), outputs=("value", "status"), needed=("value",)
    ),
    "read_many": Operation(
        meaning="read several variables' values, in the order asked for",
        inputs=("nodes",),
        outputs=("values",),
        needed=("values",),
    ),
    "browse": Operation(
        meaning="list the children of a node",
        inputs=("node",),
        outputs=("node_ids", "browse_names"),
        needed=("node_ids",),
        requirement="OUA-006",
    ),
    "write": Operation(
        meaning="write a variable's value",
        inputs=("node", "value"),
        outputs=("value",),
        writes=True,
        requirement="OUA-001",
    ),
    "variables": Operation(
        meaning="enumerate every variable of the plant",
        outputs=("node_ids",),
        needed=("node_ids",),
        requirement="OUA-006",
    ),
}
