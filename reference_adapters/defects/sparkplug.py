"""Defects of a Sparkplug edge node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ..core import AdapterServer, Call
from ..mqtt import payload, sparkplug_tools
from ..mqtt.connection import Message
from ..mqtt.edge_node import EdgeNode, Life, declared
from .defect import Change, Data, Handler, around, defect
from .mqtt import link_of

__all__ = ["DEFECTS"]


def sequence_per_device(server: AdapterServer) -> None:
    counters: Counter[str | None] = Counter()

    def numbered(node: EdgeNode, kind: str, device: str | None, metrics: Any) -> Message:
        seq = 0 if kind.endswith("BIRTH") else counters[device] % 256
        counters[device] = seq + 1
        return Message(topic=node.topic(kind, device), payload=payload.encode(metrics, seq))

    EdgeNode.numbered = numbered


def never_born(server: AdapterServer) -> None:
    node = link_of(server).edge_node

    @around("publish_device_birth")
    async def only_noting(genuine: Handler, call: Call, arguments: Any) -> Data:
        metrics = declared(sparkplug_tools._checked(arguments.metrics))
        node.life = (node.life or Life()).with_device(arguments.device_id, metrics)
        return {"edge_node_id": node.name, "device_id": arguments.device_id, "metric_count": len(metrics), "seq": 0}

    # A node that is not alive is not born again with the next connection.
    EdgeNode.alive = property(lambda node: False)
    only_noting(server)


def swapped_field_numbers(server: AdapterServer) -> None:
    right, wrong = "12 float float_value   13 double double_value", "13 float float_value   12 double double_value"
    assert right in payload._TABLE
    payload._TABLE = payload._TABLE.replace(right, wrong)
    payload._Payload = payload._message_class()


def no_will(server: AdapterServer) -> None:
    link_of(server)._may_write = False


def births(change: Callable[[Message], Message]) -> Change:
    """Return the defect that the NBIRTH is another message."""

    def apply(server: AdapterServer) -> None:
        genuine = EdgeNode.births

        def changed(node: EdgeNode, life: Life | None = None) -> list[Message]:
            first, *others = genuine(node, life)
            return [change(first), *others]

        EdgeNode.births = changed

    return apply


def birth_without_metrics(server: AdapterServer) -> None:
    genuine = EdgeNode.numbered

    def numbered(node: EdgeNode, kind: str, device: str | None, metrics: Any) -> Message:
        return genuine(node, kind, device, () if kind == "DBIRTH" else metrics)

    EdgeNode.numbered = numbered


def constant_count(server: AdapterServer) -> None:
    genuine = EdgeNode.will

    def connect_sent(node: EdgeNode) -> None:
        node.bd_seq = 0

    def will(node: EdgeNode) -> Any:
        node.bd_seq = -1
        return genuine(node)

    EdgeNode.connect_sent = connect_sent
    EdgeNode.will = will


DEFECTS = (
    defect(
        "MU-70",
        "mqtt",
        "Every device counts the sequence of its own messages.",
        sequence_per_device,
        "Q4 S11",
        "SPB-004",
    ),
    defect("MU-73", "mqtt", "A device's data are published, its birth never.", never_born, "Q4", "SPB-003"),
    defect(
        "MU-74",
        "mqtt",
        "The field numbers of Float and Double values are swapped.",
        swapped_field_numbers,
        "Q4 S11",
        "SPB-001",
    ),
    defect("MU-76", "mqtt", "CONNECT carries no will.", no_will, "Q4 S11", "SPB-006"),
    defect(
        "MU-76b",
        "mqtt",
        "bdSeq is the same with every connection.",
        constant_count,
        "S11 R-mqtt",
        "SPB-006",
        recovers=True,
    ),
    defect(
        "MU-77",
        "mqtt",
        "NBIRTH is published with QoS 1.",
        births(lambda birth: replace(birth, qos=1)),
        "Q4 S11",
        "SPB-002",
    ),
    defect(
        "MU-77r", "mqtt", "NBIRTH is retained.", births(lambda birth: replace(birth, retain=True)), "Q4 S11", "SPB-002"
    ),
    defect(
        "MU-127",
        "mqtt",
        "The birth of a device declares none of the metrics that its data carry.",
        birth_without_metrics,
        "Q4",
        "SPB-009",
    ),
)
