"""The broker as seen on the wire: its refusals, its journal, its fault plan. Raw bytes on both sides."""

from __future__ import annotations

import base64
import random
from collections.abc import Iterator

import pytest
from mqtt_tools import Peer, Raw, RunningBroker, connect_bytes, frame, running_broker, utf8
from pytest_otmcp.mocks.mqtt.broker import Limits
from pytest_otmcp.mocks.mqtt.faults import FaultPlan

from pytest_otmcp.wire.mqtt.primitives import varint


@pytest.fixture
def broker() -> Iterator[RunningBroker]:
    with running_broker() as running:
        yield running


def connected(broker: RunningBroker, level: int = 4, client_id: str = "raw", **fields: object) -> Raw:
    raw = Raw(broker.port).send(connect_bytes(client_id, level, **fields))  # type: ignore[arg-type]
    first, body = raw.packet()
    assert (first, body[1]) == (0x20, 0)
    return raw


# -- what is refused ------------------------------------------------------------------------------------------

MALFORMED_311 = {
    "SUBSCRIBE at QoS 3": frame(0x82, b"\0\1", utf8("a"), b"\3"),
    "SUBSCRIBE at QoS 5": frame(0x82, b"\0\1", utf8("a"), b"\5"),
    "SUBSCRIBE to a#": frame(0x82, b"\0\1", utf8("a#"), b"\0"),
    "SUBSCRIBE to nothing": frame(0x82, b"\0\1", utf8(""), b"\0"),
    "SUBSCRIBE without filter": frame(0x82, b"\0\1"),
    "SUBSCRIBE with reserved flags": frame(0x80, b"\0\1", utf8("a"), b"\0"),
    "PUBLISH on no topic": frame(0x30, utf8("")),
    "PUBLISH on a wildcard": frame(0x30, utf8("a/+")),
    "PUBLISH at QoS 3": frame(0x36, utf8("a"), b"\0\1"),
    "PUBLISH with U+0000": frame(0x30, utf8("a\0")),
    "PUBLISH with bad UTF-8": frame(0x30, b"\0\2\xc3\x28"),
    "PUBLISH with packet identifier 0": frame(0x32, utf8("a"), b"\0\0"),
    "PUBREL with reserved flags": frame(0x60, b"\0\1"),
    "a second CONNECT": connect_bytes(),
    "a CONNACK": frame(0x20, b"\0\0"),
    "a SUBACK": frame(0x90, b"\0\1\0"),
    "a PINGRESP": frame(0xD0),
    "AUTH": frame(0xF0),
    "packet type 0": frame(0x00),
    "a remaining length of five bytes": b"\x30\xff\xff\xff\xff\x01",
}


@pytest.mark.parametrize("name", MALFORMED_311)
def test_a_malformed_packet_closes_the_connection_and_is_journalled(broker: RunningBroker, name: str) -> None:
    with connected(broker) as raw:
        raw.send(MALFORMED_311[name])
        assert raw.rest() == b""
    [entry] = broker.wait(kind="malformed")
    assert entry["reason"]
    assert entry["client_id"] == "raw"
    broker.wait(kind="DISCONNECTED", connection=entry["connection"])
    assert broker.broker.sessions == {}


MALFORMED_5 = {
    "SUBSCRIBE at QoS 3": (0x81, frame(0x82, b"\0\1\0", utf8("a"), b"\3")),
    "SUBSCRIBE to a#": (0x81, frame(0x82, b"\0\1\0", utf8("a#"), b"\0")),
    "retain handling 3": (0x82, frame(0x82, b"\0\1\0", utf8("a"), b"\x30")),
    "No Local on a shared subscription": (0x82, frame(0x82, b"\0\1\0", utf8("$share/g/a"), b"\4")),
    "PUBLISH on no topic": (0x82, frame(0x30, utf8(""), b"\0")),
    "PUBLISH with a subscription identifier": (0x82, frame(0x30, utf8("a"), bytes.fromhex("020b01"))),
    "topic alias 0": (0x94, frame(0x30, utf8("a"), bytes.fromhex("03230000"))),
    "topic alias above the maximum": (0x94, frame(0x30, utf8("a"), bytes.fromhex("03230011"))),
    "topic alias never set": (0x82, frame(0x30, utf8(""), bytes.fromhex("03230001"))),
    "a second CONNECT": (0x82, connect_bytes(level=5)),
    "AUTH": (0x82, frame(0xF0)),
    "session expiry raised from 0": (0x82, frame(0xE0, bytes.fromhex("00051100000001"))),
}


