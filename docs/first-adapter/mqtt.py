"""An MQTT adapter that earns Silver: the official SDK, and paho-mqtt."""

from __future__ import annotations

import base64
import os
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Empty, Queue
from typing import Any

import paho.mqtt.client as mqtt
from mcp.server.mcpserver.exceptions import ToolError
from strict_mcp import READS, SENDS, StrictServer, strict

mcp = StrictServer("plant-mqtt", "1.0.0")
HOST, PORT = os.environ["MQTT_HOST"], int(os.environ["MQTT_PORT"])
TIMEOUT_S = float(os.environ.get("MQTT_TIMEOUT_S", "2"))
CONNECTIONS = threading.BoundedSemaphore(4)

Topic = strict(str, "topic, without wildcards", min_length=1, max_length=65535)
Filter = strict(str, "topic filter", min_length=1, max_length=65535)
Qos = strict(int, "quality of service", ge=0, le=2)
Payload = strict(str, "payload, as text", max_length=262144)
Retain = strict(bool, "whether the broker keeps the message")


def client(**settings: Any) -> mqtt.Client:
    """Return a client that is not connected, for MQTT 5.

    For 3.1.1 paho goes down to 3.1 for good when a broker refuses it once, and learns of no refused publication.
    """
    made = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5, **settings)
    made.connect_timeout = TIMEOUT_S
    if "MQTT_CA" in os.environ:
        # The broker's name is compared as well; tls_insecure_set(True) would end that.
        files = (os.environ.get(name) for name in ("MQTT_CA", "MQTT_CERT", "MQTT_KEY"))
        made.tls_set(*files)
    return made


@contextmanager
def connection() -> Iterator[mqtt.Client]:
    """Give a call a connection of its own.

    A client that reconnects sends again what was not acknowledged, also after the call has said that it failed.
    """
    own, answers = client(reconnect_on_failure=False), Queue[mqtt.ReasonCode]()
    own.on_connect = lambda _client, _data, _flags, reason, _properties: answers.put(reason)
    if not CONNECTIONS.acquire(timeout=0.5):
        raise ToolError("device_busy: too many calls at the same time; nothing was sent")
    try:
        try:
            own.connect(HOST, PORT)
        except OSError as error:
            raise ToolError(f"connect_failed: the broker cannot be reached ({error}); nothing was sent") from error
        own.loop_start()
        try:
            reason = answers.get(timeout=TIMEOUT_S)
        except Empty:
            raise ToolError("no_reply: the broker did not accept the connection; nothing was sent") from None
        if reason.is_failure:
            raise ToolError(f"refused: {reason}; nothing was sent")
        yield own
    finally:
        own.disconnect()
        own.loop_stop()
        CONNECTIONS.release()


