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
from .mqtt import link_of
from .mutant import Bend, Data, Handler, Mutant, each

__all__ = ["MUTANTS"]


def sequence_per_device(server: AdapterServer) -> None:
    counters: Counter[str | None] = Counter()

    def numbered(node: EdgeNode, kind: str, device: str | None, metrics: Any) -> Message:
        seq = 0 if kind.endswith("BIRTH") else counters[device] % 256
        counters[device] = seq + 1
        return Message(topic=node.topic(kind, device), payload=payload.encode(metrics, seq))

    EdgeNode.numbered = numbered


def never_born(server: AdapterServer) -> None:
    node = link_of(server).edge_node

    def only_noting(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            metrics = declared(sparkplug_tools._checked(arguments.metrics))
            node.life = (node.life or Life()).with_device(arguments.device_id, metrics)
            return {"edge_node_id": node.name, "device_id": arguments.device_id, "metric_count": len(metrics), "seq": 0}

        return handler

    # A node that is not alive is not born again with the next connection.
    EdgeNode.alive = property(lambda node: False)
    each("publish_device_birth", change=only_noting)(server)


def swapped_field_numbers(server: AdapterServer) -> None:
    right, wrong = "12 float float_value   13 double double_value", "13 float float_value   12 double double_value"
    assert right in payload._TABLE
    payload._TABLE = payload._TABLE.replace(right, wrong)
    payload._Payload = payload._message_class()


def no_will(server: AdapterServer) -> None:
    link_of(server)._may_write = False


def births(change: Callable[[Message], Message]) -> Bend:
    """Return the defect that the NBIRTH is another message."""

    def bend(server: AdapterServer) -> None:
        genuine = EdgeNode.births

        def changed(node: EdgeNode, life: Life | None = None) -> list[Message]:
            first, *others = genuine(node, life)
            return [change(first), *others]

        EdgeNode.births = changed

    return bend


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


MUTANTS = (
    Mutant(
        id="MU-70",
        protocol="mqtt",
        sentence="Every device counts the sequence of its own messages.",
        bend=sequence_per_device,
        items="Q4 S11",
        requirements="SPB-004",
    ),
    Mutant(
        id="MU-73",
        protocol="mqtt",
        sentence="A device's data are published, its birth never.",
        bend=never_born,
        items="Q4",
        requirements="SPB-003",
    ),
    Mutant(
        id="MU-74",
        protocol="mqtt",
        sentence="The field numbers of Float and Double values are swapped.",
        bend=swapped_field_numbers,
        items="Q4 S11",
        requirements="SPB-001",
    ),
    Mutant(
        id="MU-76",
        protocol="mqtt",
        sentence="CONNECT carries no will.",
        bend=no_will,
        items="Q4 S11",
        requirements="SPB-006",
    ),
    Mutant(
        id="MU-76b",
        protocol="mqtt",
        sentence="bdSeq is the same with every connection.",
        bend=constant_count,
        items="S11 R-mqtt",
        requirements="SPB-006",
        recovers=True,
    ),
    Mutant(
        id="MU-77",
        protocol="mqtt",
        sentence="NBIRTH is published with QoS 1.",
        bend=births(lambda birth: replace(birth, qos=1)),
        items="Q4 S11",
        requirements="SPB-002",
    ),
    Mutant(
        id="MU-77r",
        protocol="mqtt",
        sentence="NBIRTH is retained.",
        bend=births(lambda birth: replace(birth, retain=True)),
        items="Q4 S11",
        requirements="SPB-002",
    ),
    Mutant(
        id="MU-127",
        protocol="mqtt",
        sentence="The birth of a device declares none of the metrics that its data carry.",
        bend=birth_without_metrics,
        items="Q4",
        requirements="SPB-009",
    ),
)