@pytest.mark.parametrize("name", MALFORMED_5)
def test_an_mqtt_5_client_is_told_why_it_is_disconnected(broker: RunningBroker, name: str) -> None:
    code, data = MALFORMED_5[name]
    with connected(broker, 5) as raw:
        raw.send(data)
        assert raw.rest() == frame(0xE0, bytes([code]))


@pytest.mark.parametrize(
    "data",
    [frame(0xC0), frame(0x30, utf8("a")), b"GET / HTTP/1.1\r\n\r\n", b"\0" * 64, connect_bytes(flags=3)],
    ids=["PINGREQ", "PUBLISH", "HTTP", "zeros", "reserved CONNECT flag"],
)
def test_a_connection_that_does_not_begin_with_a_connect_is_closed(broker: RunningBroker, data: bytes) -> None:
    with Raw(broker.port).send(data) as raw:
        assert raw.rest() == b""


@pytest.mark.parametrize(("level", "name"), [(3, "MQTT"), (6, "MQTT"), (3, "MQIsdp")])
def test_another_protocol_version_is_refused_with_a_connack(broker: RunningBroker, level: int, name: str) -> None:
    with Raw(broker.port).send(frame(0x10, utf8(name), bytes([level, 2, 0, 0]), utf8("x"))) as raw:
        assert raw.rest() == frame(0x20, b"\0\1")


def test_an_empty_client_id_needs_a_clean_session_in_3_1_1(broker: RunningBroker) -> None:
    with Raw(broker.port).send(connect_bytes("", flags=0)) as raw:
        assert raw.rest() == frame(0x20, b"\0\2")
    connected(broker, client_id="").close()


def test_an_authentication_method_is_refused(broker: RunningBroker) -> None:
    with Raw(broker.port).send(connect_bytes(level=5, props=bytes.fromhex("04150001") + b"x")) as raw:
        assert raw.rest() == frame(0x20, b"\0\x8c\0")


def test_a_connection_without_a_connect_is_closed_in_time() -> None:
    with running_broker(Limits(connect_timeout_s=0.05)) as broker, Raw(broker.port) as raw:
        assert raw.rest() == b""


def test_a_packet_beyond_the_brokers_maximum_is_refused() -> None:
    with running_broker(Limits(maximum_packet_size=64)) as broker, connected(broker, 5) as raw:
        raw.send(frame(0x30, utf8("a"), b"\0", bytes(64)))
        assert raw.rest() == frame(0xE0, b"\x95")


def test_a_packet_of_tens_of_megabytes_is_refused_before_it_has_arrived(broker: RunningBroker) -> None:
    with connected(broker, 5) as raw:
        # The first byte and a length of 60 MB, of which nothing follows.
        raw.send(b"\x30" + varint(60_000_000))
        assert raw.rest() == frame(0xE0, b"\x95")


def test_a_broken_client_does_not_disturb_the_others(broker: RunningBroker) -> None:
    rng = random.Random(7)
    valid = [
        *MALFORMED_311.values(),
        connect_bytes(),
        frame(0x82, b"\0\1", utf8("#"), b"\2"),
        frame(0x34, utf8("a"), b"\0\1x"),
    ]
    with Peer(broker.port, "witness") as witness:
        witness.subscribe("witness/#")
        for round_number in range(150):
            level = rng.choice((4, 5))
            with Raw(broker.port).send(
                connect_bytes(f"fuzz-{round_number % 9}", level, flags=rng.choice((0, 2)))
            ) as raw:
                data = bytearray(b"".join(rng.choices(valid, k=3)) + rng.randbytes(rng.randrange(20)))
                for _ in range(rng.randrange(3)):
                    data[rng.randrange(len(data))] = rng.randrange(256)
                raw.send(bytes(data))
        witness.publish("witness/end", b"alive", 1)
        assert witness.next().payload == b"alive"
    broker.wait(count=151, kind="CONNECTED")


# -- what is answered -----------------------------------------------------------------------------------------


