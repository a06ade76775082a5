"""Honest MQTT adapters."""

from __future__ import annotations

import asyncio
import dataclasses
import hashlib
import json
import os
import secrets
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call, Lost
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap
from pytest_otmcp.reference_adapters.defects.host_application import beside
from pytest_otmcp.reference_adapters.mqtt import connection as connections
from pytest_otmcp.reference_adapters.mqtt import edge_node as edge_nodes
from pytest_otmcp.reference_adapters.mqtt import payload as sparkplug
from pytest_otmcp.reference_adapters.mqtt import tools as tools_module
from pytest_otmcp.reference_adapters.mqtt.connection import Connection, Message
from pytest_otmcp.reference_adapters.mqtt.edge_node import EdgeNode, Life
from pytest_otmcp.reference_adapters.mqtt.link import Link
from pytest_otmcp.reference_adapters.mqtt.payload import Metric
from pytest_otmcp.reference_adapters.mqtt.tools import Tools, _number
from pytest_otmcp.reference_adapters.mqtt.tools import _payload as payload_of
from pytest_otmcp.reference_adapters.mqtt.topics import check_name

from pytest_otmcp.wire.mqtt.sparkplug import payload_class

from .choice import Change, backed_off, choices, in_background, narrowed

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter

__all__ = ["CHOICES"]

CHOICES, choice = choices("mqtt")

OWN_TOPIC = "acme/adapter-7/status"
RETAINED = ("WR-004", "retained_own")
MAX_AGE_S = 1.0
READ_EVERY_S = 0.05


def tools_of(server: AdapterServer) -> Tools:
    tools: Tools = server._tools["get_broker_info"].handler.__self__
    return tools


def link_of(server: AdapterServer) -> Link:
    return tools_of(server)._link


def background_call(server: AdapterServer) -> Call:
    return Call(protocol="mqtt", operation="mqtt.watch", endpoint=server.endpoint, writes=False)


# -- what it publishes of itself --------------------------------------------------------------------------------------


def telling(seconds: float) -> Change:
    def apply(server: AdapterServer) -> None:
        link = link_of(server)

        async def tell() -> None:
            await asyncio.sleep(seconds)
            if link.connected:
                with suppress(Lost):
                    link._connection.send(Message(topic=OWN_TOPIC, payload=b'{"alive": true}'))

        in_background(server, tell)

    return apply


@choice("tells of itself on a topic of its own ten times a second", "it commands nothing")
def status_ten_times_a_second(server: AdapterServer) -> None:
    telling(0.1)(server)


@choice("tells of itself on a topic of its own a hundred times a second", "it commands nothing")
def status_a_hundred_times_a_second(server: AdapterServer) -> None:
    telling(0.01)(server)


def after_connecting(link: Link, then: Callable[[Connection], None]) -> None:
    genuine = link._connect

    async def connect() -> Connection:
        connection = await genuine()
        then(connection)
        return connection

    link._connect = connect


def say_online(connection: Connection) -> None:
    with suppress(Lost):
        connection.send(Message(topic=OWN_TOPIC, payload=b"online", retain=True))


@choice(
    'publishes a retained "online" at every connection, also with writes disabled',
    "it commands nothing; with writes disabled it is remarkable",
    warnings=(RETAINED,),
)
def retained_online(server: AdapterServer) -> None:
    after_connecting(link_of(server), say_online)


@choice('publishes a retained "online" at every connection, but not with writes disabled', "it commands nothing")
def retained_online_unless_guarded(server: AdapterServer) -> None:
    if server.writes_enabled:
        after_connecting(link_of(server), say_online)


UPTIME = Metric(name="uptime", datatype="Int64", value=0)


