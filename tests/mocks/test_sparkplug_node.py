"""The Sparkplug payload against bytes written by hand, and the edge node against the rules of Sparkplug 3.0."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import random
import shutil
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import Any

import pytest
import pytest_asyncio
from mock_program import MockProgram, RefusedError
from mqtt_tools import PATIENCE_S, Peer
from own_journal import OwnJournal
from pytest_otmcp.mocks.mqtt.device import MqttDevice
from pytest_otmcp.mocks.mqtt.sparkplug import encode_payload
from pytest_otmcp.mocks.sparkplug.simulator import broker_address

from pytest_otmcp.protocols.mqtt.decoder import MqttConversation
from pytest_otmcp.session.free_port import free_port
from pytest_otmcp.wire.mqtt.sparkplug import decode_message

NODE = "spBv1.0/factory/{}/edge-node-1"
DDATA = "spBv1.0/g/DDATA/n/d"


# -- the payload ----------------------------------------------------------------------------------------------

# These bytes were written by hand from section 6.4: Payload.timestamp is field 1, .metrics 2, .seq 3; Metric.name 1,
# .timestamp 3, .datatype 4, then the value: 10 int, 11 long, 12 float, 13 double, 14 boolean, 15 string, 16 bytes.
VALUES = {
    ("Double", 10, 20.5): "69" + struct.pack("<d", 20.5).hex(),
    ("Float", 9, 0.25): "65" + struct.pack("<f", 0.25).hex(),
    ("Boolean", 11, True): "7001",
    ("Boolean", 11, False): "7000",
    ("Int8", 1, -1): "50ffffffff0f",
    ("Int32", 3, -5): "50fbffffff0f",
    ("UInt32", 7, 4_294_967_295): "50ffffffff0f",
    ("Int64", 4, -1): "58ffffffffffffffffff01",
    ("UInt64", 8, 2**63): "5880808080808080808001",
    ("DateTime", 13, 300): "58ac02",
    ("String", 12, "ü"): "7a02c3bc",
    ("UUID", 15, "x"): "7a0178",
}


@pytest.mark.parametrize(("datatype", "number", "value"), VALUES)
def test_a_payload_has_the_bytes_of_the_specification(datatype: str, number: int, value: Any) -> None:
    metric = bytes.fromhex("0a0174" + "1801" + f"20{number:02x}" + VALUES[datatype, number, value])
    expected = bytes.fromhex("0801") + bytes([0x12, len(metric)]) + metric + bytes.fromhex("1803")
    metrics = [{"name": "t", "datatype": datatype, "value": value}]
    assert encode_payload(metrics, timestamp=1, seq=3) == expected
    assert decode_message(DDATA, expected) == {
        "group": "g",
        "type": "DDATA",
        "edge_node": "n",
        "device": "d",
        "seq": 3,
        "timestamp": 1,
        "metrics": [{"name": "t", "alias": None, "datatype": number, "value": value, "is_null": False}],
    }


def test_a_death_certificate_has_no_sequence_number() -> None:
    metrics = [{"name": "bdSeq", "datatype": "Int64", "value": 0}]
    data = encode_payload(metrics, timestamp=1, seq=None)
    assert data == bytes.fromhex("0801 120d 0a0562645365711801 2004 5800")
    assert decode_message(NODE.format("NDEATH"), data)["seq"] is None


def test_aliases_nulls_and_bytes_are_read() -> None:
    data = bytes.fromhex("1204 1007 3801" + "1207 1000 8201 02 00ff")
    assert decode_message(DDATA, data)["metrics"] == [
        {"name": None, "alias": 7, "datatype": None, "value": None, "is_null": True},
        {"name": None, "alias": 0, "datatype": None, "value": "AP8=", "is_null": False},
    ]


def test_a_data_set_is_read() -> None:
    # Metric.dataset_value (17): one column "c" of type 3, one row with the int 7.
    data = bytes.fromhex("1215 0a0164 2010 8a010d 0801 120163 1803 2204 0a02 0807".replace(" ", ""))
    [metric] = decode_message(DDATA, data)["metrics"]
    assert metric["name"] == "d"
    assert metric["value"] == {"columns": ["c"], "rows": [[7]]}


@pytest.mark.parametrize("data", [b"\xff", b"\x12\x05ab", b"\x12\x03\x0a\x01\xff", b"hello", b'{"a": 1}'])
def test_what_is_no_payload_is_reported(data: bytes) -> None:
    assert (decode_message(DDATA, data) or {})["error"]


@pytest.mark.parametrize("topic", ["spBv1.0/g/DDATA", "spBv1.0/g/DDATA/n/d/x", "other/g/DDATA/n"])
def test_what_is_no_sparkplug_topic_is_reported(topic: str) -> None:
    assert decode_message(topic, b"") is None


def test_damaged_payloads_are_described_and_nothing_else_happens() -> None:
    rng = random.Random(3)
    metrics = [
        {"name": "temperature", "datatype": "Double", "value": 1.5},
        {"name": "count", "datatype": "Int64", "value": -3},
        {"name": "label", "datatype": "String", "value": "äöü"},
    ]
    whole = encode_payload(metrics, timestamp=1_700_000_000_000, seq=255)
    errors = 0
    for _ in range(3000):
        data = bytearray(whole)
        for _ in range(rng.randrange(1, 5)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        message = decode_message(DDATA, bytes(data))
        json.dumps(message)
        errors += "error" in message
    assert 0 < errors < 3000


# -- the edge node in the device ------------------------------------------------------------------------------


class Plant:
    """A device on a port, with the operations that the tests need."""

    def __init__(self, device: MqttDevice, port: int) -> None:
        self.device, self.port = device, port
        self.entries = OwnJournal(device.journal, MqttConversation)

    def messages(self, since: int = 0) -> list[Any]:
        """Return the Sparkplug messages of the edge node, as the broker journalled them."""
        return [
            entry
            for entry in self.entries.since(since)
            if entry["kind"] == "PUBLISH" and entry["direction"] == "in" and "sparkplug" in entry
            if entry["client_id"] == "otmcp-mock-edge-node-1"
        ]

    @contextlib.asynccontextmanager
    async def client(self) -> AsyncIterator[Peer]:
        """Connect a client, in a thread because it blocks."""
        peer = await asyncio.to_thread(Peer(self.port, "client").connect)
        try:
            yield peer
        finally:
            await asyncio.to_thread(peer.disconnect)

    async def wait(self, since: int, count: int = 1, **match: Any) -> list[Any]:
        """Return journal entries as soon as there are ``count`` of them."""
        entries = await self.entries.wait(since, match, count, PATIENCE_S)
        assert len(entries) >= count, match
        return entries

    async def send(self, topic: str, payload: bytes) -> int:
        """Publish a command; return the journal's next sequence number before it."""
        since = self.entries.next
        await self.device.poke({"publish": {"topic": topic, "payload": base64.b64encode(payload).decode(), "qos": 1}})
        return since


