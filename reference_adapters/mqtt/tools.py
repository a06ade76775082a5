"""The plain MQTT tools, and how the adapter is put together."""

from __future__ import annotations

import base64
import re
import unicodedata
from datetime import UTC, datetime
from urllib.parse import urlsplit

from ..core import AdapterError, AdapterServer, Call, ConfigError, Environment, device_text
from .connection import Endpoint, Message
from .edge_node import EdgeNode
from .inbox import Received
from .link import Link
from .shapes import (
    MAX_PAYLOAD_BYTES,
    BrokerInfo,
    Encoding,
    Ended,
    Filter,
    Granted,
    Messages,
    Nothing,
    Publish,
    Published,
    ReadMessages,
    ReceivedMessage,
    Subscribe,
    SubscriptionList,
)
from .sparkplug_tools import add_sparkplug_tools
from .topics import check_filter, check_name

__all__ = ["build"]

_LEVEL = re.compile(r"[^/+#\x00-\x1f\x7f]+")
_LINE_BREAKS = frozenset("\t\r\n")


def build() -> AdapterServer:
    """The adapter as the environment configures it.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    endpoint = _endpoint(environment)
    may_write = environment.writes_enabled("MQTT_WRITES_ENABLED")
    node = EdgeNode(
        _identifier(environment, "SPARKPLUG_GROUP_ID", "factory"),
        _identifier(environment, "SPARKPLUG_EDGE_NODE_ID", "otmcp-adapter"),
    )
    link = Link(endpoint, node, may_write=may_write)
    server = AdapterServer(
        name="mqtt-reference",
        version="0.1.0",
        protocol="mqtt",
        endpoint=endpoint.uri,
        writes_enabled=may_write,
        switch="MQTT_WRITES_ENABLED",
        deadline_s=environment.seconds("MQTT_DEADLINE_S", 4.0),
        close=link.close,
    )

    @server.tool("mqtt.info")
    async def get_broker_info(call: Call, arguments: Nothing) -> BrokerInfo:
        """Tell whether the broker answers now. Never from memory: the broker is asked during the call."""
        await link.ask(call)
        return {
            "connected": True,
            "endpoint": endpoint.uri,
            "client_id": endpoint.client_id,
            "protocol_version": "3.1.1",
            "subscriptions": len(link.subscriptions),
        }

    @server.tool("mqtt.publish", writes=True, idempotent=False)
    async def publish_message(call: Call, arguments: Publish) -> Published:
        """Publish a message. With QoS 0 success means that it was written to a live connection, no more."""
        topic, qos, retain = check_name(arguments.topic), arguments.qos, arguments.retain
        message = Message(topic=topic, payload=_payload(arguments.payload, arguments.encoding), qos=qos, retain=retain)
        await link.publish(call, lambda: [message])
        return {
            "topic": topic,
            "qos": qos,
            "retain": retain,
            "payload_bytes": len(message.payload),
            "delivery": call.trace["delivery"],
        }

    @server.tool("mqtt.subscribe")
    async def subscribe_topic(call: Call, arguments: Subscribe) -> Granted:
        """Subscribe to a topic filter; success means that the broker granted it. It is renewed after a reconnect."""
        topic, qos = check_filter(arguments.topic), arguments.qos
        granted = await link.subscribe(call, topic, qos)
        call.trace.update(topic=topic, qos=qos, granted_qos=granted)
        return {"topic": topic, "qos": qos, "granted_qos": granted}

    @server.tool("mqtt.unsubscribe")
    async def unsubscribe_topic(call: Call, arguments: Filter) -> Ended:
        """End a subscription."""
        topic = check_filter(arguments.topic)
        await link.unsubscribe(call, topic)
        call.trace.update(topic=topic)
        return {"topic": topic}

    @server.tool("mqtt.subscriptions")
    async def list_subscriptions(call: Call, arguments: Nothing) -> SubscriptionList:
        """List the subscriptions; they are active while there is a connection and the broker grants them."""
        connected = link.connected
        return {
            "subscriptions": [
                {
                    "topic": text,
                    "qos": one.qos,
                    "granted_qos": one.granted,
                    "active": connected and one.granted is not None,
                }
                for text, one in link.subscriptions.items()
            ]
        }

    @server.tool("mqtt.messages", idempotent=False)
    async def read_messages(call: Call, arguments: ReadMessages) -> Messages:
        """Take received messages that a filter selects, oldest first; what is read is gone. Subscribe before."""
        connected = link.connected
        taken, remaining = link.inbox.take(check_filter(arguments.topic), arguments.limit)
        if taken:
            call.source = "cache"
            call.extra["age_ms"] = round(1000 * (datetime.now(UTC) - taken[0].at).total_seconds(), 3)
        if remaining:
            call.extra["truncated"] = {"returned": len(taken), "total": len(taken) + remaining}
        return {
            "messages": [_received(call, index, received) for index, received in enumerate(taken)],
            "dropped": link.inbox.take_dropped(),
            "connected": connected,
        }

    add_sparkplug_tools(server, link)
    return server


def _endpoint(environment: Environment) -> Endpoint:
    expected = ConfigError("MQTT_URL: expected mqtt://host:port or mqtts://host:port")
    try:
        parts = urlsplit(environment.text("MQTT_URL", "mqtt://127.0.0.1:1883"))
        port = parts.port
    except ValueError:
        raise expected from None
    if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname or parts.path.strip("/") or parts.query:
        raise expected
    if parts.username is not None:
        raise ConfigError("MQTT_URL: user name and password belong into MQTT_USERNAME and MQTT_PASSWORD")
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


def _identifier(environment: Environment, name: str, default: str) -> str:
    text = environment.text(name, default)
    if not _LEVEL.fullmatch(text):
        raise ConfigError(f"{name}: expected one level of a topic, without / + #, found {text!r}")
    return text


def _payload(text: str, encoding: Encoding) -> bytes:
    if encoding == "base64":
        try:
            data = base64.b64decode(text, validate=True)
        except ValueError:
            raise AdapterError("invalid_input", "the payload is not base64", field="/payload") from None
    else:
        data = text.encode()
    if len(data) > MAX_PAYLOAD_BYTES:
        raise AdapterError("limit_exceeded", f"the payload is above {MAX_PAYLOAD_BYTES} bytes", field="/payload")
    return data


def _received(call: Call, index: int, received: Received) -> ReceivedMessage:
    message = received.message
    text = _harmless_text(message.payload)
    call.extra.setdefault("untrusted", []).append(f"/data/messages/{index}/payload")
    return {
        "topic": device_text(call, f"/data/messages/{index}/topic", message.topic),
        "payload": base64.b64encode(message.payload).decode() if text is None else text,
        "encoding": "base64" if text is None else "utf-8",
        "qos": message.qos,
        "retain": message.retain,
        "received_at": received.at.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
    }


def _harmless_text(data: bytes) -> str | None:
    """The payload as text, if it is text and holds nothing invisible (as ``device_text`` has it) but line breaks."""
    try:
        text = data.decode()
    except UnicodeDecodeError:
        return None
    if text.isprintable():
        return text
    invisible = (c for c in set(text) - _LINE_BREAKS if unicodedata.category(c).startswith("C"))
    return None if next(invisible, None) else text