@choice(
    "reports data of its edge node by itself, ten times a second",
    "Sparkplug: an edge node publishes NDATA when it has any",
)
def node_data_of_its_own(server: AdapterServer) -> None:
    link = link_of(server)
    node = link.edge_node
    birth = server._tools["publish_node_birth"]

    def born_before(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if not node.alive:
                await server._tools["publish_node_birth"].handler(call, birth.model(metrics=[]))
            return await genuine(call, arguments)

        return handler

    async def report() -> None:
        await asyncio.sleep(0.1)
        async with link.publishing:
            if link.connected and node.alive:
                with suppress(Lost):
                    link._connection.send(node.numbered("NDATA", None, [UPTIME]))

    def declaring_uptime(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            (uptime,) = birth.model(metrics=[{"name": "uptime", "datatype": "Int64", "value": 0}]).metrics
            return await genuine(call, arguments.model_copy(update={"metrics": [*arguments.metrics, uptime]}))

        return handler

    wrap(server, "publish_node_birth", declaring_uptime)
    wrap(server, "publish_device_birth", born_before)
    in_background(server, report)


@choice("is born again before it reports data", "Sparkplug: births may be repeated")
def births_repeated(server: AdapterServer) -> None:
    link = link_of(server)

    def born_again(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            await link._be_born_again()
            return await genuine(call, arguments)

        return handler

    wrap(server, "publish_device_data", born_again)


@choice("is born as an edge node as soon as it is connected", "Sparkplug: an edge node is born when it connects")
def born_when_connected(server: AdapterServer) -> None:
    if server.writes_enabled:
        link_of(server).edge_node.life = Life()


@choice(
    "reports its data by the aliases that its births declare, without names and data types",
    "Sparkplug: where a birth has aliases, data have the alias and no name",
)
def data_by_alias_alone(server: AdapterServer) -> None:
    node = link_of(server).edge_node
    genuine, aliases = node.numbered, dict[tuple[str | None, str], int]()

    def numbered(kind: str, device: str | None, metrics: Any) -> Message:
        message = genuine(kind, device, metrics)
        payload = sparkplug._Payload.FromString(message.payload)
        for metric in payload.metrics:
            if metric.name not in ("bdSeq", sparkplug.REBIRTH):
                metric.alias = aliases.setdefault((device, metric.name), len(aliases) + 1)
                if kind.endswith("DATA"):
                    metric.ClearField("name")
                    metric.ClearField("datatype")
        return dataclasses.replace(message, payload=payload.SerializeToString())

    node.numbered = numbered


@choice("gives every payload as base64, and says so", "its subject file binds the encodings of messages")
def every_payload_as_base64(server: AdapterServer) -> None:
    tools_module._harmless_text = lambda data: None


@choice(
    "publishes payloads of at most 200 characters, with QoS 0 or 1",
    "its schema says so: a smaller maximum is the author's choice",
)
def short_payloads(server: AdapterServer) -> None:
    narrowed(server, "publish_message", "payload", "maxLength", 200)
    narrowed(server, "publish_message", "qos", "maximum", 1)


@choice("takes a payload with its encoding alone", "its schema requires it, and its subject file binds it")
def encoding_required(server: AdapterServer) -> None:
    listing = server._tools["publish_message"].listing
    schema = {**listing.input_schema, "required": [*listing.input_schema["required"], "encoding"]}

    def insisting(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if "encoding" not in arguments.model_fields_set:
                raise AdapterError("invalid_input", "encoding is required", outcome="not_sent", field="/encoding")
            return await genuine(call, arguments)

        return handler

    wrap(server, "publish_message", insisting, listing=listing.model_copy(update={"input_schema": schema}))


# -- connections ------------------------------------------------------------------------------------------------------


@choice("has another client identifier at every connection", "the identifier is the client's own affair")
def new_client_identifiers(server: AdapterServer) -> None:
    link = link_of(server)
    genuine = link._connect

    async def connect() -> Connection:
        link.endpoint = dataclasses.replace(link.endpoint, client_id=f"acme-{secrets.token_hex(4)}")
        return await genuine()

    link._connect = connect


def without_tls(adapter: Adapter) -> Adapter:
    """Return a description without the launch over TLS, which the second connection does not have."""
    variants = {name: one for name, one in adapter.variants.items() if name != "secure"}
    return dataclasses.replace(adapter, variants=variants)


@choice(
    "is a Sparkplug host application over a second connection: tells its STATE, and asks nodes that it does not know for their births",
    "tck-id-intro-sparkplug-host-state, tck-id-operational-behavior-host-reordering-rebirth",
    described=without_tls,
)
def host_application(server: AdapterServer) -> None:
    beside()(server)


@choice("subscribes to # from the start", "reading changes nothing")
def subscribed_to_everything(server: AdapterServer) -> None:
    link_of(server).needed["#"] = 0


@choice("subscribes to the broker's own topics", "reading changes nothing")
def subscribed_to_the_broker(server: AdapterServer) -> None:
    link_of(server).needed["$SYS/#"] = 0


@choice(
    "tries to connect again a second after it has failed", "requirement REC-001: back within recovery_s, by default 5 s"
)
def backs_off_for_1_s(server: AdapterServer) -> None:
    link = link_of(server)
    link._connected = backed_off(link._connected, 1.0)


def second_link(link: Link) -> Link:
    endpoint = dataclasses.replace(link.endpoint, client_id=f"{link.endpoint.client_id}-publisher")
    return Link(endpoint, EdgeNode("factory", "publisher"), may_write=False)


@choice(
    "tells on a topic of its own which publications have failed, with their payloads, when the broker is back",
    "it commands nothing, and tells that it was not done",
)
def audited_failures(server: AdapterServer) -> None:
    failed: list[dict[str, Any]] = []

    def tell(connection: Connection) -> None:
        while failed:
            connection.send(Message(topic=f"{OWN_TOPIC}/audit", payload=json.dumps(failed.pop()).encode()))

    def noting(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            try:
                return await genuine(call, arguments)
            except AdapterError as error:
                if error.code in ("connect_failed", "connection_lost"):
                    failed.append({"topic": arguments.topic, "payload": arguments.payload, "error": error.code})
                raise

        return handler

    after_connecting(link_of(server), tell)
    wrap(server, "publish_message", noting)


@choice("publishes over a second connection", "a connection is the adapter's own affair")
def connection_for_publishing(server: AdapterServer) -> None:
    publisher = second_link(link_of(server))
    wrap(server, "publish_message", lambda genuine: Tools(publisher).publish_message)
    close = server._close

    async def close_both() -> None:
        await close()
        await publisher.close()

    server._close = close_both


@choice("makes a connection for every publication", "a connection is the adapter's own affair")
def connection_per_publication(server: AdapterServer) -> None:
    link, alone = link_of(server), asyncio.Lock()

    async def publish(call: Call, arguments: Any) -> Any:
        async with alone:
            publisher = second_link(link)
            try:
                return await Tools(publisher).publish_message(call, arguments)
            finally:
                await publisher.close()

    wrap(server, "publish_message", lambda genuine: publish)


@choice("speaks MQTT 3.1.1", "the broker speaks both")
def mqtt_311(server: AdapterServer) -> None:
    link = link_of(server)
    link.endpoint = replace(link.endpoint, version="3.1.1")


# -- status -----------------------------------------------------------------------------------------------------------


async def ping(connection: Connection) -> None:
    """Send a PINGREQ and wait for the PINGRESP."""
    answered: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    genuine = connection._client._handle_pingresp

    def handle() -> Any:
        if not answered.done():
            answered.set_result(None)
        return genuine()

    connection._client._handle_pingresp = handle
    connection._client._send_pingreq()
    connection._flush()
    lost = asyncio.ensure_future(connection.lost.wait())
    done, _ = await asyncio.wait({answered, lost}, timeout=2.0, return_when=asyncio.FIRST_COMPLETED)
    lost.cancel()
    if answered not in done:
        connection.abort()
        raise Lost


@choice("asks for the broker's state by PINGREQ", "any answer of the broker is one")
def status_by_ping(server: AdapterServer) -> None:
    link, alone = link_of(server), asyncio.Lock()

    async def ask(call: Call) -> None:
        async with alone:
            await link.exchange(call, ping)

    link.ask = ask


@choice("asks twice for the broker's state", "asking changes nothing; meta.attempts says so")
def status_asked_twice(server: AdapterServer) -> None:
    link = link_of(server)
    genuine = link.ask

    async def ask(call: Call) -> None:
        await genuine(call)
        await genuine(call)

    link.ask = ask


@choice(
    "asks for the broker's state over a connection of its own; reads what came over the other one every 50 ms",
    "asking changes nothing; MQTT says nothing of when a client reads",
)
def status_by_connecting(server: AdapterServer) -> None:
    link, alone = link_of(server), asyncio.Lock()

    def asked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if not link.connected:
                return await genuine(call, arguments)
            async with alone:
                asking = second_link(link)
                try:
                    await asking.ask(call)
                finally:
                    await asking.close()
            return state_of(link)

        return handler

    wrap(server, "get_broker_info", asked)
    read_in_batches(link)


def state_of(link: Link) -> dict[str, Any]:
    """What ``get_broker_info`` tells of a link that is connected."""
    return {
        "connected": True,
        "endpoint": link.endpoint.uri,
        "client_id": link.endpoint.client_id,
        "protocol_version": "3.1.1",
        "subscriptions": len(link.subscriptions),
    }


def declared_as_cached(adapter: Adapter) -> Adapter:
    (info,) = adapter.operations["info"]
    operations = {**adapter.operations, "info": (dataclasses.replace(info, max_age_s=MAX_AGE_S),)}
    return dataclasses.replace(adapter, operations=operations)


@choice(
    "answers its status from what it learned by a ping at most a second ago, says so, and declares it; reads what came "
    "every 50 ms",
    'requirements REC-002 and RD-004: source = "cache" and max_age_s in the subject file, source and age_ms in meta',
    described=declared_as_cached,
)
def status_from_a_declared_cache(server: AdapterServer) -> None:
    link = link_of(server)
    learned = [-MAX_AGE_S]

    def now() -> float:
        return asyncio.get_running_loop().time()

    async def watch() -> None:
        await asyncio.sleep(0.2)
        if link.connected:
            # What is learned is as old as the question: when the broker answered, nobody but the broker knows.
            asked = now()
            await link.ask(background_call(server))
            learned[0] = asked
        else:
            learned[0] = -MAX_AGE_S

    def remembered(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            age_s = now() - learned[0]
            if age_s < 0.9 * MAX_AGE_S and link.connected:
                call.source, call.extra["age_ms"] = "cache", round(1000 * age_s, 3)
                return state_of(link)
            asked = now()
            data = await genuine(call, arguments)
            learned[0] = asked
            return data

        return handler

    wrap(server, "get_broker_info", remembered)
    in_background(server, watch)
    read_in_batches(link)


def read_in_batches(link: Link) -> None:
    """Let the link's own connection wait a moment for more before it reads."""
    read = connections.Connection._read

    def later(connection: Connection) -> None:
        if connection is not link._connection:
            read(connection)
            return
        connection._loop.remove_reader(connection._descriptor)
        connection._loop.call_later(READ_EVERY_S, now, connection)

    def now(connection: Connection) -> None:
        while connection._socket() is not None and connection._poll.poll(0):
            read(connection)
        if connection._socket() is not None:
            connection._loop.add_reader(connection._descriptor, connection._read)

    connections.Connection._read = later


# -- publishing -------------------------------------------------------------------------------------------------------


def takes_no_qos(adapter: Adapter) -> Adapter:
    (publish,) = adapter.operations["publish"]
    arguments = {name: value for name, value in publish.arguments.items() if name != "qos"}
    operations = {**adapter.operations, "publish": (dataclasses.replace(publish, arguments=arguments),)}
    unclaimed = {**adapter.unclaimed, "publish.qos": "always publishes with QoS 1"}
    return dataclasses.replace(adapter, operations=operations, unclaimed=unclaimed)


@choice("always publishes with QoS 1", "its tool takes no QoS, as its subject file says", described=takes_no_qos)
def always_qos_1(server: AdapterServer) -> None:
    def surely(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            return await genuine(call, arguments.model_copy(update={"qos": 1}))

        return handler

    wrap(server, "publish_message", surely)


class Publisher:
    """A client of its own that keeps its session and delivers again what was not acknowledged (MQTT 3.1.1, section 4.4)."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        self._packet_id = 0
        self._alone = asyncio.Lock()

    async def publish(self, call: Call, topic: str, payload: bytes, *, retain: bool) -> None:
        async with self._alone:
            self._packet_id = self._packet_id % 65535 + 1
            reader, writer = await self._connect()
            call.sending()
            # The connection breaks before the acknowledgement is there.
            writer.write(self._message(topic, payload, retain=retain, dup=False))
            writer.close()
            reader, writer = await self._connect()
            call.sending()
            writer.write(self._message(topic, payload, retain=retain, dup=True))
            try:
                await reader.readexactly(4)
            except (OSError, asyncio.IncompleteReadError):
                raise AdapterError("connection_lost", "the connection broke again") from None
            writer.write(b"\xe0\x00")
            writer.close()
            call.trace.update(topic=topic, qos=1, retain=retain)
            call.answered(packet_id=self._packet_id, delivery="acknowledged")

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        name = b"acme-publisher"
        body = b"\x00\x04MQTT\x04\x00\x00\x05" + struct.pack(">H", len(name)) + name
        try:
            reader, writer = await asyncio.open_connection(self._host, self._port)
            writer.write(bytes((0x10, len(body))) + body)
            await reader.readexactly(4)
        except (OSError, asyncio.IncompleteReadError):
            raise AdapterError("connect_failed", "no connection to the broker", outcome="not_sent") from None
        return reader, writer

    def _message(self, topic: str, payload: bytes, *, retain: bool, dup: bool) -> bytes:
        name = topic.encode()
        body = struct.pack(">H", len(name)) + name + struct.pack(">H", self._packet_id) + payload
        return bytes((0x32 | (8 if dup else 0) | retain,)) + remaining_length(len(body)) + body


def remaining_length(length: int) -> bytes:
    """Encode a Remaining Length (MQTT 3.1.1, section 2.2.3)."""
    encoded = bytearray()
    while length >= 128:
        encoded.append(length % 128 | 128)
        length //= 128
    return bytes((*encoded, length))


@choice(
    "delivers with QoS 1 again, marked as DUP, what was not acknowledged when its connection broke",
    "MQTT 3.1.1, sections 3.3.1.1 and 4.4",
    described=takes_no_qos,
)
def delivers_again_with_dup(server: AdapterServer) -> None:
    endpoint = link_of(server).endpoint
    publisher = Publisher(endpoint.host, endpoint.port)

    def outgoing(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            check_name(arguments.topic)
            payload = payload_of(arguments.payload, arguments.encoding)
            call.changes((arguments.topic, _number(payload)))
            await publisher.publish(call, arguments.topic, payload, retain=arguments.retain)
            return {
                "topic": arguments.topic,
                "qos": 1,
                "retain": arguments.retain,
                "payload_bytes": len(payload),
                "delivery": "acknowledged",
            }

        return handler

    wrap(server, "publish_message", outgoing)


# -- the times that an edge node tells --------------------------------------------------------------------------------


CAPTURED = "Sparkplug 3.0, section 6.4.5: a metric's time is when its value was captured"


def retold(change: Callable[[Any], None]) -> None:
    """Change each metric of the edge node's payloads before it is published."""
    genuine = edge_nodes.encode

    def encode(metrics: Any, seq: int | None) -> bytes:
        payload = payload_class()()
        payload.ParseFromString(genuine(metrics, seq))
        for metric in payload.metrics:
            change(metric)
        data: bytes = payload.SerializeToString()
        return data

    edge_nodes.encode = encode


@choice("gives each metric the time at which its value was captured, an hour ago", CAPTURED)
def values_captured_an_hour_ago(server: AdapterServer) -> None:
    def earlier(metric: Any) -> None:
        metric.timestamp -= 3_600_000

    retold(earlier)


@choice("gives no metric a time of its own", "Sparkplug 3.0, section 6.4.5: the payload has one")
def metrics_without_a_time(server: AdapterServer) -> None:
    retold(lambda metric: metric.ClearField("timestamp"))


@choice("marks values from its store, more than a year old, as historical", CAPTURED)
def values_from_a_store(server: AdapterServer) -> None:
    def stored(metric: Any) -> None:
        metric.timestamp -= 400 * 86_400_000
        metric.is_historical = True

    retold(stored)


# -- tools -----------------------------------------------------------------------------------------------------------


@choice(
    "says of the tools that publish that they are not destructive", "ToolAnnotations: a message that is sent only adds"
)
def publishing_only_adds(server: AdapterServer) -> None:
    for name in ("publish_message", "publish_device_data", "publish_node_data"):
        annotations = server._tools[name].listing.annotations
        assert annotations is not None
        annotations.destructive_hint = False


# -- secrets ----------------------------------------------------------------------------------------------------------


@choice(
    "logs its account with a masked password and a fingerprint of it, and names the variables that it was given",
    "a name, a mask and a digest are no secret",
)
def says_which_settings_it_has(server: AdapterServer) -> None:
    password = os.environ["MQTT_PASSWORD"]
    fingerprint = hashlib.sha256(password.encode()).hexdigest()[:16]
    print(f"account {os.environ['MQTT_USERNAME']}:{password[:3]}***** ({fingerprint})", file=sys.stderr)
    print("set: " + ", ".join(sorted(os.environ)), file=sys.stderr)


@choice("hands its password to a helper by the environment and a pipe", "what only the helper can read is not told")
def helper_with_the_password(server: AdapterServer) -> None:
    waiting = "import sys; sys.stdin.read()"
    helper = subprocess.Popen([sys.executable, "-S", "-c", waiting], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    assert helper.stdin is not None
    helper.stdin.write(os.environ["MQTT_PASSWORD"].encode())
    helper.stdin.flush()
    # The helper ends when the adapter does, whose end closes the pipe.
    server.helper = helper  # type: ignore[attr-defined]
