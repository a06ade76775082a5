"""The abstract operations on MQTT and Sparkplug B."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

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
    ),
    "publish": Operation(
        meaning="publish a text payload",
        inputs=("topic", "payload", "qos"),
        outputs=("topic", "delivery"),
        writes=True,
        optional=("qos",),
        requirement="MQT-001",
    ),
    "device_birth": Operation(
        meaning="announce a Sparkplug B device with its metrics (DBIRTH)",
        inputs=("device", "metrics"),
        writes=True,
        requirement="SPB-003",
    ),
    "device_data": Operation(
        meaning="report metrics of a Sparkplug B device (DDATA)",
        inputs=("device", "metrics"),
        outputs=("metric_count",),
        writes=True,
        requirement="SPB-001",
    ),
}
