"""The MQTT witness: packets written by hand from the specifications, and segmentation."""

from __future__ import annotations

import base64
import random

import pytest

from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.mqtt.decoder import MqttConversation
from pytest_otmcp.wire.framing import Framer
from pytest_otmcp.wire.mqtt.primitives import packet_length

from .journals import Entry, decoded, entry


def packet(first: int, *parts: str) -> bytes:
    """Return a control packet of less than 128 bytes; a part is hex, or text after an apostrophe."""
    body = b"".join(part[1:].encode() if part.startswith("'") else bytes.fromhex(part) for part in parts)
    return bytes([first, len(body)]) + body


def string(text: str) -> str:
    return len(text.encode()).to_bytes(2).hex() + text.encode().hex()


CONNECT = packet(0x10, string("MQTT"), "04 02 003C", string("adapter"))
CONNECT_5 = packet(0x10, string("MQTT"), "05 02 003C 05 11 0000000A", string("adapter"))
CONNACK = packet(0x20, "00 00")


def decode(*packets: tuple[Direction, bytes]) -> list[Entry]:
    return decoded(MqttConversation(), *packets)


def b64(data: bytes) -> str:
    return base64.b64encode(data).decode()


# -- packets ----------------------------------------------------------------------------------------------


def test_connect_shows_the_will_and_never_the_password() -> None:
    # MQTT 3.1.1, figure 3.6: all fields present, keep alive 10.
    data = packet(0x10, string("MQTT"), "04 CE 000A", *map(string, ("me", "will/topic", "gone", "user", "secret")))
    (found,) = decode(("in", data))
    assert found == {
        **entry("CONNECT", request=True, t_ns=found["t_ns"]),
        "client_id": "me",
        "protocol_level": 4,
        "clean_start": True,
        "keepalive": 10,
        "will": {"topic": "will/topic", "qos": 1, "retain": False, "payload": b64(b"gone")},
        "username": "user",
        # The packet without the flag of a password, and without the password.
        "frame": packet(0x10, string("MQTT"), "04 8E 000A", *map(string, ("me", "will/topic", "gone", "user"))).hex(),
    }
    assert b64(b"secret") not in repr(found)


def test_connect_of_version_5_has_properties_of_its_own_and_of_its_will() -> None:
    properties = "08 11 0000000A 21 0014"
    data = packet(
        0x10, string("MQTT"), "05 06 003C", properties, string("me"), "05 18 00000005", string("w"), string("x")
    )
    (found,) = decode(("in", data))
    assert found["properties"] == {"session_expiry_interval": 10, "receive_maximum": 20}
    assert found["will"] == {
        "topic": "w",
        "qos": 0,
        "retain": False,
        "payload": b64(b"x"),
        "properties": {"will_delay_interval": 5},
    }


def test_an_assigned_client_identifier_is_known_from_connack_on() -> None:
    connect = packet(0x10, string("MQTT"), "05 02 0000 00", string(""))
    connack = packet(0x20, "00 00", "09 12", string("auto-1"))
    entries = decode(("in", connect), ("out", connack), ("in", packet(0xC0)))
    assert [one["client_id"] for one in entries] == ["", "auto-1", "auto-1"]
    assert entries[1]["reason_codes"] == [0]


def test_subscribe_and_suback_of_the_specification() -> None:
    # MQTT 3.1.1, figures 3.23 and 3.26.
    subscribe = packet(0x82, "000A", string("a/b"), "01", string("c/d"), "02")
    suback = packet(0x90, "000A", "00 02 80")
    asked, granted = decode(("in", subscribe), ("out", suback))
    assert asked["filters"] == [{"filter": "a/b", "qos": 1}, {"filter": "c/d", "qos": 2}]
    assert (asked["packet_id"], granted["packet_id"], granted["reason_codes"]) == (10, 10, [0, 2, 0x80])


def test_publish_of_the_specification_and_its_acknowledgements() -> None:
    # MQTT 3.1.1, figure 3.11: topic a/b, packet identifier 10.
    publish = packet(0x3D, string("a/b"), "000A", "'21.5")
    entries = decode(("in", publish), *(("out", packet(first, "000A")) for first in (0x50, 0x62, 0x70)))
    assert {
        "topic": "a/b",
        "qos": 2,
        "retain": True,
        "dup": True,
        "packet_id": 10,
        "payload": b64(b"21.5"),
    }.items() <= entries[0].items()
    assert [one["kind"] for one in entries] == ["PUBLISH", "PUBREC", "PUBREL", "PUBCOMP"]
    assert all(one["packet_id"] == 10 for one in entries)


