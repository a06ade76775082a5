"""What broker and edge node do wrong when they are told to, seen by raw sockets and by paho."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest
import pytest_asyncio
from mock_program import PATIENCE_S, MockProgram, RefusedError
from mqtt_tools import Peer, Raw, RunningBroker, connect_bytes, frame, running_broker, utf8
from pytest_otmcp.mocks.mqtt.faults import FaultPlan
from pytest_otmcp.mocks.mqtt.sparkplug import encode_payload

from conftest import StartMock
from pytest_otmcp.wire.mqtt.sparkplug import decode_message

SUBSCRIBE_AB = frame(0x82, b"\0\1", utf8("a"), b"\1", utf8("b"), b"\1")


@pytest.fixture
def broker() -> Iterator[RunningBroker]:
    with running_broker() as running:
        yield running


def connected(broker: RunningBroker, level: int = 4) -> Raw:
    raw = Raw(broker.port).send(connect_bytes("raw", level))
    assert raw.packet()[0] == 0x20
    return raw


def plan(broker: RunningBroker, packet: str, action: dict[str, Any], **conditions: Any) -> None:
    broker.broker.faults = FaultPlan([{"packet": packet, **conditions, "action": action}])


# -- fault rules ----------------------------------------------------------------------------------------------


def test_an_answer_comes_twice_and_the_journal_has_both(broker: RunningBroker) -> None:
    plan(broker, "PUBLISH", {"duplicate": True}, times=1)
    with connected(broker) as raw:
        raw.send(frame(0x32, utf8("a"), b"\0\1"), frame(0xC0))
        assert [raw.packet() for _ in range(3)] == [(0x40, b"\0\1"), (0x40, b"\0\1"), (0xD0, b"")]
    [asked] = broker.entries(kind="PUBLISH")
    assert asked["fault"] == {"duplicate": True}
    assert [(one["answers"], one.get("duplicate")) for one in broker.entries(kind="PUBACK")] == [
        (asked["seq"], None),
        (asked["seq"], True),
    ]


@pytest.mark.parametrize(("packet", "sent"), [("CONNECT", b""), ("PINGREQ", frame(0xC0))])
def test_an_answer_comes_byte_by_byte(broker: RunningBroker, packet: str, sent: bytes) -> None:
    plan(broker, packet, {"drip_s": 0.1}, times=1)
    began = time.monotonic()
    with Raw(broker.port).send(connect_bytes("raw")) as raw:
        if sent:
            assert raw.packet() == (0x20, b"\0\0")
            began = time.monotonic()
            raw.send(sent)
        answer = (0xD0, b"") if sent else (0x20, b"\0\0")
        assert raw.packet() == answer
    # How many bytes a reader finds at once says when it looked; that the last one came late says how they were sent.
    assert time.monotonic() - began >= 0.1 * (1 + len(answer[1])) - 0.01
    kind = "PINGRESP" if sent else "CONNACK"
    assert [one["drip_s"] for one in broker.entries(kind=kind)] == [0.1]


@pytest.mark.parametrize(("level", "answer"), [(4, b"\0\5"), (5, b"\0\x87\0")], ids=["3.1.1", "5"])
def test_an_account_is_refused_in_the_words_of_each_version(broker: RunningBroker, level: int, answer: bytes) -> None:
    plan(broker, "CONNECT", {"reason_code": 0x87})
    with Raw(broker.port).send(connect_bytes("raw", level)) as raw:
        assert raw.packet() == (0x20, answer)


def test_an_answer_is_mangled_and_the_journal_has_the_bytes(broker: RunningBroker) -> None:
    plan(broker, "PINGREQ", {"mangle": {"flip": [[0, 255]], "append": "ff", "end": True}}, times=1)
    with Raw(broker.port).send(connect_bytes("raw")) as raw:
        assert raw.packet() == (0x20, b"\0\0")
        raw.send(frame(0xC0))
        assert [raw.socket.recv(100), raw.socket.recv(100)] == [bytes.fromhex("2f00ff"), b""]
    assert [one["bytes"] for one in broker.entries(kind="mangled")] == ["2f00ff"]
    assert broker.entries(kind="PINGRESP") == []


def test_a_half_open_connection_is_dead_and_others_are_served(broker: RunningBroker) -> None:
    plan(broker, "PUBLISH", {"half_open": True}, topic="a")
    with connected(broker) as raw, Peer(broker.port, "other") as other:
        other.subscribe("a")
        raw.send(frame(0x32, utf8("a"), b"\0\1x"))
        broker.wait(kind="PUBLISH")
        raw.send(frame(0xC0))
        assert broker.wait(kind="lost")[0]["count"] == 2
        assert other.nothing_more()
        assert broker.entries(kind="DISCONNECTED") == []
    broker.wait(kind="DISCONNECTED", client_id="raw")


@pytest.mark.parametrize("qos", [0, 1, 2])
def test_a_publish_is_acknowledged_and_lost(broker: RunningBroker, qos: int) -> None:
    plan(broker, "PUBLISH", {"ack_only": True}, topic="a", skip=1)
    with Peer(broker.port, "peer") as peer:
        peer.subscribe("a", 2)
        peer.publish("a", b"first", qos)
        assert peer.payloads(1) == [b"first"]
        assert peer.publish("a", b"second", qos) == 0
        assert peer.nothing_more()


@pytest.mark.parametrize(("level", "expected"), [(5, frame(0xE0, b"\x8b")), (4, b"")])
def test_a_client_is_disconnected_with_a_reason(broker: RunningBroker, level: int, expected: bytes) -> None:
    plan(broker, "PINGREQ", {"disconnect": 0x8B})
    with connected(broker, level) as raw:
        raw.send(frame(0xC0))
        assert raw.rest()[: len(expected)] == expected
    broker.wait(kind="DISCONNECTED")
    assert [one["reason_codes"] for one in broker.entries(kind="DISCONNECT")] == ([[0x8B]] if level == 5 else [])


def test_one_filter_of_a_subscribe_is_refused(broker: RunningBroker) -> None:
    plan(broker, "SUBSCRIBE", {"reason_code": 0x80}, topic="a")
    with connected(broker) as raw, Peer(broker.port, "other") as other:
        raw.send(SUBSCRIBE_AB)
        assert raw.packet() == (0x90, b"\0\1\x80\1")
        other.publish("a", b"x", 1)
        other.publish("b", b"y")
        assert raw.packet() == (0x30, b"\0\1by")
    assert broker.entries(kind="SUBACK")[0]["reason_codes"] == [0x80, 1]


@pytest.mark.parametrize(
    ("rule", "sentence"),
    [
        ({"packet": "SUBSCRIBE", "action": {"ack_only": True}}, "ack_only is about PUBLISH, not SUBSCRIBE"),
        ({"packet": "CONNECT", "action": {"disconnect": 0x8B}}, "refused with a reason_code"),
        ({"packet": "PUBLISH", "action": {"disconnect": 0}}, "expected an integer from 128 to 255"),
        ({"packet": "PUBLISH", "skip": -1, "action": {"drip_s": 1}}, "cannot have -1 as 'skip'"),
    ],
)
def test_a_rule_that_makes_no_sense_is_refused(rule: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        FaultPlan([rule])


# -- pokes ----------------------------------------------------------------------------------------------------


@pytest_asyncio.fixture
async def mqtt(start_mock: StartMock) -> MockProgram:
    return await start_mock("mqtt")


@contextlib.asynccontextmanager
async def client(mqtt: MockProgram, *filters: str, version: int = 5, client_id: str = "client") -> AsyncIterator[Peer]:
    """Connect paho and subscribe, in a thread because it blocks."""

    def connect() -> Peer:
        peer = Peer(mqtt.port, client_id, version=version).connect()
        for one in filters:
            peer.subscribe(one)
        return peer

    peer = await asyncio.to_thread(connect)
    try:
        yield peer
    finally:
        await asyncio.to_thread(peer.disconnect)


def encoded(data: bytes) -> str:
    return base64.b64encode(data).decode()


@pytest.mark.long
@pytest.mark.asyncio
async def test_a_burst_arrives_whole_in_order_and_fast(mqtt: MockProgram) -> None:
    async with client(mqtt, "flood/#") as peer:
        began = time.monotonic()
        await mqtt.control.poke(burst={"topic": "flood/{n}", "count": 5000, "size": 20})
        published_s = time.monotonic() - began
        found = await asyncio.to_thread(lambda: [peer.next() for _ in range(5000)])
    assert [one.payload for one in found] == [str(number).encode().ljust(20) for number in range(5000)]
    assert [one.topic for one in found[:2]] == ["flood/0", "flood/1"]
    assert len(await mqtt.control.journal(kind="PUBLISH", direction="out", client_id="client")) == 5000
    assert published_s < PATIENCE_S


@pytest.mark.asyncio
async def test_a_brief_burst_arrives_whole_and_has_an_entry_for_each_connection(mqtt: MockProgram) -> None:
    async with client(mqtt, "flood/#") as peer, client(mqtt, "flood/1", client_id="other") as other:
        await mqtt.control.poke(burst={"topic": "flood/1", "count": 700, "brief": True})
        await mqtt.control.poke(publish={"topic": "flood/1", "payload": encoded(b"later")})
        found = await asyncio.to_thread(lambda: [peer.next() for _ in range(701)])
        last = await asyncio.to_thread(lambda: [other.next() for _ in range(701)][-1])
    assert [one.payload for one in found] == [*(str(number).encode() for number in range(700)), b"later"]
    assert last.payload == b"later"
    entries = await mqtt.control.journal(topic="flood/1")
    assert [(one["kind"], one["origin"], one["client_id"], one.get("count")) for one in entries] == [
        ("BURST", "kit", "otmcp-kit", 700),
        ("BURST", "client", "client", 700),
        ("BURST", "client", "other", 700),
        ("PUBLISH", "kit", "otmcp-kit", None),
        ("PUBLISH", "client", "client", None),
        ("PUBLISH", "client", "other", None),
    ]


@pytest.mark.asyncio
async def test_a_burst_keeps_its_rate(mqtt: MockProgram) -> None:
    began = time.monotonic()
    await mqtt.control.poke(burst={"topic": "f", "count": 20, "rate_per_s": 100})
    assert time.monotonic() - began >= 0.19


@pytest.mark.asyncio
@pytest.mark.parametrize(
    ("place", "on_the_wire", "shown"),
    [
        ({"topic": "x/\0\x1b[31m\u202e"}, "x/\0\x1b[31m\u202e".encode(), "x/\0\x1b[31m\u202e"),
        ({"topic_bytes": encoded(b"x/\xc3\x28")}, b"x/\xc3\x28", "x/\\xc3("),
    ],
)
async def test_any_topic_and_payload_are_published(
    mqtt: MockProgram, place: dict[str, str], on_the_wire: bytes, shown: str
) -> None:
    payload = b"\xff\0\x1b]0;\xe2\x80\xae"
    raw = Raw(mqtt.port).send(connect_bytes("raw"), frame(0x82, b"\0\1", utf8("x/#"), b"\0"))
    with raw:
        assert [raw.packet()[0] for _ in range(2)] == [0x20, 0x90]
        await mqtt.control.poke(publish={**place, "payload": encoded(payload), "retain": True})
        assert await asyncio.to_thread(raw.packet) == (0x30, bytes([0, len(on_the_wire)]) + on_the_wire + payload)
    [entry] = await mqtt.control.journal(kind="PUBLISH", origin="kit")
    assert (entry["topic"], entry["payload"]) == (shown, encoded(payload))
    json.dumps(await mqtt.control.image()).encode()


@pytest.mark.asyncio
async def test_all_clients_are_disconnected_with_a_reason(mqtt: MockProgram) -> None:
    async with client(mqtt) as peer:
        await mqtt.control.poke(disconnect={"reason_code": 0x8B})
        code = await asyncio.to_thread(peer.disconnects.get, timeout=PATIENCE_S)
        assert code.value == 0x8B
    assert (await mqtt.control.image())["edge_node"]["connected"]
    with pytest.raises(RefusedError, match="no client 'nobody' is connected"):
        await mqtt.control.poke(disconnect={"client_id": "nobody", "reason_code": 0x8B})


@pytest.mark.asyncio
async def test_a_black_hole_swallows_clients_and_spares_the_plant(mqtt: MockProgram) -> None:
    await mqtt.control.poke(network="black_hole")
    with Raw(mqtt.port).send(connect_bytes("raw")) as raw:
        await mqtt.control.wait(kind="lost")
        assert await mqtt.control.journal(kind="CONNECT", client_id="raw") == []
        await mqtt.control.ask("tick", steps=1)
        await mqtt.control.ask("reset")
        assert await mqtt.control.journal(origin="client", direction="out") == []
        raw.socket.settimeout(0.2)
        with pytest.raises(TimeoutError):
            raw.socket.recv(1)
    with Raw(mqtt.port).send(connect_bytes("raw")) as raw:
        assert (await asyncio.to_thread(raw.packet))[0] == 0x20


# -- Sparkplug ------------------------------------------------------------------------------------------------

NODE = "spBv1.0/factory/{}/edge-node-1"


def metrics(message: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = decode_message(message.topic, message.payload)["metrics"]
    return found


@pytest.mark.asyncio
async def test_births_have_aliases_and_data_has_nothing_else(mqtt: MockProgram) -> None:
    async with client(mqtt, NODE.format("DBIRTH") + "/device-1", NODE.format("DDATA") + "/device-1") as peer:
        await mqtt.control.poke(edge_node={"aliases": True})
        birth = metrics(await asyncio.to_thread(peer.next))
        aliases = {one["alias"]: one["name"] for one in birth}
        assert sorted(aliases.values()) == ["pressure", "running", "setpoint", "temperature"]
        await mqtt.control.ask("tick", steps=1)
        data = metrics(await asyncio.to_thread(peer.next))
        assert [(one["name"], aliases[one["alias"]]) for one in data] == [(None, "temperature"), (None, "pressure")]
        setpoint = next(alias for alias, name in aliases.items() if name == "setpoint")
        order = {"alias": setpoint, "datatype": "Double", "value": 33.5}
        await mqtt.control.poke(
            command={"group": "factory", "edge_node": "edge-node-1", "device": "device-1", "metrics": [order]}
        )
        done = metrics(await asyncio.to_thread(peer.next))
        assert [(one["alias"], one["value"]) for one in done] == [(setpoint, 33.5)]
    assert (await mqtt.control.image())["points"]["edge_node/device-1/setpoint"] == 33.5


SPECIAL = {
    "Int8": -128,
    "Int16": -32768,
    "Int32": -1,
    "Int64": -(2**63),
    "UInt8": 255,
    "UInt16": 65535,
    "UInt32": 2**32 - 1,
    "UInt64": 2**53 + 1,
    "Float": "-Infinity",
    "Double": "NaN",
    "Boolean": True,
    "String": "a\0\x1b\u202e",
    "DateTime": 2**53 + 1,
    "Text": "",
    "UUID": "00000000-0000-0000-0000-000000000000",
    "DataSet": {"columns": ["n", "x"], "types": ["Int32", "Double"], "rows": [[-1, "NaN"], [None, 0.5]]},
    "Bytes": encoded(b"\0\xff"),
    "File": encoded(b""),
}


@pytest.mark.asyncio
async def test_metrics_of_every_datatype_have_special_values(mqtt: MockProgram) -> None:
    wanted = [{"device": "new", "name": kind, "datatype": kind, "value": value} for kind, value in SPECIAL.items()]
    nothing = {"device": "new", "name": "null", "datatype": "Int32", "value": None}
    async with client(mqtt, NODE.format("+") + "/new") as peer:
        await mqtt.control.poke(edge_node={"metrics": [*wanted, nothing]})
        birth = await asyncio.to_thread(peer.next)
        assert birth.topic == NODE.format("DBIRTH") + "/new"
        found = {one["name"]: one for one in metrics(birth)}
        await mqtt.control.poke(edge_node={"metrics": [{**wanted[2], "value": -2}]})
        data = await asyncio.to_thread(peer.next)
        assert data.topic == NODE.format("DDATA") + "/new"
        assert [one["value"] for one in metrics(data)] == [-2]
    assert found.pop("null")["is_null"] is True
    assert {kind: one["value"] for kind, one in found.items() if kind != "DataSet"} == {
        kind: value for kind, value in SPECIAL.items() if kind != "DataSet"
    }
    assert found["DataSet"]["value"]["columns"] == ["n", "x"]
    assert sorted(one["datatype"] for one in found.values()) == list(range(1, 19))
    points = (await mqtt.control.image())["points"]
    assert points["edge_node/new/Double"] == "NaN"
    assert points["edge_node/new/DataSet"] == SPECIAL["DataSet"]


@pytest.mark.asyncio
async def test_the_node_dies_stays_away_and_is_born_again(mqtt: MockProgram) -> None:
    async with client(mqtt, NODE.format("NDEATH"), NODE.format("NBIRTH"), NODE.format("DDEATH") + "/+") as peer:
        await mqtt.control.poke(edge_node={"death": "device-2"})
        await mqtt.control.poke(edge_node={"offline": True})
        dead = [(await asyncio.to_thread(peer.next)).topic for _ in range(2)]
        assert dead == [NODE.format("DDEATH") + "/device-2", NODE.format("NDEATH")]
        assert not (await mqtt.control.image())["edge_node"]["connected"]
        with pytest.raises(RefusedError, match="the edge node is offline"):
            await mqtt.control.poke(edge_node={"rebirth": True})
        await mqtt.control.poke(edge_node={"offline": False})
        assert (await asyncio.to_thread(peer.next)).topic == NODE.format("NBIRTH")
        await mqtt.control.poke(edge_node={"cut": True})
        again = [(await asyncio.to_thread(peer.next)).topic for _ in range(2)]
        assert again == [NODE.format("NDEATH"), NODE.format("NBIRTH")]


@pytest.mark.asyncio
async def test_sequence_numbers_are_left_out(mqtt: MockProgram) -> None:
    seq = (await mqtt.control.image())["edge_node"]["seq"]
    await mqtt.control.poke(edge_node={"skip_seq": 3})
    since = await mqtt.control.next()
    await mqtt.control.ask("tick", steps=1)
    [first, *_] = await mqtt.control.wait(since, kind="PUBLISH", direction="in", origin="plant")
    assert first["sparkplug"]["seq"] == seq + 4


@pytest.mark.asyncio
async def test_a_host_commands_the_clients_node(mqtt: MockProgram) -> None:
    rebirth = {"name": "Node Control/Rebirth", "datatype": "Boolean", "value": True}
    async with client(mqtt, "spBv1.0/g/NCMD/mine", "spBv1.0/g/DCMD/mine/#") as peer:
        await mqtt.control.poke(command={"group": "g", "edge_node": "mine", "metrics": [rebirth]})
        asked = await asyncio.to_thread(peer.next)
        assert asked.topic == "spBv1.0/g/NCMD/mine"
        [entry] = await mqtt.control.journal(origin="kit", kind="PUBLISH")
        expected = encode_payload([rebirth], timestamp=entry["sparkplug"]["timestamp"], seq=None)
        assert asked.payload == expected
        await mqtt.control.poke(command={"group": "g", "edge_node": "mine", "device": "d", "metrics": [rebirth]})
        assert (await asyncio.to_thread(peer.next)).topic == "spBv1.0/g/DCMD/mine/d"


@pytest.mark.asyncio
async def test_pokes_that_are_not_understood_are_refused_in_a_sentence(mqtt: MockProgram) -> None:
    one = {"device": "d", "name": "m", "datatype": "Int8", "value": 1}
    for params, sentence in (
        ({"burst": {}, "disconnect": {}}, "has one member"),
        ({"burst": {"count": 3}}, "burst: expected an object with topic, count"),
        ({"burst": {"topic": "a", "count": 3, "speed": 1}}, "unknown member 'speed'"),
        ({"burst": {"topic": "a/#", "count": 3}}, "contains a wildcard"),
        ({"burst": {"topic": "a", "count": 3, "qos": 1, "brief": True}}, "brief is for QoS 0, found QoS 1"),
        ({"command": {"group": "g", "edge_node": "n", "metrics": [{}]}}, "a metric is"),
        ({"disconnect": {"reason_code": 0}}, "expected an integer from 128 to 255"),
        ({"edge_node": {"explode": True}}, "unknown member 'explode'"),
        ({"edge_node": {"death": "device-9"}}, "there is no device 'device-9'"),
        ({"edge_node": {"metrics": [{**one, "value": 128}]}}, "128 is no value of Int8"),
        ({"edge_node": {"metrics": [{**one, "datatype": "Int7"}]}}, "unknown datatype 'Int7'"),
        ({"edge_node": {"metrics": [{**one, "colour": 1}]}}, "edge_node: a metric is"),
    ):
        with pytest.raises(RefusedError) as refused:
            await mqtt.control.poke(**params)
        assert sentence in str(refused.value)
