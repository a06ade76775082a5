"""The MQTT codec: bytes of the specification, and bytes that must be refused."""

from __future__ import annotations

import random

import pytest
from mqtt_tools import connect_bytes, frame, utf8
from pytest_otmcp.mocks.mqtt.framer import Framer

from pytest_otmcp.wire.mqtt.codec import decode, encode
from pytest_otmcp.wire.mqtt.packets import (
    Ack,
    Auth,
    Connack,
    Connect,
    Disconnect,
    Packet,
    PacketType,
    Pingreq,
    Pingresp,
    Publish,
    Suback,
    Subscribe,
    SubscriptionRequest,
    Unsuback,
    Unsubscribe,
    Will,
)
from pytest_otmcp.wire.mqtt.primitives import ProtocolViolation
from pytest_otmcp.wire.mqtt.properties import Property
from pytest_otmcp.wire.mqtt.topics import check_filter, check_name, matches, split_shared

ALL_PUBLISH_PROPERTIES = {
    Property.PAYLOAD_FORMAT_INDICATOR: 1,
    Property.MESSAGE_EXPIRY_INTERVAL: 0xFFFFFFFF,
    Property.CONTENT_TYPE: "text/plain",
    Property.RESPONSE_TOPIC: "answer/here",
    Property.CORRELATION_DATA: b"\x00\xff",
    Property.SUBSCRIPTION_IDENTIFIER: [1, 268_435_455],
    Property.TOPIC_ALIAS: 7,
    Property.USER_PROPERTY: [("a", "1"), ("a", "2")],
}

PACKETS: list[tuple[Packet, int]] = [
    (Connect(protocol_level=4, clean_start=True, keepalive=65535, client_id=""), 4),
    (
        Connect(
            protocol_level=5,
            clean_start=False,
            keepalive=0,
            client_id="ü",
            username="someone",
            will=Will(topic="w", payload=b"\0", qos=2, retain=True, properties={Property.WILL_DELAY_INTERVAL: 1}),
            properties={Property.SESSION_EXPIRY_INTERVAL: 5, Property.RECEIVE_MAXIMUM: 1},
        ),
        5,
    ),
    (Connack(session_present=True, reason_code=0), 4),
    (Connack(session_present=False, reason_code=0x8C, properties={Property.REASON_STRING: "no"}), 5),
    (Publish(topic="a", payload=b""), 4),
    (Publish(topic="a/b", payload=b"x" * 300, qos=2, retain=True, dup=True, packet_id=65535), 4),
    (Publish(topic="a", payload=b"\0\1", qos=1, packet_id=1, properties=ALL_PUBLISH_PROPERTIES), 5),
    (Publish(topic="", payload=b"", properties={Property.TOPIC_ALIAS: 1}), 5),
    *((Ack(type=kind, packet_id=9), level) for level in (4, 5) for kind in list(PacketType)[3:7]),
    (Ack(type=PacketType.PUBREC, packet_id=9, reason_code=0x97), 5),
    (Ack(type=PacketType.PUBREL, packet_id=9, properties={Property.REASON_STRING: "r"}), 5),
    (Subscribe(packet_id=1, requests=(SubscriptionRequest(filter="#", qos=2),)), 4),
    (
        Subscribe(
            packet_id=1,
            requests=(
                SubscriptionRequest(filter="+/a", qos=0, no_local=True, retain_as_published=True, retain_handling=2),
                SubscriptionRequest(filter="$share/g/a/#", qos=1),
            ),
            properties={Property.SUBSCRIPTION_IDENTIFIER: 128},
        ),
        5,
    ),
    (Suback(packet_id=1, reason_codes=(0, 1, 2, 0x80)), 4),
    (Unsubscribe(packet_id=2, filters=("a", "b/#")), 5),
    (Unsuback(packet_id=2, reason_codes=()), 4),
    (Unsuback(packet_id=2, reason_codes=(0, 0x11)), 5),
    (Pingreq(), 4),
    (Pingresp(), 5),
    (Disconnect(), 4),
    (Disconnect(reason_code=0x8E), 5),
    (Auth(reason_code=0x18, properties={Property.AUTHENTICATION_METHOD: "x"}), 5),
]


def decoded(data: bytes, level: int = 4) -> Packet:
    framer = Framer()
    framer.feed(data)
    first = framer.next()
    assert first is not None
    assert framer.next() is None
    return decode(*first, level)


