"""The sixteen tools: plain MQTT, and the Sparkplug edge node."""

from __future__ import annotations

import base64
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import Field

from ..core import AdapterError, AdapterServer, Arguments, Call, ConfigError, Environment
from .connection import Connection, Endpoint
from .edge_node import EdgeNode
from .link import Link
from .payload import Datatype, Metric, check_value, decode, encode
from .topics import check_filter, check_name

__all__ = ["build"]

MAX_PAYLOAD_BYTES = 1024 * 1024
SPARKPLUG = "sparkplug-b"

Topic = Annotated[str, Field(description="topic, at most 65535 bytes")]
QoS = Annotated[int, Field(ge=0, le=2, description="0, 1 or 2")]
Identifier = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^/+#\x00]+$")]
Name = Annotated[str, Field(min_length=1, max_length=500)]
Encoding = Literal["utf-8", "base64"]


class Nothing(Arguments):
    """No arguments."""


class Publish(Arguments):
    """A message."""

    topic: Topic
    payload: Annotated[str, Field(description="text, or base64 with encoding=base64")]
    qos: QoS = 0
    retain: bool = False
    encoding: Encoding = "utf-8"


class Subscribe(Arguments):
    """A topic filter and the QoS asked for."""

    topic: Topic
    qos: QoS = 0


class Filter(Arguments):
    """A topic filter."""

    topic: Topic


class ReadMessages(Filter):
    """A topic filter and how many messages at most."""

    limit: Annotated[int, Field(ge=1, le=1000)] = 100


class TypedMetric(Arguments):
    """A metric with its datatype; null is allowed as a value."""

    name: Name
    datatype: Datatype
    value: Any


class MetricValue(Arguments):
    """A new value of a declared metric."""

    name: Name
    value: Any


class NodeBirth(Arguments):
    """The metrics of the node itself."""

    metrics: Annotated[list[TypedMetric], Field(max_length=1000, default_factory=list)]


class Device(Arguments):
    """A device of the adapter's edge node."""

    device_id: Identifier


class DeviceBirth(Device):
    """A device and all its metrics."""

    metrics: Annotated[list[TypedMetric], Field(min_length=1, max_length=1000)]


class NodeData(Arguments):
    """New values of the node."""

    metrics: Annotated[list[MetricValue], Field(min_length=1, max_length=1000)]


class DeviceData(Device):
    """New values of a device."""

    metrics: Annotated[list[MetricValue], Field(min_length=1, max_length=1000)]


class NodeCommand(Arguments):
    """A command to an edge node, by default of the adapter's own group."""

    edge_node_id: Identifier
    metrics: Annotated[list[TypedMetric], Field(min_length=1, max_length=1000)]
    group_id: Identifier | None = None


class DeviceCommand(NodeCommand):
    """A command to a device of an edge node."""

    device_id: Identifier


class Payload(Arguments):
    """A Sparkplug payload."""

    payload: Annotated[str, Field(max_length=2 * MAX_PAYLOAD_BYTES, description="base64")]