def test_several_packets_in_one_segment_are_answered_in_order(broker: RunningBroker) -> None:
    subscribe = frame(0x82, b"\0\7", utf8("a"), b"\1")
    with Raw(broker.port).send(connect_bytes(), subscribe, frame(0x32, utf8("a"), b"\0\x09x"), frame(0xC0)) as raw:
        packets = [raw.packet() for _ in range(5)]
    assert packets == [
        (0x20, b"\0\0"),
        (0x90, b"\0\7\1"),
        (0x32, utf8("a") + b"\0\1x"),
        (0x40, b"\0\x09"),
        (0xD0, b""),
    ]


def test_a_qos_2_message_is_delivered_once_however_often_it_is_sent(broker: RunningBroker) -> None:
    with Peer(broker.port, "receiver") as receiver, connected(broker) as raw:
        receiver.subscribe("a", 2)
        raw.send(frame(0x34, utf8("a"), b"\0\5x"), frame(0x3C, utf8("a"), b"\0\5x"))
        assert [raw.packet(), raw.packet()] == [(0x50, b"\0\5"), (0x50, b"\0\5")]
        raw.send(frame(0x62, b"\0\5"), frame(0x62, b"\0\5"))
        assert [raw.packet(), raw.packet()] == [(0x70, b"\0\5"), (0x70, b"\0\5")]
        assert receiver.payloads(1) == [b"x"]
        assert receiver.nothing_more()


def test_unknown_packet_identifiers_are_named_in_mqtt_5(broker: RunningBroker) -> None:
    with connected(broker, 5) as raw:
        raw.send(frame(0x62, b"\0\5"), frame(0x50, b"\0\6"))
        assert [raw.packet(), raw.packet()] == [(0x70, b"\0\5\x92"), (0x62, b"\0\6\x92")]


def test_an_acknowledgement_of_the_wrong_kind_closes_the_connection(broker: RunningBroker) -> None:
    with connected(broker) as raw:
        raw.send(frame(0x82, b"\0\1", utf8("a"), b"\1"), frame(0x32, utf8("a"), b"\0\1"))
        assert [raw.packet()[0] for _ in range(3)] == [0x90, 0x32, 0x40]
        raw.send(frame(0x50, b"\0\1"))
        assert raw.rest() == b""


def test_a_qos_2_delivery_is_resumed_where_it_stopped(broker: RunningBroker) -> None:
    with connected(broker, flags=0) as raw, Peer(broker.port, "sender") as sender:
        raw.send(frame(0x82, b"\0\1", utf8("a"), b"\2"))
        raw.packet()
        sender.publish("a", b"1", 2)
        sender.publish("a", b"2", 2)
        assert [raw.packet(), raw.packet()] == [(0x34, utf8("a") + b"\0\0011"), (0x34, utf8("a") + b"\0\0022")]
        raw.send(frame(0x50, b"\0\1"))
        assert raw.packet() == (0x62, b"\0\1")
    broker.wait(kind="DISCONNECTED", client_id="raw")
    with Raw(broker.port).send(connect_bytes(flags=0)) as again:
        assert again.packet() == (0x20, b"\1\0")
        # The first message was received: its PUBREL is repeated. The second was not: it is sent again, with DUP.
        assert [again.packet(), again.packet()] == [(0x62, b"\0\1"), (0x3C, utf8("a") + b"\0\0022")]


def test_more_than_the_receive_maximum_of_unreleased_messages_is_refused() -> None:
    with running_broker(Limits(receive_maximum=2)) as broker, connected(broker, 5) as raw:
        raw.send(*(frame(0x34, utf8("a"), bytes([0, n, 0])) for n in (1, 2, 3)))
        assert [raw.packet()[0], raw.packet()[0]] == [0x50, 0x50]
        assert raw.rest() == frame(0xE0, b"\x93")


def test_keepalive_0_is_never_supervised(broker: RunningBroker) -> None:
    with connected(broker) as raw:
        raw.send(frame(0xC0))
        assert raw.packet() == (0xD0, b"")


# -- what is journalled ---------------------------------------------------------------------------------------