def test_version_5_reasons_may_be_left_out_and_properties_are_read() -> None:
    entries = decode(
        ("in", CONNECT_5),
        ("in", packet(0x32, string("t"), "0001", "05 02 00000064", "'x")),
        ("out", packet(0x40, "0001")),
        ("out", packet(0x40, "0001 10")),
        ("out", packet(0x40, "0001 97 05 1F", string("no"))),
        ("in", packet(0xA2, "0002 00", string("t"))),
        ("out", packet(0xB0, "0002 00 11")),
        ("out", packet(0xE0, "8B 00")),
        ("in", packet(0xE0)),
    )
    assert entries[1]["properties"] == {"message_expiry_interval": 100}
    assert entries[1]["payload"] == b64(b"x")
    assert [one["reason_codes"] for one in entries[2:5]] == [[0], [0x10], [0x97]]
    assert entries[4]["properties"] == {"reason_string": "no"}
    assert entries[5]["filters"] == [{"filter": "t"}]
    assert [one["reason_codes"] for one in entries[6:]] == [[0x11], [0x8B], [0]]


def test_a_topic_alias_stands_for_the_topic_it_was_given_with() -> None:
    named = packet(0x30, string("long/topic"), "03 23 0007", "'1")
    alone = packet(0x30, string(""), "03 23 0007", "'2")
    entries = decode(("in", CONNECT_5), ("in", named), ("in", alone), ("out", alone))
    assert [one.get("topic") for one in entries[1:]] == ["long/topic", "long/topic", ""]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (packet(0x36, string("t"), "0001"), "PUBLISH with QoS 3"),
        (packet(0x80, "0001", string("t"), "00"), "SUBSCRIBE has the flags 0000"),
        (packet(0x82, "0001", string("t"), "05"), "the subscription options have reserved bits set: 00000101"),
        (packet(0x82, "0001", string("t"), "03"), "SUBSCRIBE with QoS 3"),
        (packet(0x82, "0001"), "the packet ends too early"),
        (packet(0x30, "0005", "'abc"), "the packet ends too early"),
        (packet(0x30, "0001 00"), "a string contains U+0000"),
        (packet(0x30, "0001 FF"), "a string is not well-formed UTF-8"),
        (packet(0xC0, "00"), "the packet has 1 bytes too many"),
        (packet(0x10, string("MQTT"), "07 02 0000", string("a")), "protocol level 7 is not supported"),
        (packet(0x10, string("MQTT"), "04 03 0000", string("a")), "the reserved CONNECT flag is set"),
    ],
)
def test_a_packet_that_must_not_be_is_an_entry_of_its_own(data: bytes, reason: str) -> None:
    connected, found = decode(("in", CONNECT), ("in", data))
    assert connected["kind"] == "CONNECT"
    # A CONNECT may hold a password: only its first byte is shown.
    shown = data[:1] if data[0] == CONNECT[0] else data
    assert (found["kind"], found["reason"], found["bytes"]) == ("malformed", reason, shown.hex())
    assert (found["request"], found["state_changing"]) == (False, False)


def test_a_connect_of_mqtt_3_1_is_read() -> None:
    (found,) = decode(("in", packet(0x10, string("MQIsdp"), "03 02 003C", string("old"))))
    assert (found["kind"], found["protocol_level"], found["client_id"]) == ("CONNECT", 3, "old")


@pytest.mark.parametrize(("topic", "shown"), [("0001 FF", "\\xff"), ("0001 00", "\0"), (string("a/#"), "a/#")])
def test_an_illegal_topic_of_a_brokers_message_is_told_and_of_a_clients_is_none(topic: str, shown: str) -> None:
    told, refused = decode(("out", packet(0x30, topic, "'x")), ("in", packet(0x30, topic, "'x")))
    assert (told["kind"], told["topic"], told["payload"]) == ("PUBLISH", shown, b64(b"x"))
    assert (refused["kind"], refused["bytes"][:1]) == ("malformed", "3")