@pytest_asyncio.fixture
async def plant() -> AsyncIterator[Plant]:
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    device = MqttDevice()
    try:
        await device.serve({"mqtt": listener})
        yield Plant(device, listener.getsockname()[1])
    finally:
        await device.aclose()
        listener.close()


def metric(name: str, datatype: str, value: Any) -> dict[str, Any]:
    return {"name": name, "datatype": datatype, "value": value}


def command(*metrics: dict[str, Any]) -> bytes:
    return encode_payload(list(metrics), timestamp=1, seq=None)


REBIRTH = command(metric("Node Control/Rebirth", "Boolean", True))


def kinds(entries: list[Any]) -> list[tuple[str, str | None, int | None]]:
    return [(one["sparkplug"]["type"], one["sparkplug"]["device"], one["sparkplug"]["seq"]) for one in entries]


@pytest.mark.asyncio
async def test_the_edge_node_is_born_before_clients_are_let_in(plant: Plant) -> None:
    entries = plant.entries.since(0)
    connect = next(entry for entry in entries if entry["kind"] == "CONNECT")
    assert (connect["connection"], connect["clean_start"]) == (1, True)
    will = connect["will"]
    assert (will["topic"], will["qos"], will["retain"]) == (NODE.format("NDEATH"), 1, False)
    assert will["sparkplug"]["seq"] is None
    assert [(one["name"], one["datatype"], one["value"]) for one in will["sparkplug"]["metrics"]] == [("bdSeq", 4, 0)]
    subscribed = next(entry for entry in entries if entry["kind"] == "SUBSCRIBE")
    assert {"filter": NODE.format("NCMD"), "qos": 1} in subscribed["filters"]
    births = plant.messages()
    assert kinds(births) == [("NBIRTH", None, 0), ("DBIRTH", "device-1", 1), ("DBIRTH", "device-2", 2)]
    assert all((one["qos"], one["retain"]) == (0, False) for one in births)
    assert births[0]["seq"] > subscribed["seq"]
    node = {one["name"]: (one["datatype"], one["value"]) for one in births[0]["sparkplug"]["metrics"]}
    controls = {"Node Control/Rebirth": (11, False), "Node Control/Scan Rate": (4, 1_000)}
    assert node == {"bdSeq": (4, 0), **controls}