def build() -> AdapterServer:
    """The adapter as the environment configures it.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    endpoint = _endpoint(environment)
    may_write = environment.writes_enabled("MQTT_WRITES_ENABLED")
    node = EdgeNode(
        environment.text("SPARKPLUG_GROUP_ID", "factory"), environment.text("SPARKPLUG_EDGE_NODE_ID", "otmcp-adapter")
    )
    link = Link(endpoint, node, may_write=may_write)
    scheme = "mqtts" if endpoint.tls else "mqtt"
    uri = f"{scheme}://{endpoint.host}:{endpoint.port}"
    server = AdapterServer(
        name="mqtt-reference",
        version="0.1.0",
        protocol="mqtt",
        endpoint=uri,
        writes_enabled=may_write,
        switch="MQTT_WRITES_ENABLED",
        deadline_s=environment.seconds("MQTT_DEADLINE_S", 4.0),
        close=link.close,
    )

    # -- plain MQTT -----------------------------------------------------------------------------------------

    @server.tool("mqtt.info")
    async def get_broker_info(call: Call, arguments: Nothing) -> dict[str, Any]:
        """Tell whether the broker answers now. Never from memory: the broker is asked during the call."""

        async def ask(connection: Connection) -> None:
            # Unsubscribing what was never subscribed changes nothing, and the broker has to answer.
            await connection.unsubscribe(f"otmcp/ping/{endpoint.client_id}")

        await link.exchange(call, ask)
        call.answered()
        return {
            "connected": True,
            "endpoint": uri,
            "client_id": endpoint.client_id,
            "protocol_version": "3.1.1",
            "subscriptions": len(link.subscriptions),
        }

    @server.tool("mqtt.publish", writes=True, idempotent=False)
    async def publish_message(call: Call, arguments: Publish) -> dict[str, Any]:
        """Publish a message. With QoS 0 success means that it was written to a live connection, no more."""
        check_name(arguments.topic)
        data = _bytes(arguments.payload, arguments.encoding)
        call.trace.update(topic=arguments.topic, qos=arguments.qos, retain=arguments.retain)
        delivery = await link.publish(call, arguments.topic, lambda: data, qos=arguments.qos, retain=arguments.retain)
        if arguments.qos:
            call.answered()
        call.trace["delivery"] = delivery
        return {
            "topic": arguments.topic,
            "qos": arguments.qos,
            "retain": arguments.retain,
            "payload_bytes": len(data),
            "delivery": delivery,
        }

    @server.tool("mqtt.subscribe")
    async def subscribe_topic(call: Call, arguments: Subscribe) -> dict[str, Any]:
        """Subscribe to a topic filter; success means that the broker granted it."""
        check_filter(arguments.topic)
        granted = await link.exchange(call, lambda connection: connection.subscribe(arguments.topic, arguments.qos))
        link.subscriptions[arguments.topic] = arguments.qos
        call.answered(topic=arguments.topic, qos=arguments.qos, granted_qos=granted)
        return {"topic": arguments.topic, "qos": arguments.qos, "granted_qos": granted}

    @server.tool("mqtt.unsubscribe")
    async def unsubscribe_topic(call: Call, arguments: Filter) -> dict[str, Any]:
        """End a subscription."""
        check_filter(arguments.topic)
        link.subscriptions.pop(arguments.topic, None)
        await link.exchange(call, lambda connection: connection.unsubscribe(arguments.topic))
        call.answered(topic=arguments.topic)
        return {"topic": arguments.topic}

    @server.tool("mqtt.subscriptions")
    async def list_subscriptions(call: Call, arguments: Nothing) -> dict[str, Any]:
        """List the subscriptions; they are active only while there is a connection."""
        active = link.connected
        listed = [{"topic": text, "qos": qos, "active": active} for text, qos in link.subscriptions.items()]
        return {"subscriptions": listed}

    @server.tool("mqtt.messages", idempotent=False)
    async def read_messages(call: Call, arguments: ReadMessages) -> dict[str, Any]:
        """Take received messages that a filter selects, oldest first; what is read is gone."""
        check_filter(arguments.topic)
        return link.inbox.take(arguments.topic, arguments.limit)

    # -- Sparkplug: births and deaths -----------------------------------------------------------------------

    def traced(call: Call, kind: str, device: str | None = None) -> None:
        about: dict[str, Any] = {"group": node.group, "edge_node": node.name, "type": kind, "bd_seq": node.bd_seq}
        call.trace.update(about if device is None else {**about, "device": device})

    async def ensure_born(call: Call) -> None:
        connection = await link.connect()
        if not node.born:
            node.wanted = True
            await link.exchange(call, lambda c: link.announce(c) if c is connection or not node.born else _nothing())

    @server.tool("sparkplug.node_birth", writes=True, idempotent=False, protocol=SPARKPLUG)
    async def publish_node_birth(call: Call, arguments: NodeBirth) -> dict[str, Any]:
        """Publish NBIRTH and the DBIRTH of every device that is born."""
        node.declare_node(_checked(arguments.metrics))
        node.wanted = True
        await link.exchange(call, link.announce)
        traced(call, "NBIRTH")
        return {"edge_node_id": node.name, "metric_count": len(arguments.metrics), "bd_seq": node.bd_seq}

    @server.tool("sparkplug.node_death", writes=True, protocol=SPARKPLUG)
    async def publish_node_death(call: Call, arguments: Nothing) -> dict[str, Any]:
        """Publish NDEATH; the node has to be born again before data."""
        if not node.born:
            raise AdapterError("not_born", "the edge node has not been born")
        await link.publish(call, node.topic("NDEATH"), node.death, qos=1)
        node.born = node.wanted = False
        traced(call, "NDEATH")
        return {"edge_node_id": node.name, "bd_seq": node.bd_seq}

    @server.tool("sparkplug.device_birth", writes=True, idempotent=False, protocol=SPARKPLUG)
    async def publish_device_birth(call: Call, arguments: DeviceBirth) -> dict[str, Any]:
        """Publish DBIRTH of a device, with NBIRTH before it if the node is not born."""
        metrics = _checked(arguments.metrics)
        await ensure_born(call)
        node.declare_device(arguments.device_id, metrics)
        topic = node.topic("DBIRTH", arguments.device_id)
        await numbered(call, topic, lambda: node.device_birth(arguments.device_id))
        traced(call, "DBIRTH", arguments.device_id)
        return {"device_id": arguments.device_id, "metric_count": len(metrics), "seq": node.seq}

    @server.tool("sparkplug.device_death", writes=True, protocol=SPARKPLUG)
    async def publish_device_death(call: Call, arguments: Device) -> dict[str, Any]:
        """Publish DDEATH of a device."""
        if not node.born or not node.declared(arguments.device_id):
            raise AdapterError("not_born", "the device has not been born")
        await numbered(call, node.topic("DDEATH", arguments.device_id), lambda: node.data([]))
        node.undeclare_device(arguments.device_id)
        traced(call, "DDEATH", arguments.device_id)
        return {"device_id": arguments.device_id, "seq": node.seq}

    # -- Sparkplug: data and commands -----------------------------------------------------------------------

    async def numbered(call: Call, topic: str, payload: Any) -> None:
        """Publish a message with a sequence number; one that is not sent does not use it up."""
        taken = False

        def take() -> bytes:
            nonlocal taken
            taken = True
            data: bytes = payload()
            call.trace["seq"] = node.seq
            return data

        try:
            await link.publish(call, topic, take)
        except AdapterError as error:
            if taken and error.outcome == "not_sent":
                node.not_sent()
            raise
        call.trace.update(topic=topic, qos=0, retain=False, delivery="unacknowledged")

    @server.tool("sparkplug.node_data", writes=True, idempotent=False, protocol=SPARKPLUG)
    async def publish_node_data(call: Call, arguments: NodeData) -> dict[str, Any]:
        """Publish NDATA with metrics that the birth declared."""
        metrics = node.node_metrics([(metric.name, metric.value) for metric in arguments.metrics])
        await numbered(call, node.topic("NDATA"), lambda: node.data(metrics))
        traced(call, "NDATA")
        return {"edge_node_id": node.name, "metric_count": len(metrics), "seq": call.trace["seq"]}

    @server.tool("sparkplug.device_data", writes=True, idempotent=False, protocol=SPARKPLUG)
    async def publish_device_data(call: Call, arguments: DeviceData) -> dict[str, Any]:
        """Publish DDATA with metrics that the device's birth declared."""
        values = [(metric.name, metric.value) for metric in arguments.metrics]
        metrics = node.device_metrics(arguments.device_id, values)
        await numbered(call, node.topic("DDATA", arguments.device_id), lambda: node.data(metrics))
        traced(call, "DDATA", arguments.device_id)
        return {"device_id": arguments.device_id, "metric_count": len(metrics), "seq": call.trace["seq"]}

    async def command(call: Call, kind: str, arguments: NodeCommand, device: str | None) -> dict[str, Any]:
        metrics = _checked(arguments.metrics)
        group = arguments.group_id or node.group
        topic = f"spBv1.0/{group}/{kind}/{arguments.edge_node_id}" + ("" if device is None else f"/{device}")
        # Commands carry no sequence number (payloads-ncmd-seq, payloads-dcmd-seq).
        delivery = await link.publish(call, topic, lambda: encode(metrics, None))
        call.trace.update(topic=topic, qos=0, retain=False, type=kind, delivery=delivery)
        return {"topic": topic, "metric_count": len(metrics), "delivery": delivery}

    @server.tool("sparkplug.node_command", writes=True, idempotent=False, protocol=SPARKPLUG)
    async def publish_node_command(call: Call, arguments: NodeCommand) -> dict[str, Any]:
        """Publish NCMD to an edge node."""
        return await command(call, "NCMD", arguments, None)

    @server.tool("sparkplug.device_command", writes=True, idempotent=False, protocol=SPARKPLUG)
    async def publish_device_command(call: Call, arguments: DeviceCommand) -> dict[str, Any]:
        """Publish DCMD to a device of an edge node."""
        return await command(call, "DCMD", arguments, arguments.device_id)

    # -- Sparkplug: looking -----------------------------------------------------------------------------------

    @server.tool("sparkplug.nodes", protocol=SPARKPLUG)
    async def list_sparkplug_nodes(call: Call, arguments: Nothing) -> dict[str, Any]:
        """List the edge nodes whose births were seen; the first call begins to listen for them."""
        if not link.nodes.wanted:
            await link.exchange(call, lambda connection: connection.subscribe("spBv1.0/#", 0))
            link.nodes.wanted = True
            call.answered()
        return {"nodes": link.nodes.listing()}

    @server.tool("sparkplug.decode", protocol=SPARKPLUG)
    async def decode_sparkplug_payload(call: Call, arguments: Payload) -> dict[str, Any]:
        """Decode a Sparkplug B payload."""
        return decode(_bytes(arguments.payload, "base64"))

    return server