@pytest.mark.parametrize(("packet", "level"), PACKETS, ids=lambda value: type(value).__name__)
def test_every_packet_survives_encoding_and_decoding(packet: Packet, level: int) -> None:
    assert decoded(encode(packet, level), level) == packet


def test_a_publish_has_the_bytes_of_the_specification() -> None:
    # 3.1.1, figures 3.11 to 3.13: topic a/b, packet identifier 10.
    data = encode(Publish(topic="a/b", payload=b"hi", qos=1, packet_id=10), 4)
    assert data == bytes.fromhex("32 09 0003 612f62 000a 6869")


def test_a_subscribe_has_the_bytes_of_the_specification() -> None:
    # 3.1.1, figures 3.22 and 3.23: a/b at QoS 1, c/d at QoS 2.
    requests = (SubscriptionRequest(filter="a/b", qos=1), SubscriptionRequest(filter="c/d", qos=2))
    assert encode(Subscribe(packet_id=10, requests=requests), 4) == bytes.fromhex(
        "82 0e 000a 0003 612f62 01 0003 632f64 02"
    )


def test_a_connect_has_the_bytes_of_the_specification() -> None:
    # 5, figure 3.6: user name, will at QoS 1, clean start, keep-alive 10, session expiry 10 s.
    connect = Connect(
        protocol_level=5,
        clean_start=True,
        keepalive=10,
        client_id="c",
        username="u",
        will=Will(topic="t", payload=b"p", qos=1, retain=False),
        properties={Property.SESSION_EXPIRY_INTERVAL: 10},
    )
    assert encode(connect, 5) == bytes.fromhex(
        "10 1d 0004 4d515454 05 8e 000a 05 11 0000000a 0001 63 00 0001 74 0001 70 0001 75"
    )


def test_a_password_is_not_shown() -> None:
    packet = decoded(connect_bytes(flags=0xC2, tail=utf8("user") + utf8("secret")))
    assert isinstance(packet, Connect)
    assert packet.username == "user"
    assert "secret" not in repr(packet)


@pytest.mark.parametrize("size", [0, 127, 128, 16_383, 16_384, 2_097_151, 2_097_152])
def test_remaining_lengths_of_every_size_are_framed(size: int) -> None:
    framer = Framer()
    framer.feed(encode(Publish(topic="t", payload=bytes(size)), 4))
    first = framer.next()
    assert first is not None
    assert len(first[1]) == size + 3


def test_a_packet_may_arrive_byte_by_byte() -> None:
    framer = Framer()
    data = encode(Publish(topic="t", payload=b"x" * 200), 4)
    for byte in data[:-1]:
        framer.feed(bytes([byte]))
        assert framer.next() is None
    framer.feed(data[-1:])
    assert framer.next() == (0x30, data[3:])


@pytest.mark.parametrize("header", ["30ffffffff01", "3080808080", "10ffffffff7f"])
def test_a_remaining_length_of_five_bytes_is_refused(header: str) -> None:
    framer = Framer()
    framer.feed(bytes.fromhex(header))
    with pytest.raises(ProtocolViolation, match="four bytes"):
        framer.next()


def test_a_remaining_length_longer_than_needed_is_refused_in_mqtt_5_only() -> None:
    framer = Framer()
    framer.feed(bytes.fromhex("c08000 c08000"))
    assert framer.next() == (0xC0, b"")
    framer.minimal = True
    with pytest.raises(ProtocolViolation, match="longer than needed"):
        framer.next()