@pytest.mark.asyncio
async def test_a_tick_publishes_data_of_both_devices_and_the_plain_sensors(plant: Plant) -> None:
    since = plant.entries.next
    await plant.device.tick()
    assert kinds(plant.messages(since)) == [("DDATA", "device-1", 3), ("DDATA", "device-2", 4)]
    topics = [entry["topic"] for entry in plant.entries.since(since) if entry["kind"] == "PUBLISH"]
    assert topics[2:] == ["sensors/temperature", "sensors/pressure", "sensors/humidity"]
    declared = {
        (one["sparkplug"]["device"], m["name"]): m["datatype"]
        for one in plant.messages()
        for m in one["sparkplug"]["metrics"]
        if one["sparkplug"]["type"] == "DBIRTH"
    }
    for one in plant.messages(since):
        for m in one["sparkplug"]["metrics"]:
            assert declared[one["sparkplug"]["device"], m["name"]] == m["datatype"]


@pytest.mark.asyncio
async def test_one_sequence_number_counts_all_messages_and_wraps(plant: Plant) -> None:
    for _ in range(140):
        await plant.device.tick()
    numbers = [entry["sparkplug"]["seq"] for entry in plant.messages()]
    assert numbers == [number % 256 for number in range(283)]


@pytest.mark.asyncio
async def test_values_are_a_function_of_the_ticks(plant: Plant) -> None:
    seen = []
    for _ in range(2):
        for _ in range(5):
            await plant.device.tick()
        seen.append(plant.device.image()["edge_node"]["devices"])
        await plant.device.reset()
    assert seen[0] == seen[1]
    assert seen[0]["device-1"]["temperature"] == pytest.approx(22.5)


@pytest.mark.asyncio
async def test_a_rebirth_command_repeats_the_births_with_the_same_bd_seq(plant: Plant) -> None:
    await plant.device.tick()
    since = await plant.send(NODE.format("NCMD"), REBIRTH)
    await plant.wait(since, topic=NODE.format("DBIRTH") + "/device-2", direction="in")
    births = plant.messages(since)
    assert kinds(births) == [("NBIRTH", None, 0), ("DBIRTH", "device-1", 1), ("DBIRTH", "device-2", 2)]
    assert births[0]["sparkplug"]["metrics"][0]["value"] == 0
    await plant.device.tick()
    assert kinds(plant.messages(since))[3] == ("DDATA", "device-1", 3)


@pytest.mark.asyncio
@pytest.mark.parametrize(
    "payload",
    [command(metric("Node Control/Rebirth", "Boolean", False)), command(metric("Other", "Boolean", True)), b"\xff"],
    ids=["false", "another metric", "garbage"],
)
async def test_other_node_commands_change_nothing(plant: Plant, payload: bytes) -> None:
    since = await plant.send(NODE.format("NCMD"), payload)
    await plant.wait(since, kind="PUBACK", direction="in")
    await plant.device.tick()
    assert kinds(plant.messages(since))[0] == ("DDATA", "device-1", 3)


@pytest.mark.asyncio
async def test_a_scan_rate_is_kept_and_told(plant: Plant) -> None:
    since = await plant.send(NODE.format("NCMD"), command(metric("Node Control/Scan Rate", "Int64", 250)))
    [told] = await plant.wait(since, topic=NODE.format("NDATA"), direction="in")
    assert [(one["name"], one["value"]) for one in told["sparkplug"]["metrics"]] == [("Node Control/Scan Rate", 250)]
    assert plant.device.image()["edge_node"]["scan_rate"] == 250