def test_every_packet_of_both_directions_is_journalled_in_order(broker: RunningBroker) -> None:
    with Raw(broker.port).send(
        connect_bytes("j", flags=0xC6, tail=utf8("w") + utf8("bye") + utf8("u") + utf8("secret"))
    ) as raw:
        raw.packet()
        raw.send(frame(0x82, b"\0\1", utf8("a/#"), b"\2"), frame(0x34, utf8("a/b"), b"\0\2\0\xff"))
        for _ in range(3):
            raw.packet()
        raw.send(frame(0x62, b"\0\2"), frame(0x50, b"\0\1"))
        raw.packet()
        raw.packet()
        raw.send(frame(0x70, b"\0\1"), frame(0xC0), frame(0xA2, b"\0\3", utf8("a/#")), frame(0xE0))
        raw.rest()
    broker.wait(kind="DISCONNECTED")
    entries = broker.entries(connection=1)
    assert [(entry["direction"], entry["kind"]) for entry in entries] == [
        ("in", "CONNECTED"),
        ("in", "CONNECT"),
        ("out", "CONNACK"),
        ("in", "SUBSCRIBE"),
        ("out", "SUBACK"),
        ("in", "PUBLISH"),
        ("out", "PUBLISH"),
        ("out", "PUBREC"),
        ("in", "PUBREL"),
        ("out", "PUBCOMP"),
        ("in", "PUBREC"),
        ("out", "PUBREL"),
        ("in", "PUBCOMP"),
        ("in", "PINGREQ"),
        ("out", "PINGRESP"),
        ("in", "UNSUBSCRIBE"),
        ("out", "UNSUBACK"),
        ("in", "DISCONNECT"),
        ("in", "DISCONNECTED"),
    ]
    by_kind = {(entry["direction"], entry["kind"]): entry for entry in entries}
    connect = by_kind["in", "CONNECT"]
    assert connect["will"] == {
        "topic": "w",
        "payload": base64.b64encode(b"bye").decode(),
        "qos": 0,
        "retain": False,
    }
    assert (connect["username"], connect["protocol_level"], connect["clean_start"]) == ("u", 4, True)
    assert "secret" not in repr(entries)
    assert base64.b64encode(b"secret").decode() not in repr(entries)
    assert by_kind["in", "SUBSCRIBE"]["filters"] == [{"filter": "a/#", "qos": 2}]
    assert by_kind["out", "SUBACK"]["reason_codes"] == [2]
    assert (by_kind["in", "PUBLISH"]["topic"], by_kind["in", "PUBLISH"]["packet_id"]) == ("a/b", 2)
    assert base64.b64decode(by_kind["out", "PUBLISH"]["payload"]) == b"\0\xff"
    assert by_kind["in", "DISCONNECTED"]["reason"] == "client disconnected"
    assert all(entry["client_id"] == "j" for entry in entries[1:])


def test_the_bytes_of_a_malformed_connect_are_not_journalled(broker: RunningBroker) -> None:
    with Raw(broker.port).send(connect_bytes(flags=0xC3, tail=utf8("u") + utf8("secret"))) as raw:
        raw.rest()
    assert broker.wait(kind="malformed")[0]["bytes"] == "10"


def test_a_will_is_journalled_when_it_fires_and_where_it_arrives(broker: RunningBroker) -> None:
    with Peer(broker.port, "receiver") as receiver:
        receiver.subscribe("w")
        connected(broker, flags=6, tail=utf8("w") + utf8("bye")).close()
        assert receiver.next().payload == b"bye"
    [fired] = broker.entries(kind="WILL")
    assert (fired["client_id"], fired["topic"]) == ("raw", "w")
    [arrived] = broker.entries(will_sent=True)
    assert (arrived["direction"], arrived["client_id"]) == ("out", "receiver")


# -- the fault plan -------------------------------------------------------------------------------------------


def test_an_answer_may_be_withheld_while_the_packet_is_obeyed(broker: RunningBroker) -> None:
    broker.broker.faults = FaultPlan([{"packet": "PUBLISH", "topic": "a", "times": 1, "action": {"no_answer": True}}])
    with Peer(broker.port, "receiver") as receiver, connected(broker) as raw:
        receiver.subscribe("a", 1)
        raw.send(frame(0x32, utf8("a"), b"\0\1x"), frame(0x32, utf8("a"), b"\0\2y"))
        assert raw.packet() == (0x40, b"\0\2")
        assert receiver.payloads(2) == [b"x", b"y"]
    assert broker.broker.faults.hits == [1]


def test_an_answer_may_come_late(broker: RunningBroker) -> None:
    broker.broker.faults = FaultPlan([{"packet": "PUBLISH", "times": 1, "action": {"delay_s": 0.05}}])
    with connected(broker) as raw:
        raw.send(frame(0x32, utf8("a"), b"\0\1"), frame(0xC0))
        assert [raw.packet(), raw.packet()] == [(0xD0, b""), (0x40, b"\0\1")]


