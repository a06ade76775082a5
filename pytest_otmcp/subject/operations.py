"""The abstract operations of the benchmark: what the kit asks for, whatever an adapter calls its tools.

An operation has named inputs (filled into a binding's argument template) and named outputs (read from the result by
a binding's JMESPath expressions).
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["OPERATIONS", "PROTOCOLS", "Operation"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One abstract operation.

    Attributes:
        inputs: names that an argument template may refer to.
        outputs: names that the kit reads from a successful result.
        writes: it changes the state of the plant.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    writes: bool = False


PROTOCOLS = {"modbus": "Modbus", "mqtt": "MQTT", "opcua": "OPC UA"}
"""Protocol key to the family name that tables print."""

OPERATIONS: dict[str, dict[str, Operation]] = {
    "modbus": {
        "ping": Operation(outputs=("reachable",)),
        "read_input": Operation(inputs=("address", "count"), outputs=("values",)),
        "read_holding": Operation(inputs=("address", "count"), outputs=("values",)),
        "write_holding": Operation(inputs=("address", "value"), outputs=("value",), writes=True),
    },
    "mqtt": {
        "info": Operation(outputs=("connected", "endpoint", "client_id")),
        "subscribe": Operation(inputs=("filter", "qos"), outputs=("granted_qos",)),
        "messages": Operation(inputs=("filter",), outputs=("messages",)),
        "publish": Operation(inputs=("topic", "payload", "qos"), outputs=("topic", "delivery"), writes=True),
        "device_birth": Operation(inputs=("device", "metrics"), writes=True),
        "device_data": Operation(inputs=("device", "metrics"), outputs=("metric_count",), writes=True),
    },
    "opcua": {
        "read": Operation(inputs=("node",), outputs=("value", "status")),
        "read_many": Operation(inputs=("nodes",), outputs=("values",)),
        "browse": Operation(inputs=("node",), outputs=("node_ids", "browse_names")),
        "write": Operation(inputs=("node", "value"), outputs=("value",), writes=True),
        "variables": Operation(outputs=("node_ids",)),
    },
}
