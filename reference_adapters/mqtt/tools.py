"""The plain MQTT tools."""

from __future__ import annotations

import base64
import unicodedata
from datetime import UTC, datetime

from ..core import AdapterError, Call, Nothing, device_text, tool
from .connection import Message
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
    Publish,
    Published,
    ReadMessages,
    ReceivedMessage,
    Subscribe,
    SubscriptionList,
)
from .topics import check_filter, check_name

__all__ = ["Tools"]

_LINE_BREAKS = frozenset("\t\r\n")


class Tools:
    """The tools over one connection to a broker."""

    def __init__(self, link: Link) -> None:
        self._link = link

    @tool("mqtt.info")
    async def get_broker_info(self, call: Call, arguments: Nothing) -> BrokerInfo:
        """Tell whether the broker answers now. Never from memory: the broker is asked during the call."""
        await self._link.ask(call)
        endpoint = self._link.endpoint
        return {
            "connected": True,
            "endpoint": endpoint.uri,
            "client_id": endpoint.client_id,
            "protocol_version": endpoint.version,
            "subscriptions": len(self._link.subscriptions),
        }

    @tool("mqtt.publish", writes=True, idempotent=False)
    async def publish_message(self, call: Call, arguments: Publish) -> Published:
        """Publish a message. With QoS 0 success means that it was written to a live connection, no more."""
        topic, qos, retain = check_name(arguments.topic), arguments.qos, arguments.retain
        message = Message(topic=topic, payload=_payload(arguments.payload, arguments.encoding), qos=qos, retain=retain)
        call.changes((topic, _number(message.payload)))
        await self._link.publish(call, lambda: [message])
        return {
            "topic": topic,
            "qos": qos,
            "retain": retain,
            "payload_bytes": len(message.payload),
            "delivery": call.trace["delivery"],
        }

    @tool("mqtt.subscribe")
    async def subscribe_topic(self, call: Call, arguments: Subscribe) -> Granted:
        """Subscribe to a topic filter; success means that the broker granted it. It is renewed after a reconnect."""
        topic, qos = check_filter(arguments.topic), arguments.qos
        granted = await self._link.subscribe(call, topic, qos)
        call.trace.update(topic=topic, qos=qos, granted_qos=granted)
        return {"topic": topic, "qos": qos, "granted_qos": granted}

    @tool("mqtt.unsubscribe")
    async def unsubscribe_topic(self, call: Call, arguments: Filter) -> Ended:
        """End a subscription."""
        topic = check_filter(arguments.topic)
        await self._link.unsubscribe(call, topic)
        call.trace.update(topic=topic)
        return {"topic": topic}

    @tool("mqtt.subscriptions")
    async def list_subscriptions(self, call: Call, arguments: Nothing) -> SubscriptionList:
        """List the subscriptions; they are active while there is a connection and the broker grants them."""
        connected = self._link.connected
        return {
            "subscriptions": [
                {
                    "topic": text,
                    "qos": one.qos,
                    "granted_qos": one.granted,
                    "active": connected and one.granted is not None,
                }
                for text, one in self._link.subscriptions.items()
            ]
        }

    @tool("mqtt.messages", idempotent=False)
    async def read_messages(self, call: Call, arguments: ReadMessages) -> Messages:
        """Take received messages that a filter selects, oldest first; what is read is gone. Subscribe before."""
        connected = self._link.connected
        taken, remaining = self._link.inbox.take(check_filter(arguments.topic), arguments.limit)
        if taken:
            call.source = "cache"
            call.extra["age_ms"] = round(1000 * (datetime.now(UTC) - taken[0].at).total_seconds(), 3)
        if remaining:
            call.extra["truncated"] = {"returned": len(taken), "total": len(taken) + remaining}
        return {
            "messages": [_received(call, index, received) for index, received in enumerate(taken)],
            "dropped": self._link.inbox.take_dropped(),
            "connected": connected,
        }


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


def _number(payload: bytes) -> float | None:
    """Return the number that a payload is as a text; None where it is none, or a structure."""
    try:
        return float(payload)
    except ValueError:
        return None


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
    """Return the payload as text, or None if it is no text or holds invisible characters other than line breaks.

    The invisible characters are those that ``device_text`` replaces.
    """
    try:
        text = data.decode()
    except UnicodeDecodeError:
        return None
    if text.isprintable():
        return text
    invisible = (c for c in set(text) - _LINE_BREAKS if unicodedata.category(c).startswith("C"))
    return None if next(invisible, None) else text