def test_a_connect_may_be_accepted_late_and_what_follows_it_waits(broker: RunningBroker) -> None:
    broker.broker.faults = FaultPlan([{"packet": "CONNECT", "action": {"delay_s": 0.05}}])
    with Raw(broker.port).send(connect_bytes(), frame(0xC0)) as raw:
        assert [raw.packet(), raw.packet()] == [(0x20, b"\0\0"), (0xD0, b"")]


def test_a_connect_may_stay_without_answer(broker: RunningBroker) -> None:
    broker.broker.faults = FaultPlan([{"packet": "CONNECT", "client_id": "raw", "action": {"no_answer": True}}])
    with Raw(broker.port).send(connect_bytes()):
        broker.wait(kind="CONNECT")
        with Peer(broker.port, "other") as other:
            assert other.connack == 0
        assert broker.entries(kind="CONNACK", connection=1) == []


@pytest.mark.parametrize(
    ("level", "packet", "sent", "code", "answer"),
    [
        (4, "SUBSCRIBE", frame(0x82, b"\0\1", utf8("a"), b"\1"), 0x80, frame(0x90, b"\0\1\x80")),
        (4, "SUBSCRIBE", frame(0x82, b"\0\1", utf8("a"), b"\1"), 0, frame(0x90, b"\0\1\0")),
        (5, "SUBSCRIBE", frame(0x82, b"\0\1\0", utf8("a"), b"\1"), 0x87, frame(0x90, b"\0\1\0\x87")),
        (5, "PUBLISH", frame(0x32, utf8("a"), b"\0\1\0"), 0x97, frame(0x40, b"\0\1\x97")),
        (5, "PUBLISH", frame(0x34, utf8("a"), b"\0\1\0"), 0x99, frame(0x50, b"\0\1\x99")),
        (5, "UNSUBSCRIBE", frame(0xA2, b"\0\1\0", utf8("a")), 0x80, frame(0xB0, b"\0\1\0\x80")),
    ],
)
def test_a_packet_may_be_answered_with_a_reason_code(
    broker: RunningBroker, level: int, packet: str, sent: bytes, code: int, answer: bytes
) -> None:
    broker.broker.faults = FaultPlan([{"packet": packet, "action": {"reason_code": code}}])
    with connected(broker, level) as raw:
        raw.send(sent, frame(0xC0))
        assert [raw.packet(), raw.packet()] == [(answer[0], answer[2:]), (0xD0, b"")]


def test_a_refused_publish_reaches_nobody(broker: RunningBroker) -> None:
    broker.broker.faults = FaultPlan([{"packet": "PUBLISH", "topic": "a", "action": {"reason_code": 0x87}}])
    with Peer(broker.port, "peer") as peer:
        peer.subscribe("a", 1)
        assert peer.publish("a", b"x", 1) == 0x87
        assert peer.nothing_more()


def test_a_connect_may_be_refused(broker: RunningBroker) -> None:
    broker.broker.faults = FaultPlan([{"packet": "CONNECT", "times": 1, "action": {"reason_code": 5}}])
    with Raw(broker.port).send(connect_bytes()) as raw:
        assert raw.rest() == frame(0x20, b"\0\5")
    connected(broker).close()


@pytest.mark.parametrize("action", ["close", "reset"])
def test_a_packet_may_end_the_connection(broker: RunningBroker, action: str) -> None:
    broker.broker.faults = FaultPlan([{"packet": "SUBSCRIBE", "action": {action: True}}])
    with connected(broker) as raw:
        raw.send(frame(0x82, b"\0\1", utf8("a"), b"\1"))
        assert raw.rest() == b""
    assert broker.wait(kind="DISCONNECTED")[0]["reason"] == "fault plan"


def test_the_mocks_own_clients_are_spared_unless_they_are_named(broker: RunningBroker) -> None:
    rule = {"packet": "PINGREQ", "action": {"close": True}}
    broker.broker.faults = FaultPlan([rule])
    with connected(broker, client_id="otmcp-mock-x") as raw:
        raw.send(frame(0xC0))
        assert raw.packet() == (0xD0, b"")
        broker.broker.faults = FaultPlan([{**rule, "client_id": "otmcp-mock-x"}])
        raw.send(frame(0xC0))
        assert raw.rest() == b""