@pytest.mark.parametrize(
    ("properties", "reason"),
    [
        ("02 7F00", "unknown property 127"),
        ("0A 11 00000001 11 00000001", "the property SESSION_EXPIRY_INTERVAL occurs twice"),
        ("03 11 0000", "the packet ends too early"),
    ],
)
def test_properties_that_must_not_be_make_the_packet_malformed(properties: str, reason: str) -> None:
    (found,) = decode(("in", packet(0x10, string("MQTT"), "05 02 0000", properties, string("a"))))
    assert (found["kind"], found["reason"]) == ("malformed", reason)


def test_segments_of_any_size_give_the_same_packets() -> None:
    rng = random.Random(13)
    packets = [CONNECT, CONNACK]
    for size in (0, 1, 121, 122, 127, 128, 16_383, 16_384, 70_000):
        body = b"\0\x01t" + rng.randbytes(size)
        length, encoded = len(body), bytearray()
        while True:
            length, digit = divmod(length, 128)
            encoded.append(digit | (0x80 if length else 0))
            if not length:
                break
        packets.append(b"\x30" + bytes(encoded) + body)
    stream = b"".join(packets)
    for largest in (3, 1000, len(stream)):
        framer, cut, at = Framer(packet_length), [], 0
        while at < len(stream):
            size = rng.randint(1, largest)
            cut += framer.feed(stream[at : at + size])
            at += size
        assert cut == packets
    one_at_a_time = Framer(packet_length)
    assert [frame for byte in stream[:500] for frame in one_at_a_time.feed(bytes([byte]))] == packets[:7]


@pytest.mark.parametrize(
    ("data", "reason"),
    [("30 FFFFFFFF 01", "the Remaining Length has more than four bytes"), ("00 00", "packet type 0 is reserved")],
)
def test_a_stream_that_cannot_be_cut_says_why(data: str, reason: str) -> None:
    framer = Framer(packet_length)
    assert framer.feed(CONNACK + bytes.fromhex(data)) == [CONNACK]
    assert framer.malformed == reason


def test_random_packets_never_make_the_decoder_fail() -> None:
    rng = random.Random(17)
    directions: tuple[Direction, Direction] = ("in", "out")
    for connect in (CONNECT, CONNECT_5):
        conversation = MqttConversation()
        conversation.decode("in", connect)
        for _ in range(5000):
            data = bytes([rng.randrange(16, 256), size := rng.randrange(30)]) + rng.randbytes(size)
            (message,) = conversation.decode(rng.choice(directions), data)
            assert message.kind


def test_each_answer_names_the_packet_that_it_answers() -> None:
    first, second = (packet(0x32, string("t"), f"000{number}") for number in (1, 2))
    subscribe, suback = packet(0x82, "0001", string("t"), "00"), packet(0x90, "0001 00")
    exactly_once = packet(0x34, string("t"), "0003")
    at_most_once = packet(0x30, string("t"))
    entries = decode(
        *(("in", CONNECT), ("out", CONNACK), ("in", first), ("in", second), ("in", subscribe), ("out", suback)),
        *(("out", packet(0x40, "0002")), ("out", packet(0x40, "0001")), ("out", packet(0x40, "0001"))),
        *(("in", exactly_once), ("out", packet(0x50, "0003")), ("in", packet(0x62, "0003"))),
        *(("out", packet(0x70, "0003")), ("in", packet(0xC0)), ("out", packet(0xD0)), ("in", at_most_once)),
        # A message that the broker delivers answers nothing, and the packets that follow it are no requests.
        *(("out", exactly_once), ("in", packet(0x50, "0003")), ("out", packet(0x62, "0003"))),
    )
    assert [one["answers"] for one in entries if one["direction"] == "out"] == [0, 4, 3, 2, None, 9, 11, 13, None, None]
    asking = ("CONNECT", "PUBLISH", "PUBLISH", "SUBSCRIBE", "PUBLISH", "PUBREL", "PINGREQ", "PUBLISH")
    assert tuple(one["kind"] for one in entries if one["request"]) == asking
    assert [one["seq"] for one in entries if one["state_changing"]] == [2, 3, 9, 15]
    assert {one["origin"] for one in entries} == {"client"}