MALFORMED = {
    "packet type 0": (4, frame(0x00)),
    "packet type 15 in 3.1.1": (4, frame(0xF0)),
    "CONNECT with reserved flag": (4, connect_bytes(flags=3)),
    "CONNECT with reserved header flags": (4, b"\x11" + connect_bytes()[1:]),
    "CONNECT with will QoS 3": (4, connect_bytes(flags=0x1E, tail=utf8("t") + utf8("p"))),
    "CONNECT with will QoS and no will": (4, connect_bytes(flags=0x0A)),
    "CONNECT with will retain and no will": (4, connect_bytes(flags=0x22)),
    "CONNECT with password and no user name": (4, connect_bytes(flags=0x42, tail=utf8("p"))),
    "CONNECT with a will on a wildcard": (4, connect_bytes(flags=6, tail=utf8("a/#") + utf8("p"))),
    "CONNECT without its client id": (4, connect_bytes()[:-5][:1] + b"\x0a" + connect_bytes()[2:-5]),
    "CONNECT with bytes behind it": (4, connect_bytes(tail=b"x")),
    "CONNECT of another protocol": (4, frame(0x10, utf8("HTTP"), b"\x04\x02\0\0", utf8("x"))),
    "CONNECT with MQTT 7": (4, connect_bytes(level=7)),
    "CONNECT with receive maximum 0": (5, connect_bytes(level=5, props=bytes.fromhex("03210000"))),
    "CONNECT with maximum packet size 0": (5, connect_bytes(level=5, props=bytes.fromhex("052700000000"))),
    "CONNECT with a property twice": (5, connect_bytes(level=5, props=bytes.fromhex("06210001210001"))),
    "CONNECT with a property of PUBLISH": (5, connect_bytes(level=5, props=bytes.fromhex("03230001"))),
    "CONNECT with an unknown property": (5, connect_bytes(level=5, props=bytes.fromhex("027f00"))),
    "CONNECT with properties beyond its end": (5, connect_bytes(level=5, props=bytes.fromhex("7f"))),
    "CONNECT with request problem information 2": (5, connect_bytes(level=5, props=bytes.fromhex("021702"))),
    "PUBLISH with QoS 3": (4, frame(0x36, utf8("t"), b"\0\1")),
    "PUBLISH with DUP at QoS 0": (4, frame(0x38, utf8("t"))),
    "PUBLISH on no topic": (4, frame(0x30, utf8(""))),
    "PUBLISH on no topic and no alias": (5, frame(0x30, utf8(""), b"\0")),
    "PUBLISH on #": (4, frame(0x30, utf8("a/#"))),
    "PUBLISH on +": (4, frame(0x30, utf8("a/+/b"))),
    "PUBLISH with packet identifier 0": (4, frame(0x32, utf8("t"), b"\0\0")),
    "PUBLISH without packet identifier": (4, frame(0x32, utf8("t"))),
    "PUBLISH with U+0000": (4, frame(0x30, utf8("a\0b"))),
    "PUBLISH with a surrogate": (4, frame(0x30, b"\0\3\xed\xa0\x80")),
    "PUBLISH with overlong UTF-8": (4, frame(0x30, b"\0\2\xc0\xaf")),
    "PUBLISH with bad UTF-8": (4, frame(0x30, b"\0\1\xff")),
    "PUBLISH with a topic beyond its end": (4, frame(0x30, b"\0\x09abc")),
    "PUBLISH with payload format 2": (5, frame(0x30, utf8("t"), bytes.fromhex("020102"))),
    "PUBLISH with subscription identifier 0": (5, frame(0x30, utf8("t"), bytes.fromhex("020b00"))),
    "PUBLISH with an overlong integer": (5, frame(0x30, utf8("t"), bytes.fromhex("030b8100"))),
    "PUBLISH with a wildcard response topic": (5, frame(0x30, utf8("t"), b"\x04\x08\0\1#")),
    "PUBACK with flags": (4, frame(0x42, b"\0\1")),
    "PUBACK with packet identifier 0": (4, frame(0x40, b"\0\0")),
    "PUBACK with three bytes in 3.1.1": (4, frame(0x40, b"\0\1\0")),
    "PUBACK with an unknown reason code": (5, frame(0x40, b"\0\1\x01")),
    "PUBREL without its flags": (4, frame(0x60, b"\0\1")),
    "SUBSCRIBE without its flags": (4, frame(0x80, b"\0\1", utf8("a"), b"\0")),
    "SUBSCRIBE without filters": (4, frame(0x82, b"\0\1")),
    "SUBSCRIBE with packet identifier 0": (4, frame(0x82, b"\0\0", utf8("a"), b"\0")),
    "SUBSCRIBE with QoS 3": (4, frame(0x82, b"\0\1", utf8("a"), b"\3")),
    "SUBSCRIBE with QoS 3 in MQTT 5": (5, frame(0x82, b"\0\1\0", utf8("a"), b"\3")),
    "SUBSCRIBE with QoS 5": (4, frame(0x82, b"\0\1", utf8("a"), b"\5")),
    "SUBSCRIBE with reserved options": (5, frame(0x82, b"\0\1\0", utf8("a"), b"\x40")),
    "SUBSCRIBE with retain handling 3": (5, frame(0x82, b"\0\1\0", utf8("a"), b"\x30")),
    "SUBSCRIBE to nothing": (4, frame(0x82, b"\0\1", utf8(""), b"\0")),
    "SUBSCRIBE to a#": (4, frame(0x82, b"\0\1", utf8("a#"), b"\0")),
    "SUBSCRIBE to a+": (4, frame(0x82, b"\0\1", utf8("a+/b"), b"\0")),
    "SUBSCRIBE to #/a": (4, frame(0x82, b"\0\1", utf8("#/a"), b"\0")),
    "SUBSCRIBE without options": (4, frame(0x82, b"\0\1", utf8("a"))),
    "SUBSCRIBE shared with No Local": (5, frame(0x82, b"\0\1\0", utf8("$share/g/a"), b"\4")),
    "SUBSCRIBE shared without a name": (5, frame(0x82, b"\0\1\0", utf8("$share//a"), b"\0")),
    "SUBSCRIBE shared without a filter": (5, frame(0x82, b"\0\1\0", utf8("$share/g"), b"\0")),
    "SUBSCRIBE with two identifiers": (5, frame(0x82, bytes.fromhex("0001040b010b02"), utf8("a"), b"\0")),
    "UNSUBSCRIBE without filters": (4, frame(0xA2, b"\0\1")),
    "UNSUBSCRIBE from a malformed filter": (4, frame(0xA2, b"\0\1", utf8("a/#/b"))),
    "PINGREQ with a body": (4, frame(0xC0, b"x")),
    "PINGREQ with flags": (4, frame(0xC1)),
    "DISCONNECT with a body in 3.1.1": (4, frame(0xE0, b"\0")),
    "DISCONNECT with an unknown reason code": (5, frame(0xE0, b"\x03")),
    "DISCONNECT with bytes behind it": (5, frame(0xE0, b"\0\0x")),
    "AUTH with an unknown reason code": (5, frame(0xF0, b"\x01")),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_a_malformed_packet_is_a_protocol_violation(name: str) -> None:
    level, data = MALFORMED[name]
    with pytest.raises(ProtocolViolation):
        decoded(data, level)


def test_damaged_packets_are_packets_or_violations_and_nothing_else() -> None:
    rng = random.Random(20261121)
    outcomes = set()
    for _ in range(20_000):
        sample, level = rng.choice(PACKETS)
        data = bytearray(encode(sample, level))
        for _ in range(rng.randrange(4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        del data[rng.randrange(len(data)) + 1 :]
        try:
            packet = decode(data[0], bytes(data[2:]), level)
        except ProtocolViolation:
            outcomes.add("violation")
        else:
            outcomes.add(packet.type.name)
            assert decoded(encode(packet, level), level) == packet
    assert {"violation", "PUBLISH", "PUBACK", "SUBSCRIBE"} <= outcomes


@pytest.mark.parametrize(
    ("topic_filter", "topic", "expected"),
    [
        ("a/b", "a/b", True),
        ("a/b", "a/B", False),
        ("a/+", "a/b", True),
        ("a/+", "a", False),
        ("a/+", "a/", True),
        ("a/+", "a/b/c", False),
        ("a/#", "a", True),
        ("a/#", "a/b/c", True),
        ("a/#", "ab", False),
        ("#", "a/b", True),
        ("#", "$SYS/x", False),
        ("+/x", "$SYS/x", False),
        ("$SYS/#", "$SYS/x", True),
        ("+/+", "/finance", True),
        ("/+", "/finance", True),
        ("+", "/finance", False),
        ("+/tennis/#", "sport/tennis", True),
    ],
)
def test_filters_match_as_the_specification_says(topic_filter: str, topic: str, expected: bool) -> None:
    check_filter(topic_filter)
    check_name(topic)
    assert matches(topic_filter.split("/"), topic.split("/")) is expected


def test_a_shared_subscription_is_split_into_name_and_filter() -> None:
    assert split_shared("$share/group/a/+") == ("group", "a/+")
    assert split_shared("$shared/a") == (None, "$shared/a")
