"""The MQTT reference adapter against the mock broker: its replies, the broker's journal, another client's messages."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import base64
import json
import queue
import threading
from collections.abc import Iterator
from typing import Any

import paho.mqtt.client as paho
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from pytest_otmcp.reference_adapters.mqtt.topics import matches

from .cases import MQTT
from .conftest import PATIENCE_S

CASE = MQTT
CLIENT, GUARDED = "mqtt-tests-rw", "mqtt-tests-ro"


class Peer:
    """Another client of the broker."""

    def __init__(self, port: int) -> None:
        self.received: queue.Queue[paho.MQTTMessage] = queue.Queue()
        self._granted: queue.Queue[int] = queue.Queue()
        self.client = paho.Client(CallbackAPIVersion.VERSION2, "mqtt-tests-peer", protocol=paho.MQTTv311)
        connected = threading.Event()
        self.client.on_connect = lambda c, u, flags, reason, p: connected.set()
        self.client.on_message = lambda c, u, message: self.received.put(message)
        self.client.on_subscribe = lambda c, u, mid, codes, p: self._granted.put(codes[0].value)
        self.client.connect_timeout = PATIENCE_S
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        assert connected.wait(PATIENCE_S)

    def subscribe(self, text: str, qos: int = 2) -> None:
        self.client.subscribe(text, qos)
        assert self._granted.get(timeout=PATIENCE_S) == qos

    def next(self) -> paho.MQTTMessage:
        return self.received.get(timeout=PATIENCE_S)

    def publish(self, topic: str, payload: bytes, qos: int = 1, retain: bool = False) -> None:
        """Publish; return when the broker has received this message and all that were published before it."""
        sent = self.client.publish(topic, payload, qos, retain)
        sent.wait_for_publish(60.0)
        # paho does not report that the time has run out.
        assert sent.is_published()

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture(scope="module")
def broker(rig: Any) -> Any:
    return rig.device


@pytest.fixture(scope="module")
def guarded(rig: Any) -> Any:
    return rig.guarded


@pytest.fixture(autouse=True)
def clean(broker: Any) -> None:
    broker("reset")


@pytest.fixture
def peer(broker: Any) -> Iterator[Peer]:
    peer = Peer(broker.port)
    yield peer
    peer.close()


def from_adapter(broker: Any, mark: int, *kinds: str, client: str = CLIENT) -> list[dict[str, Any]]:
    """Return the packets that the adapter sent since the mark."""
    entries = broker.since(mark, direction="in", client_id=client)
    return [entry for entry in entries if not kinds or entry["kind"] in kinds]


def drained(adapter: Any, topic: str) -> dict[str, Any]:
    """Return the messages that the adapter has received on a filter, after the broker has delivered everything."""
    adapter.call("get_broker_info")
    data: dict[str, Any] = adapter.call("read_messages", topic=topic, limit=1000).data
    return data


# -- the surface ---------------------------------------------------------------------------------------------


def test_there_are_the_fifteen_tools_of_the_paper_and_two_that_read_messages_and_metrics(adapter: Any) -> None:
    assert len(adapter.tools) == 17


def test_broker_info_asks_the_broker_every_time(adapter: Any, broker: Any) -> None:
    adapter.call("get_broker_info")
    for _ in range(3):
        mark = broker.mark()
        reply = adapter.call("get_broker_info")
        assert reply.data["connected"] is True
        assert (reply.data["endpoint"], reply.data["client_id"]) == (f"mqtt://127.0.0.1:{broker.port}", CLIENT)
        assert (reply.meta["source"], reply.meta["attempts"]) == ("device", 1)
        (request,) = from_adapter(broker, mark)
        (answer,) = broker.since(mark, direction="out", client_id=CLIENT)
        assert (request["kind"], answer["kind"]) == ("UNSUBSCRIBE", "UNSUBACK")


# -- the write guard -----------------------------------------------------------------------------------------


def test_a_guarded_adapter_leaves_no_will_that_would_be_published_for_it(
    adapter: Any, guarded: Any, broker: Any
) -> None:
    for subject, client, armed in ((adapter, CLIENT, True), (guarded, GUARDED, False)):
        subject.call("get_broker_info")
        connects = from_adapter(broker, 0, "CONNECT", client=client)
        assert connects
        assert all((connect["will"] is not None) is armed for connect in connects)


# -- publishing ----------------------------------------------------------------------------------------------

PAYLOADS = {
    "text": ("23.5 °C\n", "utf-8", "23.5 °C\n".encode()),
    "json": ('{"pump_speed": 50}', "utf-8", b'{"pump_speed": 50}'),
    "binary": (base64.b64encode(bytes(range(256))).decode(), "base64", bytes(range(256))),
    "empty": ("", "utf-8", b""),
    "large": ("x" * 262_144, "utf-8", b"x" * 262_144),
}


@pytest.mark.parametrize("retain", [False, True])
@pytest.mark.parametrize("qos", [0, 1, 2])
@pytest.mark.parametrize("kind", PAYLOADS)
def test_a_message_is_published_once_as_it_was_given(
    adapter: Any, broker: Any, peer: Peer, qos: int, retain: bool, kind: str
) -> None:
    text, encoding, data = PAYLOADS[kind]
    peer.subscribe("plain/#")
    adapter.call("get_broker_info")
    mark = broker.mark()
    reply = adapter.call(
        "publish_message", topic="plain/a b/ü", payload=text, encoding=encoding, qos=qos, retain=retain
    )
    seen = peer.next()
    assert (seen.topic, seen.payload, seen.qos) == ("plain/a b/ü", data, qos)
    delivery = "acknowledged" if qos else "unacknowledged"
    expected = {"topic": "plain/a b/ü", "qos": qos, "retain": retain, "payload_bytes": len(data), "delivery": delivery}
    assert reply.data == expected
    (packet,) = from_adapter(broker, mark, "PUBLISH")
    told = {name: packet[name] for name in ("topic", "qos", "retain", "packet_id", "dup")}
    assert told == {
        "topic": "plain/a b/ü",
        "qos": qos,
        "retain": retain,
        "dup": False,
        "packet_id": reply.meta["trace"].get("packet_id"),
    }
    assert base64.b64decode(packet["payload"]) == data
    assert (reply.meta["attempts"], reply.meta["source"]) == (1, "device" if qos else "none")
    handshake = {0: [], 1: ["PUBACK"], 2: ["PUBREC", "PUBCOMP"]}[qos]
    # The adapter read the broker's last packet (for QoS 2 PUBCOMP) before it replied, so it is in the journal.
    # A keep-alive may fall into that time, and does not concern the message.
    answers = broker.since(mark, direction="out", client_id=CLIENT)
    assert [entry["kind"] for entry in answers if entry["kind"] not in ("PUBLISH", "PINGRESP")] == handshake


def test_parallel_messages_arrive_once_each(adapter: Any, broker: Any) -> None:
    mark = broker.mark()
    ids = [adapter.start("publish_message", {"topic": f"many/{i}", "payload": str(i), "qos": i % 3}) for i in range(90)]
    assert all(adapter.reply("publish_message", one).envelope["success"] for one in ids)
    adapter.call("get_broker_info")
    seen = [entry["topic"] for entry in from_adapter(broker, mark, "PUBLISH")]
    assert seen == [f"many/{i}" for i in range(90)]


# -- receiving -----------------------------------------------------------------------------------------------


def test_messages_of_a_wildcard_subscription_keep_their_topics_and_their_order(adapter: Any, peer: Peer) -> None:
    granted = adapter.call("subscribe_topic", topic="sensors/+/raw", qos=1)
    assert granted.data == {"topic": "sensors/+/raw", "qos": 1, "granted_qos": 1}
    assert granted.meta["trace"] == {"topic": "sensors/+/raw", "qos": 1, "granted_qos": 1}
    for number in range(30):
        peer.publish(f"sensors/{number % 3}/raw", str(number).encode(), qos=number % 3)
    peer.publish("sensors/0/cooked", b"no")
    messages = drained(adapter, "sensors/1/+")["messages"]
    assert [(one["topic"], int(one["payload"])) for one in messages] == [
        ("sensors/1/raw", number) for number in range(1, 30, 3)
    ]
    messages = drained(adapter, "#")["messages"]
    assert [int(one["payload"]) for one in messages] == [number for number in range(30) if number % 3 != 1]
    assert {one["qos"] for one in messages} == {0, 1}
    assert drained(adapter, "#")["messages"] == []
    adapter.call("unsubscribe_topic", topic="sensors/+/raw")


@pytest.mark.parametrize(
    ("data", "encoding", "payload"),
    [
        (b'{"pump_speed": 50}', "utf-8", '{"pump_speed": 50}'),
        ("líne\r\n\t\u00a0€".encode(), "utf-8", "líne\r\n\t\u00a0€"),
        (b"", "utf-8", ""),
        (b"\xff\xfe", "base64", "//4="),
        (b"\x1b[31mred", "base64", base64.b64encode(b"\x1b[31mred").decode()),
        ("\u202eevil\u200b".encode(), "base64", base64.b64encode("\u202eevil\u200b".encode()).decode()),
    ],
)
def test_a_payload_is_text_where_it_is_harmless_and_base64_where_it_is_not(
    adapter: Any, peer: Peer, data: bytes, encoding: str, payload: str
) -> None:
    adapter.call("subscribe_topic", topic="texts/#")
    peer.publish("texts/one", data)
    adapter.call("get_broker_info")
    reply = adapter.call("read_messages", topic="texts/#")
    (message,) = reply.data["messages"]
    assert (message["encoding"], message["payload"]) == (encoding, payload)
    assert set(reply.meta["untrusted"]) == {"/data/messages/0/topic", "/data/messages/0/payload"}
    assert reply.meta["source"] == "cache"
    assert 0 <= reply.meta["age_ms"] < 60_000
    assert message["received_at"].endswith("Z")


def test_retained_messages_are_flagged(adapter: Any, peer: Peer) -> None:
    peer.publish("kept/one", b"old", retain=True)
    adapter.call("subscribe_topic", topic="kept/#")
    peer.publish("kept/two", b"new")
    assert [one["retain"] for one in drained(adapter, "kept/#")["messages"]] == [True, False]


def test_more_than_was_asked_for_is_told(adapter: Any, peer: Peer) -> None:
    adapter.call("subscribe_topic", topic="counted/#")
    for number in range(5):
        peer.publish("counted/one", str(number).encode())
    adapter.call("get_broker_info")
    reply = adapter.call("read_messages", topic="counted/#", limit=3)
    assert [one["payload"] for one in reply.data["messages"]] == ["0", "1", "2"]
    assert reply.meta["truncated"] == {"returned": 3, "total": 5}
    reply = adapter.call("read_messages", topic="counted/#", limit=3)
    assert [one["payload"] for one in reply.data["messages"]] == ["3", "4"]
    assert "truncated" not in reply.meta


def test_a_flood_pushes_out_the_oldest_and_the_loss_is_told_once(adapter: Any, peer: Peer) -> None:
    sent, kept = 5201, 5000
    adapter.call("subscribe_topic", topic="flood/#", qos=1)
    drained(adapter, "#")
    for number in range(sent - 1):
        peer.client.publish("flood/one", str(number), 1)
    peer.publish("flood/one", str(sent - 1).encode())
    first = drained(adapter, "flood/one")
    assert first["dropped"] == sent - kept
    assert first["messages"][0]["payload"] == str(first["dropped"])
    numbers = [int(one["payload"]) for one in first["messages"]]
    while messages := (again := drained(adapter, "flood/one"))["messages"]:
        assert again["dropped"] == 0
        numbers += [int(one["payload"]) for one in messages]
    assert numbers == list(range(sent - kept, sent))
    adapter.call("unsubscribe_topic", topic="flood/#")


def test_one_answer_carries_no_more_than_four_megabytes(adapter: Any, peer: Peer) -> None:
    adapter.call("subscribe_topic", topic="big/#", qos=1)
    for number in range(3):
        peer.publish(f"big/{number}", b"x" * 2_000_000)
    adapter.call("get_broker_info")
    reply = adapter.call("read_messages", topic="big/#")
    assert [one["topic"] for one in reply.data["messages"]] == ["big/0", "big/1"]
    assert reply.meta["truncated"] == {"returned": 2, "total": 3}
    assert [one["topic"] for one in drained(adapter, "big/#")["messages"]] == ["big/2"]
    adapter.call("unsubscribe_topic", topic="big/#")


def test_nothing_is_received_after_the_end_of_a_subscription(adapter: Any, broker: Any, peer: Peer) -> None:
    adapter.call("subscribe_topic", topic="ended/#")
    assert adapter.call("unsubscribe_topic", topic="ended/#").data == {"topic": "ended/#"}
    mark = broker.mark()
    peer.publish("ended/one", b"x")
    assert drained(adapter, "#")["messages"] == []
    assert broker.since(mark, kind="PUBLISH", direction="out", client_id=CLIENT) == []
    listed = adapter.call("list_subscriptions").data["subscriptions"]
    assert "ended/#" not in [one["topic"] for one in listed]


@pytest.mark.parametrize("code", [0, 1, 2])
def test_the_granted_qos_is_the_brokers(adapter: Any, broker: Any, code: int) -> None:
    broker.fault({"packet": "SUBSCRIBE", "client_id": CLIENT, "action": {"reason_code": code}})
    reply = adapter.call("subscribe_topic", topic="granted/x", qos=2)
    assert reply.data["granted_qos"] == code
    assert reply.meta["trace"] == {"topic": "granted/x", "qos": 2, "granted_qos": code}
    listed = adapter.call("list_subscriptions").data["subscriptions"]
    assert {"topic": "granted/x", "qos": 2, "granted_qos": code, "active": True} in listed
    adapter.call("unsubscribe_topic", topic="granted/x")


def test_a_refused_subscription_is_a_failure_and_not_listed(adapter: Any, broker: Any) -> None:
    broker.fault({"packet": "SUBSCRIBE", "client_id": CLIENT, "action": {"reason_code": 0x80}})
    reply = adapter.call("subscribe_topic", topic="denied/x")
    assert (reply.error["code"], reply.error["class"]) == ("access_denied", "device")
    assert reply.meta["trace"] == {"topic": "denied/x", "qos": 0, "reason_code": 0x80}
    listed = adapter.call("list_subscriptions").data["subscriptions"]
    assert "denied/x" not in [one["topic"] for one in listed]


# -- topics and credentials -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "topic", "selected"),
    [
        ("a/b", "a/b", True),
        ("a/b", "a/B", False),
        ("#", "a/b", True),
        ("a/#", "a", True),
        ("a/#", "a/b/c", True),
        ("a/#", "ab", False),
        ("+/b", "/b", True),
        ("a/+", "a/", True),
        ("a/+", "a", False),
        ("+", "a/b", False),
        ("+/+", "/a", True),
        ("#", "$SYS/x", False),
        ("+/x", "$SYS/x", False),
        ("$SYS/#", "$SYS/x", True),
    ],
)
def test_filters_select_as_section_4_7_has_it(text: str, topic: str, selected: bool) -> None:
    assert matches(text, topic) is selected


def test_credentials_are_sent_and_never_shown(rig: Any, broker: Any) -> None:
    mark = broker.mark()
    secret = {"MQTT_CLIENT_ID": "login", "MQTT_USERNAME": "operator", "MQTT_PASSWORD": "canary-7f3a"}
    fresh = rig.start("login", **secret)
    info = fresh.call("get_broker_info")
    (connect,) = from_adapter(broker, mark, "CONNECT", client="login")
    assert connect["username"] == "operator"
    assert "canary" not in json.dumps(info.envelope)
    fresh.close()
    assert b"canary" not in fresh.stderr