async def _nothing() -> None:
    """Somebody else was quicker."""


def _endpoint(environment: Environment) -> Endpoint:
    url = environment.text("MQTT_URL", "mqtt://127.0.0.1:1883")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise ConfigError("MQTT_URL: expected mqtt://host:port or mqtts://host:port") from None
    if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname:
        raise ConfigError("MQTT_URL: expected mqtt://host:port or mqtts://host:port")
    tls = parts.scheme == "mqtts"
    return Endpoint(
        host=parts.hostname,
        port=port or (8883 if tls else 1883),
        tls=tls,
        client_id=environment.text("MQTT_CLIENT_ID", "otmcp-adapter"),
        username=environment.optional("MQTT_USERNAME"),
        password=environment.optional("MQTT_PASSWORD"),
        timeout_s=environment.seconds("MQTT_TIMEOUT_S", 2.0),
    )


def _bytes(text: str, encoding: Encoding) -> bytes:
    if encoding == "base64":
        try:
            data = base64.b64decode(text, validate=True)
        except ValueError:
            raise AdapterError("invalid_input", "the payload is not base64", field="/payload") from None
    else:
        try:
            data = text.encode()
        except UnicodeEncodeError:
            raise AdapterError("invalid_input", "the payload holds a lone surrogate", field="/payload") from None
    if len(data) > MAX_PAYLOAD_BYTES:
        raise AdapterError("limit_exceeded", f"the payload is above {MAX_PAYLOAD_BYTES} bytes", field="/payload")
    return data


def _checked(metrics: list[TypedMetric]) -> list[Metric]:
    for index, metric in enumerate(metrics):
        check_value(metric.datatype, metric.value, f"/metrics/{index}/value")
    return [(metric.name, metric.datatype, metric.value) for metric in metrics]