@pytest.mark.asyncio
async def test_a_device_command_is_obeyed_and_echoed(plant: Plant) -> None:
    writes = command(metric("speed", "Int32", -42), metric("recipe", "String", "strong"))
    since = await plant.send(NODE.format("DCMD") + "/device-2", writes)
    [echo] = await plant.wait(since, topic=NODE.format("DDATA") + "/device-2", direction="in")
    assert [(m["name"], m["value"]) for m in echo["sparkplug"]["metrics"]] == [("speed", -42), ("recipe", "strong")]
    assert echo["sparkplug"]["seq"] == 3
    await plant.device.tick()
    held = plant.device.image()["edge_node"]["devices"]["device-2"]
    assert (held["speed"], held["recipe"]) == (-42, "strong")


@pytest.mark.asyncio
@pytest.mark.parametrize(
    ("device", "wrong"),
    [
        ("device-2", metric("level", "Float", 1.0)),
        ("device-2", metric("speed", "Double", 1.0)),
        ("device-2", metric("Speed", "Int32", 1)),
        ("device-3", metric("speed", "Int32", 1)),
    ],
    ids=["not writable", "another type", "unknown metric", "unknown device"],
)
async def test_a_device_command_that_does_not_fit_changes_nothing(plant: Plant, device: str, wrong: Any) -> None:
    before = plant.device.image()["edge_node"]["devices"]
    since = await plant.send(NODE.format("DCMD") + f"/{device}", command(wrong))
    await plant.wait(since, kind="PUBACK", direction="in")
    assert plant.device.image()["edge_node"]["devices"] == before
    assert plant.messages(since) == []


@pytest.mark.asyncio
async def test_a_lost_connection_is_death_and_the_next_birth_has_the_next_bd_seq(plant: Plant) -> None:
    plant.device.fault(
        [{"packet": "PINGREQ", "client_id": "otmcp-mock-edge-node-1", "times": 1, "action": {"reset": True}}]
    )
    since = plant.entries.next
    await plant.device.tick()
    [death] = await plant.wait(since, kind="WILL")
    assert (death["topic"], death["sparkplug"]["metrics"][0]["value"]) == (NODE.format("NDEATH"), 0)
    [birth] = await plant.wait(since, topic=NODE.format("NBIRTH"), direction="in")
    assert (birth["sparkplug"]["seq"], birth["sparkplug"]["metrics"][0]["value"]) == (0, 1)
    await plant.device.reset()
    assert plant.device.image()["edge_node"]["bd_seq"] == 1


@pytest.mark.asyncio
async def test_an_orderly_end_publishes_the_death_before_the_disconnect(plant: Plant) -> None:
    since = plant.entries.next
    await plant.device.edge_node.aclose()
    await plant.wait(since, kind="DISCONNECT")
    entries = [entry["kind"] for entry in plant.entries.since(since) if entry["direction"] == "in"]
    assert entries[:2] == ["PUBLISH", "DISCONNECT"]
    assert "WILL" not in entries


# -- the device as a whole ------------------------------------------------------------------------------------


@pytest.mark.asyncio
async def test_the_image_shows_what_the_broker_and_the_plant_hold(plant: Plant) -> None:
    await plant.send("control/pump", b'{"pump_speed": 50}')
    await plant.wait(0, topic="control/pump", direction="out")
    await plant.wait(0, kind="PUBACK", direction="in")
    image = plant.device.image()
    assert list(image["retained"]) == ["system/status"]
    assert json.loads(base64.b64decode(image["retained"]["system/status"])) == {"online": True}
    [client] = image["clients"]
    assert (client["client_id"], client["connection"]) == ("otmcp-mock-edge-node-1", 1)
    assert image["edge_node"]["controls"] == {"control/pump": '{"pump_speed": 50}'}
    json.dumps(image)


@pytest.mark.asyncio
async def test_a_poke_is_a_message_from_the_kit(plant: Plant) -> None:
    async with plant.client() as client:
        await asyncio.to_thread(client.subscribe, "sensors/#", 1)
        since = await plant.send("sensors/pressure", b"nonce")
        message = await asyncio.to_thread(client.next)
    assert (message.topic, message.payload, message.qos) == ("sensors/pressure", b"nonce", 1)
    entry = plant.entries.since(since)[0]
    assert (entry["connection"], entry["client_id"], entry["direction"]) == (0, "otmcp-kit", "in")


