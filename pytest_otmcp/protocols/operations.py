"""The abstract operations of the benchmark: what the kit asks for, whatever an adapter calls its tools.

An operation has named inputs (filled into a binding's argument template) and named outputs (read from the answer by
a binding's rules). Operations are also the *facets* that a subject claims; two more are no operation of their own.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

__all__ = ["GUARD", "OPERATIONS", "PROTOCOLS", "RECEIVE", "RECOVERY", "Operation", "behind", "facets"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One abstract operation.

    Attributes:
        meaning: one sentence for whoever writes a binding.
        inputs: names that an argument template may refer to.
        outputs: names that the kit judges in a successful answer, when the binding says where they are.
        needed: those of the outputs without which nothing could be judged.
        writes: it changes the state of the plant.
        optional: inputs that a tool may lack; each is a facet of its own, such as ``subscribe.qos``.
    """

    meaning: str
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    writes: bool = False
    optional: tuple[str, ...] = ()


PROTOCOLS = {"modbus": "Modbus", "mqtt": "MQTT", "opcua": "OPC UA"}
"""Protocol key to the family name that tables print."""

GUARD = "guard"
"""Facet: there is a way to launch the adapter in which it refuses every write (the variant ``ro``)."""

RECOVERY = "recovery"
"""Facet: after an outage of the endpoint the same session works again."""

OPERATIONS: dict[str, dict[str, Operation]] = {
    "modbus": {
        "ping": Operation(meaning="is the device reachable", outputs=("reachable",)),
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
    },
    "mqtt": {
        "info": Operation(meaning="is the broker reachable", outputs=("connected", "endpoint", "client_id")),
        "subscribe": Operation(
            meaning="subscribe to a topic filter",
            inputs=("filter", "qos"),
            outputs=("granted_qos",),
            optional=("qos",),
        ),
        "messages": Operation(
            meaning="messages received so far on a topic filter, each with topic and payload",
            inputs=("filter", "seconds"),
            outputs=("messages",),
            needed=("messages",),
            optional=("filter",),
        ),
        "publish": Operation(
            meaning="publish a text payload",
            inputs=("topic", "payload", "qos"),
            outputs=("topic", "delivery"),
            writes=True,
            optional=("qos",),
        ),
        "device_birth": Operation(
            meaning="announce a Sparkplug B device with its metrics (DBIRTH)",
            inputs=("device", "metrics"),
            writes=True,
        ),
        "device_data": Operation(
            meaning="report metrics of a Sparkplug B device (DDATA)",
            inputs=("device", "metrics"),
            outputs=("metric_count",),
            writes=True,
        ),
    },
    "opcua": {
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
        ),
        "write": Operation(
            meaning="write a variable's value", inputs=("node", "value"), outputs=("value",), writes=True
        ),
        "variables": Operation(
            meaning="enumerate every variable of the plant", outputs=("node_ids",), needed=("node_ids",)
        ),
    },
}


RECEIVE = "receive"
"""What a task needs that wants to see messages: ``messages``, and ``subscribe`` unless the call for messages waits for them."""


def behind(facet: str, blocking: Collection[str]) -> tuple[str, ...]:
    """The facets that a subject claims or not, behind one that a task needs.

    Args:
        facet: without its protocol.
        blocking: operations that an adapter performs by a call that waits for what it answers.
    """
    if facet != RECEIVE:
        return (facet,)
    return ("messages",) if "messages" in blocking else ("subscribe", "messages")


def facets(protocol: str) -> tuple[str, ...]:
    """What an adapter for ``protocol`` may claim or not."""
    names = [GUARD, RECOVERY]
    for name, operation in OPERATIONS[protocol].items():
        names += [name, *(f"{name}.{optional}" for optional in operation.optional)]
    return tuple(names)
