"""Tools of the MQTT tests: a broker in a thread, paho-mqtt as the independent client, and a raw socket."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import paho.mqtt.client as paho
from own_journal import OwnJournal
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions
from pytest_otmcp.mocks.journal import Journal
from pytest_otmcp.mocks.mqtt.broker import Broker, Limits
from pytest_otmcp.mocks.mqtt.connection import Connection
from pytest_otmcp.mocks.network import Network

from pytest_otmcp.protocols.mqtt.decoder import MqttConversation

PATIENCE_S = 40.0
"""Seconds that a test waits for something that must happen; each wait ends as soon as it has happened."""

T = TypeVar("T")


class RunningBroker:
    """A broker whose loop runs in a thread; problems that the loop reports are collected."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.journal = Journal()
        self._entries = OwnJournal(self.journal, MqttConversation)
        self.problems: list[dict[str, Any]] = []
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(lambda loop, context: self.problems.append(context))
        self._ahead_s, clock = 0.0, self._loop.time
        self._loop.time = lambda: clock() + self._ahead_s  # type: ignore[method-assign]
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        try:
            self.broker = self.call(lambda: Broker(self.journal, limits))
            self._server = self._run(
                self._loop.create_server(
                    Network(self.journal).protocol(lambda: Connection(self.broker)), "127.0.0.1", 0
                )
            )
        except BaseException:
            self._end()
            raise
        self.port: int = self._server.sockets[0].getsockname()[1]

    def _run(self, awaitable: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(awaitable, self._loop).result(PATIENCE_S)

    def call(self, function: Callable[[], T]) -> T:
        """Run a function on the broker's loop."""

        async def run() -> T:
            return function()

        result: T = self._run(run())
        return result

    def leap(self, seconds: float) -> None:
        """Move the loop's clock ahead; everything that is due by then has happened when this returns."""

        async def leap() -> None:
            self._ahead_s += seconds
            # The loop notes in its next turn what is due, and does it at the end of that turn.
            await asyncio.sleep(0)
            await asyncio.sleep(0)

        self._run(leap())

    def entries(self, **match: Any) -> list[Any]:
        """Return the journal entries with these fields that exist now."""
        return self.call(lambda: self._entries.since(0, **match))

    def wait(self, count: int = 1, since: int = 0, **match: Any) -> list[Any]:
        """Return the entries with these fields as soon as there are ``count``."""
        entries: list[Any] = self._run(self._entries.wait(since, match, count, PATIENCE_S - 1))
        assert len(entries) >= count, f"{match} did not happen {count} time(s)"
        return entries

    def close(self) -> None:
        """Stop; the broker must have run without a problem."""
        try:
            self.call(self._server.close)
            self._run(self.broker.aclose())
        finally:
            self._end()
        assert self.problems == []

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class Peer:
    """A paho client of a broker. Use as a context manager: leaving it cuts the connection if it still exists."""

    def __init__(
        self, port: int, client_id: str = "", *, version: int = 5, clean: bool = True, **settings: Any
    ) -> None:
        self.port, self.version, self.clean = port, version, clean
        self.client = paho.Client(
            CallbackAPIVersion.VERSION2,
            client_id,
            clean_session=None if version == 5 else clean,
            protocol=MQTTProtocolVersion.MQTTv5 if version == 5 else MQTTProtocolVersion.MQTTv311,
            reconnect_on_failure=False,
            manual_ack=settings.pop("manual_ack", False),
        )
        self.client.connect_timeout = PATIENCE_S
        self.connect_properties: dict[str, Any] = settings.pop("properties", {})
        self.keepalive: int = settings.pop("keepalive", 60)
        will = dict(settings.pop("will", {}))
        if will:
            will_properties = will.pop("properties", None)
            if will_properties is not None:
                will["properties"] = properties(PacketTypes.WILLMESSAGE, **will_properties)
            self.client.will_set(**will)
        assert not settings
        self.connacks: queue.Queue[tuple[bool, Any, Any]] = queue.Queue()
        self.received: queue.Queue[paho.MQTTMessage] = queue.Queue()
        self.subacks: queue.Queue[tuple[int, list[int]]] = queue.Queue()
        self.disconnects: queue.Queue[Any] = queue.Queue()
        self.acks: queue.Queue[tuple[int, int]] = queue.Queue()
        self.client.on_connect = lambda c, u, flags, code, p: self.connacks.put((flags.session_present, code, p))
        self.client.on_message = lambda c, u, message: self.received.put(message)
        self.client.on_subscribe = lambda c, u, mid, codes, p: self.subacks.put((mid, [one.value for one in codes]))
        self.client.on_unsubscribe = lambda c, u, mid, codes, p: self.subacks.put((mid, [one.value for one in codes]))
        self.client.on_disconnect = lambda c, u, flags, code, p: self.disconnects.put(code)
        self.client.on_publish = lambda c, u, mid, code, p: self.acks.put((mid, code.value))

    def connect(self) -> Peer:
        """Connect and wait for the CONNACK."""
        extra: dict[str, Any] = {}
        if self.version == 5:
            extra = {
                "clean_start": self.clean,
                "properties": properties(PacketTypes.CONNECT, **self.connect_properties),
            }
        self.client.connect("127.0.0.1", self.port, self.keepalive, **extra)
        self.client.loop_start()
        try:
            self.session_present, self.connack, self.connack_properties = self.connacks.get(timeout=PATIENCE_S)
        except BaseException:
            self.cut()
            raise
        return self

    def __enter__(self) -> Peer:
        return self.connect()

    def __exit__(self, *exc_info: object) -> None:
        self.disconnect()

    def disconnect(self, **fields: Any) -> None:
        """Send an orderly DISCONNECT."""
        if self.version == 5 and fields:
            code = fields.pop("reasoncode", None)
            self.client.disconnect(reasoncode=code, properties=properties(PacketTypes.DISCONNECT, **fields))
        else:
            self.client.disconnect()
        self.client.loop_stop()

    def cut(self) -> None:
        """End the network connection without DISCONNECT, unless the broker has ended it already."""
        sock = self.client.socket()
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        self.client.loop_stop()

    def subscribe(self, topic_filter: str, qos: int = 0, *, identifier: int | None = None, **options: Any) -> list[int]:
        """Subscribe and return the granted QoS or reason codes."""
        if self.version == 5:
            extra = {} if identifier is None else {"SubscriptionIdentifier": identifier}
            self.client.subscribe(
                topic_filter,
                options=SubscribeOptions(qos, **options),
                properties=properties(PacketTypes.SUBSCRIBE, **extra),
            )
        else:
            self.client.subscribe(topic_filter, qos)
        return self.subacks.get(timeout=PATIENCE_S)[1]

    def unsubscribe(self, topic_filter: str) -> list[int]:
        """Unsubscribe and return the reason codes."""
        self.client.unsubscribe(topic_filter)
        return self.subacks.get(timeout=PATIENCE_S)[1]

    def publish(self, topic: str, payload: bytes = b"", qos: int = 0, retain: bool = False, **props: Any) -> int:
        """Publish, wait for the acknowledgement, return its reason code."""
        extra = {"properties": properties(PacketTypes.PUBLISH, **props)} if self.version == 5 else {}
        self.client.publish(topic, payload, qos, retain, **extra)
        return self.acks.get(timeout=PATIENCE_S)[1]

    def next(self) -> paho.MQTTMessage:
        """Return the next message."""
        return self.received.get(timeout=PATIENCE_S)

    def payloads(self, count: int) -> list[bytes]:
        """Return the payloads of the next messages."""
        return [bytes(self.next().payload) for _ in range(count)]

    def nothing_more(self) -> bool:
        """Tell whether nothing is on its way to this client: a message that it sends itself is the next to arrive."""
        topic = f"marker/{id(self)}"
        self.subscribe(topic, 0)
        self.publish(topic, b"marker")
        return self.next().topic == topic


class Raw:
    """A socket that sends and receives bytes."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
        self._buffer = b""

    def send(self, *data: bytes) -> Raw:
        """Send bytes, all in one segment."""
        self.socket.sendall(b"".join(data))
        return self

    def _more(self) -> bool:
        try:
            data = self.socket.recv(65536)
        except ConnectionResetError:
            return False
        self._buffer += data
        return bool(data)

    def packet(self) -> tuple[int, bytes]:
        """Return the next packet: first byte and body. Bodies in these tests are shorter than 128 bytes."""
        while len(self._buffer) < 2 or len(self._buffer) < 2 + self._buffer[1]:
            assert self._more(), "the broker closed the connection"
        assert self._buffer[1] < 0x80
        end = 2 + self._buffer[1]
        packet, self._buffer = (self._buffer[0], self._buffer[2:end]), self._buffer[end:]
        return packet

    def rest(self) -> bytes:
        """Return everything that arrives until the broker closes the connection."""
        while self._more():
            pass
        return self._buffer

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()

    def __enter__(self) -> Raw:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def properties(packet: int, **values: Any) -> Properties:
    """Return paho's properties; a list sets a property several times."""
    made = Properties(packet)
    for name, value in values.items():
        for one in value if isinstance(value, list) else [value]:
            setattr(made, name, one)
    return made


def utf8(text: str) -> bytes:
    """Return a UTF-8 Encoded String."""
    data = text.encode()
    return bytes([len(data) >> 8, len(data) & 0xFF]) + data


def frame(first: int, *parts: bytes) -> bytes:
    """Return a packet with a body shorter than 128 bytes."""
    body = b"".join(parts)
    assert len(body) < 0x80
    return bytes([first, len(body)]) + body


def connect_bytes(
    client_id: str = "raw", level: int = 4, flags: int = 2, tail: bytes = b"", props: bytes = b"\0"
) -> bytes:
    """Return a CONNECT with keep-alive 0."""
    return frame(0x10, utf8("MQTT"), bytes([level, flags, 0, 0]), props if level == 5 else b"", utf8(client_id), tail)


@contextmanager
def running_broker(limits: Limits | None = None) -> Iterator[RunningBroker]:
    """Run a broker for the length of a ``with``."""
    broker = RunningBroker(limits)
    try:
        yield broker
    finally:
        broker.close()