@pytest.mark.asyncio
async def test_a_reset_restores_start_up_values_and_keeps_connections(plant: Plant) -> None:
    async with plant.client() as client:
        await asyncio.to_thread(client.subscribe, "sensors/#")
        await asyncio.to_thread(client.publish, "other", b"kept", 1, retain=True)
        await plant.send(NODE.format("DCMD") + "/device-2", command(metric("speed", "Int32", 5)))
        await plant.wait(0, topic=NODE.format("DDATA") + "/device-2", direction="in")
        plant.device.fault([{"packet": "PUBLISH", "client_id": "client", "action": {"close": True}}])
        since = plant.entries.next
        await plant.device.reset()
        image = plant.device.image()
        assert image["edge_node"]["devices"]["device-2"]["speed"] == -10
        assert list(image["retained"]) == ["system/status"]
        assert "client" in [one["client_id"] for one in image["clients"]]
        assert kinds(plant.messages(since))[0] == ("NBIRTH", None, 0)
        assert await asyncio.to_thread(client.publish, "after", b"x", 1) in (0, 0x10)


# -- programs -------------------------------------------------------------------------------------------------


@pytest.fixture
def foreign_broker() -> Iterator[int]:
    """The port of a broker that is no part of the product."""
    mosquitto = shutil.which("mosquitto")
    if mosquitto is None:
        pytest.skip("mosquitto is not installed: the edge node was not tried at a foreign broker")
    port = free_port(socket.socket)
    broker = subprocess.Popen([mosquitto, "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        assert broker.stderr is not None
        # "mosquitto version … running" is its last line before it serves.
        assert any(line.endswith(b" running\n") for line in iter(broker.stderr.readline, b""))
        yield port
    finally:
        broker.send_signal(signal.SIGTERM)
        broker.communicate(timeout=PATIENCE_S)


@pytest.mark.asyncio
async def test_the_simulator_lives_at_a_foreign_broker(
    foreign_broker: int, start_mock: Callable[..., Awaitable[MockProgram]]
) -> None:
    with Peer(foreign_broker, "host", version=4) as host:
        host.subscribe("spBv1.0/#", 1)
        program = await start_mock("sparkplug", "--broker", f"mqtt://127.0.0.1:{foreign_broker}")
        assert (program.ready_event["protocol"], program.port) == ("sparkplug", foreign_broker)
        await program.control.ask("tick", steps=1)
        births = [await asyncio.to_thread(host.next) for _ in range(3)]
        assert [one.topic.split("/")[2] for one in births] == ["NBIRTH", "DBIRTH", "DBIRTH"]
        since = await program.control.next()
        host.publish(NODE.format("NCMD"), REBIRTH, 1)
        await program.control.wait(since, kind="PUBLISH", direction="out", topic=NODE.format("DBIRTH") + "/device-2")
        image = await program.control.image()
        held = image["edge_node"]
        assert (held["connected"], held["bd_seq"], held["seq"]) == (True, 0, 2)
        assert image["points"]["edge_node/device-2/speed"] == -10
        entries = await program.control.journal()
        roles = {(one["origin"], one["request"], one["state_changing"], one["client_id"]) for one in entries}
        assert roles == {("plant", False, False, "otmcp-mock-edge-node-1")}
        await program.control.ask("poke", params={"edge_node": {"death": "device-2"}})
        await program.control.wait(kind="PUBLISH", direction="out", topic=NODE.format("DDEATH") + "/device-2")
        with pytest.raises(RefusedError, match="a poke of an edge node is"):
            await program.control.ask("poke", params={"publish": {}})
        assert await program.end() == (0, "")
        last = host.next()
        while last.topic != NODE.format("NDEATH"):
            last = host.next()


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        (["sparkplug"], 2, "required: --broker"),
        (["mqtt", "--broker", "mqtt://x"], 2, "unrecognized arguments: --broker"),
        (["sparkplug", "--broker", "http://x"], 2, "expected mqtt://host:port"),
        (["sparkplug", "--broker", "mqtt://127.0.0.1:1"], 1, "cannot join mqtt://127.0.0.1:1"),
    ],
)
def test_the_simulator_program_says_what_is_wrong(arguments: list[str], code: int, complaint: str) -> None:
    command_line = [sys.executable, "-m", "pytest_otmcp.mocks", *arguments]
    done = subprocess.run(
        command_line, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=60, check=False
    )
    assert done.returncode == code
    assert complaint in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_broker_url_has_a_default_port() -> None:
    assert broker_address("mqtt://plant") == ("plant", 1883)
