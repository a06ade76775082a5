"""The abstract operations on MQTT and Sparkplug B."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation
from .filters import name_in

__all__ = ["OPERATIONS"]

OPERATIONS: Mapping[str, Operation] = {
    "info": Operation(
        meaning="is the broker reachable",
        outputs=("connected", "endpoint", "client_id"),
        status=True,
        tells="connected",
    ),
    "subscribe": Operation(
        meaning="subscribe to a topic filter",
        inputs=("filter", "qos"),
        outputs=("granted_qos",),
        optional=("qos",),
        requirement="MQT-002",
    ),
    "messages": Operation(
        meaning="messages received so far on a topic filter, each with topic and payload",
        inputs=("filter", "seconds"),
        outputs=("messages",),
        needed=("messages",),
        optional=("filter",),
        waits="seconds",
        requirement="MQT-004",
        voluntary_outputs=("encodings", "qos", "retained", "dropped", "connected"),
        topic_of=lambda inputs: name_in(inputs.get("filter")),
    ),
    "publish": Operation(
        meaning="publish a text payload",
        inputs=("topic", "payload", "qos"),
        outputs=("topic", "delivery"),
        writes=True,
        adds=True,
        optional=("qos",),
        requirement="MQT-001",
        voluntary_inputs=("retain", "encoding"),
        defaults={"retain": False, "encoding": "utf-8"},
        documents=("payload",),
    ),
    "device_birth": Operation(
        meaning="announce a Sparkplug B device with its metrics (DBIRTH)",
        inputs=("device", "metrics"),
        writes=True,
        adds=True,
        requirement="SPB-003",
        voluntary_outputs=("sequence",),
    ),
    "device_data": Operation(
        meaning="report metrics of a Sparkplug B device (DDATA)",
        inputs=("device", "metrics"),
        outputs=("metric_count",),
        writes=True,
        adds=True,
        requirement="SPB-001",
        voluntary_outputs=("sequence",),
    ),
    "unsubscribe": Operation(
        meaning="end the subscription to a topic filter",
        inputs=("filter",),
        voluntary=True,
        requirement="MQT-002",
    ),
    "subscriptions": Operation(
        meaning="topic filters that are subscribed to",
        outputs=("filters",),
        needed=("filters",),
        voluntary=True,
        voluntary_outputs=("granted_qos", "active"),
        requirement="MQT-002",
    ),
    "node_birth": Operation(
        meaning="announce the adapter's own Sparkplug B edge node with its metrics (NBIRTH)",
        inputs=("metrics",),
        outputs=("metric_count",),
        writes=True,
        adds=True,
        voluntary=True,
        voluntary_outputs=("sequence", "bd_seq"),
        requirement="SPB-003",
    ),
    "node_data": Operation(
        meaning="report metrics of the adapter's own Sparkplug B edge node (NDATA)",
        inputs=("metrics",),
        outputs=("metric_count",),
        writes=True,
        adds=True,
        voluntary=True,
        voluntary_outputs=("sequence",),
        requirement="SPB-001",
    ),
    "node_death": Operation(
        meaning="declare the adapter's own Sparkplug B edge node dead (NDEATH)",
        writes=True,
        voluntary=True,
        voluntary_outputs=("bd_seq",),
        requirement="SPB-012",
    ),
    "device_death": Operation(
        meaning="declare a Sparkplug B device dead (DDEATH)",
        inputs=("device",),
        writes=True,
        voluntary=True,
        voluntary_outputs=("sequence",),
        requirement="SPB-012",
    ),
    "send_node_command": Operation(
        meaning="command another Sparkplug B edge node (NCMD)",
        inputs=("node", "metrics"),
        outputs=("delivery",),
        writes=True,
        voluntary=True,
        voluntary_inputs=("group",),
        requirement="SPB-010",
    ),
    "send_device_command": Operation(
        meaning="command a device of another Sparkplug B edge node (DCMD)",
        inputs=("node", "device", "metrics"),
        outputs=("delivery",),
        writes=True,
        voluntary=True,
        voluntary_inputs=("group",),
        requirement="SPB-010",
    ),
    "sparkplug_nodes": Operation(
        meaning="Sparkplug B edge nodes heard of, each with group, node, status, bd_seq, gap, metrics and devices",
        outputs=("nodes",),
        needed=("nodes",),
        voluntary=True,
        requirement="SPB-011",
    ),
    "decode_sparkplug": Operation(
        meaning="decode a Sparkplug B payload, which is base64; metrics with name, alias, datatype and value",
        inputs=("payload",),
        outputs=("metrics",),
        needed=("metrics",),
        voluntary=True,
        voluntary_outputs=("sequence", "timestamp"),
        requirement="SPB-001",
    ),
}