class Subscriber:
    """The connection that receives: it comes back by itself and subscribes again to what is subscribed."""

    def __init__(self) -> None:
        self._messages: deque[dict[str, Any]] = deque(maxlen=1000)
        self._filters: dict[str, int] = {}
        self._waiting: dict[int, Queue[list[mqtt.ReasonCode]]] = {}
        self._up, self._lock, self._refused = threading.Event(), threading.Lock(), ""
        self._client = client()
        self._client.reconnect_delay_set(0.1, 0.5)  # paho waits up to two minutes
        self._client.on_connect, self._client.on_disconnect = self._connected, self._disconnected
        self._client.on_subscribe, self._client.on_message = self._subscribed, self._received
        self._client.connect_async(HOST, PORT, keepalive=2)  # a connection that died without a word is found by it
        self._client.loop_start()

    def subscribe(self, topic: str, qos: int) -> int:
        """Subscribe and return the granted quality of service."""
        self.wait()
        if "\0" in topic:
            raise ToolError("invalid_argument: a filter has no null character; nothing was sent")
        answer = Queue[list[mqtt.ReasonCode]]()
        with self._lock:
            try:
                code, number = self._client.subscribe(topic, qos)
            except ValueError as error:
                raise ToolError(f"invalid_argument: {error}") from error
            self._waiting[number or 0] = answer
        try:
            granted = answer.get(timeout=TIMEOUT_S)[0]
        except Empty:
            raise ToolError(f"no_reply: the broker did not answer ({mqtt.error_string(code)})") from None
        finally:
            self._waiting.pop(number or 0, None)
        if granted.is_failure:
            raise ToolError(f"refused: {granted}")
        self._filters[topic] = qos
        return int(granted.value)

    def take(self, topic: str) -> list[dict[str, Any]]:
        """Return the messages on this filter that no call has had yet."""
        self.wait()
        with self._lock:
            every = list(self._messages)
            taken = [message for message in every if mqtt.topic_matches_sub(topic, message["topic"])]
            self._messages.clear()
            self._messages.extend(message for message in every if message not in taken)
        return taken

    def wait(self) -> None:
        """Wait until the broker has the connection and the subscriptions."""
        if not self._up.wait(TIMEOUT_S):
            raise ToolError(self._refused or "connect_failed: the broker cannot be reached")

    def _connected(self, client: mqtt.Client, _data: Any, _flags: Any, reason: mqtt.ReasonCode, _more: Any) -> None:
        if reason.is_failure:
            self._refused = f"refused: {reason}"
            return
        if self._filters:
            client.subscribe([*self._filters.items()])
        self._up.set()

    def _disconnected(self, *_: Any) -> None:
        if self._up.is_set():
            self._refused = ""
        self._up.clear()

    def _subscribed(self, _client: Any, _data: Any, number: int, reasons: list[mqtt.ReasonCode], _more: Any) -> None:
        with self._lock:
            if number in self._waiting:
                self._waiting[number].put(reasons)

    def _received(self, _client: Any, _data: Any, message: mqtt.MQTTMessage) -> None:
        try:
            payload, encoding = message.payload.decode(), "utf-8"
        except UnicodeDecodeError:
            payload, encoding = base64.b64encode(message.payload).decode(), "base64"
        told = {"topic": message.topic, "payload": payload, "encoding": encoding}
        with self._lock:
            self._messages.append(told | {"qos": message.qos, "retained": message.retain})


@mcp.tool(annotations=READS)
def broker_info() -> dict[str, Any]:
    """Connect to the broker, to say whether it answers."""
    with connection():
        return {"connected": True, "endpoint": f"{HOST}:{PORT}"}


@mcp.tool(annotations=READS)
def subscribe(topic: Filter, qos: Qos = 0) -> dict[str, Any]:
    """Subscribe to a topic filter."""
    return {"topic": topic, "granted_qos": receiving.subscribe(topic, qos)}


@mcp.tool(annotations=READS)
def read_messages(topic: Filter) -> dict[str, Any]:
    """Return the messages on a topic filter that came since the last call."""
    return {"messages": receiving.take(topic)}


@mcp.tool(annotations=SENDS)
def publish(topic: Topic, payload: Payload, qos: Qos = 0, retain: Retain = False) -> dict[str, Any]:
    """Publish a message; the broker has acknowledged it (qos 1 and 2), or it went out on a living connection (qos 0)."""
    if os.environ.get("MQTT_WRITES") != "true":
        raise ToolError("writes_disabled: MQTT_WRITES is not true; nothing was sent")
    if set("+#\0") & set(topic) or len(topic.encode()) > 65535:
        raise ToolError("invalid_argument: a topic has no wildcards and 65535 bytes at most; nothing was sent")
    answers = Queue[mqtt.ReasonCode]()
    with connection() as own:
        own.on_publish = lambda _client, _data, _number, reason, _properties: answers.put(reason)
        own.publish(topic, payload, qos, retain)
        try:
            reason = answers.get(timeout=TIMEOUT_S)
        except Empty:
            raise ToolError("no_reply: the broker did not acknowledge the message; it may have it") from None
    if reason.is_failure:
        raise ToolError(f"refused: {reason}")
    return {"topic": topic, "payload": payload, "qos": qos}


if __name__ == "__main__":
    receiving = Subscriber()
    mcp.run()
