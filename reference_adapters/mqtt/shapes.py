"""The arguments of the tools with their bounds, and the shapes of their ``data``."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field
from typing_extensions import TypedDict

from ..core import LEFT_OUT, Arguments
from .payload import Datatype, DecodedMetric

MAX_PAYLOAD_BYTES = 1024 * 1024
MAX_METRICS = 1000

Encoding = Literal["utf-8", "base64"]
TopicName = Annotated[str, Field(description="topic to publish on, without wildcards, at most 65535 bytes")]
TopicFilter = Annotated[str, Field(description="topic filter; the wildcards + and # are allowed")]
QoS = Annotated[int, Field(ge=0, le=2, description="0, 1 or 2")]
Identifier = Annotated[
    str,
    # Sparkplug 3.0, sections 4.1.2 to 4.1.5: an identifier is one topic level.
    Field(min_length=1, max_length=200, pattern=r"^[^/+#\x00-\x1f\x7f]+$", description="one level of a topic"),
]
MetricName = Annotated[str, Field(min_length=1, max_length=500)]


# -- arguments ----------------------------------------------------------------------------------------------


class Publish(Arguments):
    """A message."""

    topic: TopicName
    payload: Annotated[str, Field(max_length=2 * MAX_PAYLOAD_BYTES, description="text, or base64 with encoding=base64")]
    qos: QoS = 0
    retain: bool = False
    encoding: Encoding = "utf-8"


class Filter(Arguments):
    """A topic filter."""

    topic: TopicFilter


class Subscribe(Filter):
    """A topic filter and the QoS asked for."""

    qos: QoS = 0


class ReadMessages(Filter):
    """A topic filter and how many messages at most."""

    limit: Annotated[int, Field(ge=1, le=1000)] = 100


class MetricValue(Arguments):
    """A new value of a declared metric."""

    name: MetricName
    value: Annotated[Any, Field(description="as the metric's datatype has it; null is allowed; Bytes are base64")]


class TypedMetric(MetricValue):
    """A metric with its datatype."""

    datatype: Datatype


class NodeBirth(Arguments):
    """The metrics of the node itself."""

    metrics: Annotated[list[TypedMetric], Field(max_length=MAX_METRICS, default_factory=list)]


class Device(Arguments):
    """A device of the adapter's edge node."""

    device_id: Identifier


class DeviceBirth(Device):
    """A device and all its metrics."""

    metrics: Annotated[list[TypedMetric], Field(min_length=1, max_length=MAX_METRICS)]


class NodeData(Arguments):
    """New values of the node."""

    metrics: Annotated[list[MetricValue], Field(min_length=1, max_length=MAX_METRICS)]


class DeviceData(Device):
    """New values of a device."""

    metrics: Annotated[list[MetricValue], Field(min_length=1, max_length=MAX_METRICS)]


class NodeCommand(Arguments):
    """A command to an edge node, by default of the adapter's own group."""

    edge_node_id: Identifier
    metrics: Annotated[list[TypedMetric], Field(min_length=1, max_length=MAX_METRICS)]
    group_id: Identifier = LEFT_OUT


class DeviceCommand(NodeCommand):
    """A command to a device of an edge node."""

    device_id: Identifier


class ForeignDevice(Device):
    """A device of another edge node, by default of the adapter's own group."""

    edge_node_id: Identifier
    group_id: Identifier = LEFT_OUT


class Base64Payload(Arguments):
    """A Sparkplug payload."""

    payload: Annotated[str, Field(max_length=2 * MAX_PAYLOAD_BYTES, description="base64")]


# -- data ---------------------------------------------------------------------------------------------------


class BrokerInfo(TypedDict):
    """The broker answered just now."""

    connected: bool
    endpoint: str
    client_id: str
    protocol_version: str
    subscriptions: int


class Published(TypedDict):
    """A message that was written (``unacknowledged``), or that the broker has (``acknowledged``)."""

    topic: str
    qos: int
    retain: bool
    payload_bytes: int
    delivery: str


class Granted(TypedDict):
    """A subscription and the QoS that the broker granted, which may be lower than that asked for."""

    topic: str
    qos: int
    granted_qos: int


class Ended(TypedDict):
    """A subscription that ended."""

    topic: str


class Subscribed(TypedDict):
    """A subscription; ``granted_qos`` is null while the broker refuses it."""

    topic: str
    qos: int
    granted_qos: int | None
    active: bool


class SubscriptionList(TypedDict):
    """All subscriptions."""

    subscriptions: list[Subscribed]


class ReceivedMessage(TypedDict):
    """A message. The payload is base64 when it is no text, or holds characters that displays and models trip over."""

    topic: str
    payload: str
    encoding: Encoding
    qos: int
    retain: bool
    received_at: str


class Messages(TypedDict):
    """Messages in the order of their arrival, how many had to be dropped since the last reading, and whether more can
    come just now."""

    messages: list[ReceivedMessage]
    dropped: int
    connected: bool


class NodePublished(TypedDict):
    """A message of the edge node."""

    edge_node_id: str
    metric_count: int
    seq: int
    bd_seq: int


class NodeDied(TypedDict):
    """The edge node's death."""

    edge_node_id: str
    bd_seq: int


class DevicePublished(TypedDict):
    """A message of a device of the edge node."""

    edge_node_id: str
    device_id: str
    metric_count: int
    seq: int


class DeviceDied(TypedDict):
    """A device's death."""

    edge_node_id: str
    device_id: str
    seq: int


class Commanded(TypedDict):
    """A command that was written; ``checked_against_birth`` when its names and types are known to be right."""

    topic: str
    metric_count: int
    delivery: str
    checked_against_birth: bool


class KnownDevice(TypedDict):
    """A device and the metrics of its birth with their last values; without ``online`` they are history."""

    device_id: str
    online: bool
    metrics: list[DecodedMetric]


class KnownNode(TypedDict):
    """An edge node. ``status`` is ``unknown`` when its birth was not seen or messages may have been missed; with
    ``sequence_gap`` some were. Values are current only while it is ``online`` and without a gap."""

    group_id: str
    edge_node_id: str
    status: Literal["online", "offline", "unknown"]
    bd_seq: int | str | None
    sequence_gap: bool
    metrics: list[DecodedMetric]
    devices: list[KnownDevice]


class KnownNodes(TypedDict):
    """The edge nodes heard of since ``listening_since``."""

    nodes: list[KnownNode]
    listening_since: str


class DecodedPayload(TypedDict):
    """A Sparkplug payload."""

    seq: int | str | None
    timestamp: int | str | None
    metrics: list[DecodedMetric]
