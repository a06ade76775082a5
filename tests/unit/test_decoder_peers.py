"""The codecs beside independent peers: libraries speak through the tap to a mock.

What they say must be read as something that contradicts nothing; and what the tap has recorded is what the mock has recorded.
"""

from __future__ import annotations

import asyncio
import sys
from asyncio.subprocess import DEVNULL
from collections import Counter
from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import paho.mqtt.client as untyped_paho
import pytest
from asyncua import Client
from asyncua import ua as untyped_ua
from dnp3.core.enums import ControlCode
from dnp3.master import DefaultSOEHandler, Master, MasterConfig, MasterTcpRunner
from paho.mqtt import properties as untyped_properties
from paho.mqtt.subscribeoptions import SubscribeOptions
from pycomm3 import LogixDriver
from pylogix import PLC
from pymodbus.client import AsyncModbusTcpClient
from pyS7 import S7Client
from snap7.async_client import AsyncClient
from snap7.error import S7Error

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.plant.tap.stream import StreamTap
from pytest_otmcp.protocols.evidence import JournalReader, evidence
from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.protocols.modbus import oracle as modbus_oracle
from pytest_otmcp.protocols.mqtt import oracle as mqtt_oracle
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.replay.connections import Connections

from ..feeding import fed

pytestmark = pytest.mark.asyncio

paho: Any = untyped_paho
ua: Any = untyped_ua
Properties: Any = untyped_properties.Properties

_OPENDNP3 = Path(__file__).parents[1] / "mocks" / "opendnp3_master.py"
_LIFE = {"seq", "t_ns", "connection"}
# A device sees its client's DISCONNECT and the end of the connection; the network decides which it notices first.
_UNORDERED = {"CONNECTED", "DISCONNECTED"}


@asynccontextmanager
async def tapped(protocol: str) -> AsyncIterator[tuple[MockDevice, StreamTap]]:
    device = MockDevice(protocol)
    await device.launch()
    tap = StreamTap(device.host, device.port, framing=protocols()[protocol].framing)
    try:
        await tap.start()
        yield device, tap
    finally:
        await tap.aclose()
        await device.close()


def comparable(entries: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the entries without their times and numbers.

    An answer names its request: the first, second, … of that kind. The order between the directions is not the same
    everywhere.
    """
    messages = [entry for entry in entries if entry["kind"] not in _UNORDERED]
    counts: Counter[str] = Counter()
    places: dict[int, tuple[str, int]] = {}
    for entry in messages:
        if entry["direction"] == "in":
            counts[entry["kind"]] += 1
            places[entry["seq"]] = entry["kind"], counts[entry["kind"]]
    return [
        {
            name: places[value] if name == "answers" else value
            for name, value in entry.items()
            if name not in _LIFE and value not in (None, [], {})
        }
        for entry in messages
    ]


def contradictions(protocol: str, entries: Sequence[JournalEntry]) -> list[str]:
    """Return what ``otmcp verify`` would say against the entries, in the order of a journal from its beginning, and which of them a
    record gives back otherwise."""
    framing = protocols()[protocol].framing
    assert framing is not None
    reader, connections = JournalReader(framing.conversation), Connections(0)
    found = [connections.contradiction(entry) for entry in entries]
    found += [f"{entry} is read otherwise" for entry in entries if reader.read(evidence(entry)) != entry]
    return [clause for clause in found if clause is not None]


async def test_pymodbus_is_recorded_alike_by_tap_and_mock_over_modbus() -> None:
    async with tapped("modbus") as (device, tap):
        client = AsyncModbusTcpClient("127.0.0.1", port=tap.port, retries=0, timeout=60)
        assert await client.connect()
        await client.read_input_registers(0, count=4)
        await client.read_coils(3, count=13)
        await client.read_discrete_inputs(0, count=1)
        await client.write_register(1, 40)
        await client.write_registers(2, [1, 65535])
        await client.write_coil(5, True)
        await client.write_coils(6, [True, False, True])
        await client.mask_write_register(address=1, and_mask=0xF2, or_mask=0x25)
        await client.readwrite_registers(read_address=0, read_count=2, address=4, values=[7])
        await client.read_holding_registers(9999, count=1)
        client.close()
        await tap.journal.wait(0, {"kind": "DISCONNECTED"}, 1, 60.0)
        seen = await device.wait(0, {"kind": "DISCONNECTED"}, timeout_s=60.0)
        assert seen
        mine, theirs = tap.journal.since(0), (await device.journal(0)).entries
    ours, others = comparable(mine), comparable(theirs)
    assert len(ours) == 20
    assert ours == others
    assert modbus_oracle.refused_with(mine, 2) == []
    assert contradictions("modbus", mine) == contradictions("modbus", theirs) == []


async def test_two_s7_clients_are_recorded_alike_by_tap_and_mock_over_s7() -> None:
    async with tapped("s7") as (device, tap):
        refused = AsyncClient()
        with pytest.raises(S7Error):
            await refused.connect("127.0.0.1", 0, 2, tap.port)
        client = AsyncClient()
        await client.connect("127.0.0.1", 0, 1, tap.port)
        await client.db_read(1, 0, 20)
        await client.db_write(10, 0, bytearray(b"\0\x2a\7"))
        await client.get_plc_datetime()
        await client.get_cpu_info()
        await client.plc_stop()
        with pytest.raises(S7Error):
            await client.db_read(99, 0, 1)
        with pytest.raises(S7Error):
            await client.get_cpu_state()
        await client.disconnect()

        def other() -> None:
            with S7Client("127.0.0.1", 0, 1, port=tap.port) as peer:
                peer.read(["DB1,R0", "Q0.0", "DB10,B1", "DB10,I2"])
                peer.write(["M3.5", "DB10,B17", "DB10,R8"], [True, 9, 2.5])
                peer.get_cpu_status()

        await asyncio.to_thread(other)
        await tap.journal.wait(0, {"kind": "DISCONNECTED"}, 3, 60.0)
        assert len(await device.wait(0, {"kind": "DISCONNECTED"}, count=3, timeout_s=60.0)) == 3
        mine, theirs = tap.journal.since(0), (await device.journal(0)).entries
    for direction in ("in", "out"):
        ours, others = (
            [entry for entry in comparable(entries) if entry["direction"] == direction] for entries in (mine, theirs)
        )
        assert len(ours) == (15 if direction == "out" else 16)
        assert ours == others
    assert contradictions("s7", mine) == contradictions("s7", theirs) == []


async def test_two_logix_clients_are_recorded_alike_by_tap_and_mock_over_ethernetip() -> None:
    def exchange(port: int) -> None:
        with PLC("127.0.0.1", port=port) as client:
            client.Read("Levels", 10)
            client.Read(["ValvePosition", "Message", "NoSuchTag", "Recipe.Rate"])
            client.Write([("HeaterPower", 5), ("Locked", 3)])
            client.Write("Flags.3", 1)
            client.Write("Message", "hello")
            client.GetTagList()
            client.SetPLCTime(0)
            client.GetModuleProperties(0)
            client.conn.msg_socket.close()
        with LogixDriver(f"127.0.0.1:{port}/0") as peer:
            peer.read("Levels{3}", "PumpEnabled", "Recipe", "Program:MainProgram.Step", "Counts{64}")
            peer.write("ValvePosition", 31)
            peer.write(("HeaterPower", 5), ("Locked", 3), ("Flags.4", True))
            peer.get_module_info(0)

    async with tapped("ethernetip") as (device, tap):
        await asyncio.to_thread(exchange, tap.port)
        # Each change between messages with and without a CIP connection makes a new TCP connection of pylogix.
        count = len([entry for entry in tap.journal.since(0) if entry["kind"] == "CONNECTED"])
        await tap.journal.wait(0, {"kind": "DISCONNECTED"}, count, 60.0)
        assert len(await device.wait(0, {"kind": "DISCONNECTED"}, count=count, timeout_s=60.0)) == count
        mine, theirs = tap.journal.since(0), (await device.journal(0)).entries
    for direction in ("in", "out"):
        ours, others = (
            [entry for entry in comparable(entries) if entry["direction"] == direction] for entries in (mine, theirs)
        )
        assert len(ours) > 40
        assert ours == others
    assert {entry.get("service") for entry in mine} >= {"read", "write", "modify", "multiple", "tag_list", "template"}
    assert contradictions("ethernetip", mine) == contradictions("ethernetip", theirs) == []


async def test_two_dnp3_masters_are_recorded_alike_by_tap_and_mock_over_dnp3() -> None:
    async with tapped("dnp3") as (device, tap):
        await device.poke(point="binary_input/3", value=True)
        master = Master(config=MasterConfig(address=3, outstation_address=10), handler=DefaultSOEHandler())
        async with MasterTcpRunner(master, "127.0.0.1", tap.port) as runner:
            (told,) = await runner.class_poll()
            assert told.con
            await runner.integrity_poll()
            builder = master.command_builder()
            builder.add_crob(2, ControlCode.LATCH_ON)
            await runner.request(master.build_select(builder.build_select()))
            await runner.request(master.build_operate(builder.build_operate()))
        other = await asyncio.create_subprocess_exec(sys.executable, str(_OPENDNP3), str(tap.port), stdout=DEVNULL)
        assert await asyncio.wait_for(other.wait(), 60.0) == 0
        await tap.journal.wait(0, {"kind": "DISCONNECTED"}, 2, 60.0)
        assert len(await device.wait(0, {"kind": "DISCONNECTED"}, count=2, timeout_s=60.0)) == 2
        mine, theirs = tap.journal.since(0), (await device.journal(0)).entries
    for direction in ("in", "out"):
        ours, others = (
            [entry for entry in comparable(entries) if entry["direction"] == direction] for entries in (mine, theirs)
        )
        assert ours == others
    kinds = Counter(entry["kind"] for entry in mine)
    assert kinds["confirm"] >= 1
    assert kinds["response"] == kinds["request"]
    assert contradictions("dnp3", mine) == contradictions("dnp3", theirs) == []
    # dnp3py's one command, and of opendnp3's seven the two that were refused when they were selected.
    commanded = [entry["function"] for entry in protocols()["dnp3"].changes(mine)]
    assert Counter(commanded) == {4: 4, 5: 2, 3: 2}


def _paho(protocol: int, port: int, connected: asyncio.Event) -> Any:
    loop = asyncio.get_running_loop()
    client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="peer", protocol=protocol)
    client.username_pw_set("operator", "secret")
    client.will_set("gone/peer", b"gone", qos=1)
    client.on_connect = lambda *_: loop.call_soon_threadsafe(connected.set)
    client.connect("127.0.0.1", port, keepalive=30)
    client.loop_start()
    return client


@pytest.mark.parametrize("version", [paho.MQTTv311, paho.MQTTv5])
async def test_paho_is_recorded_alike_by_tap_and_mock_over_mqtt(version: int) -> None:
    async with tapped("mqtt") as (device, tap):
        connected = asyncio.Event()
        client = _paho(version, tap.port, connected)
        await asyncio.wait_for(connected.wait(), 60.0)
        properties = Properties(3) if version == paho.MQTTv5 else None
        if properties is not None:
            properties.UserProperty = ("line", "1")
            properties.MessageExpiryInterval = 60
            client.subscribe("peer/#", options=SubscribeOptions(qos=1, noLocal=False))
        else:
            client.subscribe("peer/#", qos=1)
        await tap.journal.wait(0, {"kind": "SUBACK"}, 1, 60.0)
        for qos in (0, 1, 2):
            client.publish("peer/topic", f"message {qos}", qos=qos, retain=qos == 1, properties=properties)
        await tap.journal.wait(0, {"kind": "PUBCOMP", "direction": "out"}, 1, 60.0)
        await tap.journal.wait(0, {"kind": "PUBACK", "direction": "in"}, 2, 60.0)
        client.unsubscribe("peer/#")
        await tap.journal.wait(0, {"kind": "UNSUBACK"}, 1, 60.0)
        client.disconnect()
        await tap.journal.wait(0, {"kind": "DISCONNECTED"}, 1, 60.0)
        await device.wait(0, {"kind": "DISCONNECTED", "client_id": "peer"}, timeout_s=60.0)
        client.loop_stop()
        mine = tap.journal.since(0)
        theirs = [entry for entry in (await device.journal(0)).entries if entry.get("client_id") == "peer"]
    assert contradictions("mqtt", mine) == contradictions("mqtt", theirs) == []
    for direction in ("in", "out"):
        ours, others = (
            [entry for entry in comparable(entries) if entry["direction"] == direction] for entries in (mine, theirs)
        )
        assert ours == others
    ends = next(
        index for index, entry in enumerate(mine) if entry["kind"] in ("UNSUBSCRIBE", "DISCONNECT", "DISCONNECTED")
    )
    assert fed(mqtt_oracle.Subscriptions("peer"), mine[:ends]).granted("peer/#", qos=1) == []
    assert fed(mqtt_oracle.Subscriptions("peer"), mine).granted("peer/#", qos=1) != []
    assert mqtt_oracle.exchange(mine, at_least=5) == []
    assert "c2VjcmV0" not in repr(mine)
    assert "secret" not in repr(mine)


async def test_the_edge_node_of_the_mock_keeps_the_rules_that_the_witness_checks() -> None:
    async with tapped("mqtt") as (device, _):
        for _ in range(3):
            await device.tick()
        await device.wait(0, {"kind": "PUBLISH", "direction": "in"}, count=8, timeout_s=60.0)
        journal = (await device.journal(0)).entries
    simulator = {entry["client_id"] for entry in journal if str(entry.get("client_id")).startswith("otmcp-mock-")}
    edge_nodes = [entry for entry in journal if entry["kind"] == "CONNECT" and entry.get("will")]
    assert simulator
    assert edge_nodes
    assert contradictions("mqtt", journal) == []
    for connect in edge_nodes:
        assert fed(mqtt_oracle.SparkplugSequence(client_id=connect["client_id"]), journal).findings == []


async def test_asyncua_is_recorded_alike_by_tap_and_mock_over_opcua() -> None:
    async with tapped("opcua") as (device, tap):
        mark = await device.mark()
        # The long interval keeps the client's own reads away from those that are compared.
        client = Client(f"opc.tcp://127.0.0.1:{tap.port}/", timeout=60, watchdog_intervall=3600)
        # The mock's endpoints name the mock's own port; the client's requests go through the tap all the same.
        async with client:
            valve = client.get_node("ns=2;s=ValvePosition")
            await client.get_node("ns=2;s=Temperature").read_value()
            await client.read_values([valve, client.get_node("ns=2;s=Pressure")])
            await valve.write_value(ua.DataValue(ua.Variant(33.5, ua.VariantType.Double)))
            with pytest.raises(ua.UaStatusCodeError):
                await client.get_node("ns=2;i=99999").read_value()
            with pytest.raises(ua.UaStatusCodeError):
                await valve.write_value(ua.DataValue(ua.Variant("open")))
            image = await device.image()
            folder = client.get_node(image["folders"]["Actuators"])
            await folder.get_children()
        # The last message has no answer for the client to wait for.
        await tap.journal.wait(0, {"kind": "CloseSecureChannel"}, 1, 60.0)
        assert await device.wait(mark, {"kind": "CloseSecureChannel"}, timeout_s=60.0)
        mine, theirs = tap.journal.since(0), (await device.journal(mark)).entries
    assert contradictions("opcua", mine) == contradictions("opcua", theirs) == []
    # The mock records no messages of the connection protocol below.
    below = ("Hello", "Acknowledge")
    ours, others = ([one for one in comparable(entries) if one["kind"] not in below] for entries in (mine, theirs))
    assert ours == others
    kinds = [entry["kind"] for entry in ours if entry["direction"] == "in"]
    assert (kinds.count("Write"), kinds.count("Browse")) == (2, 1)
    assert {"CreateSession", "ActivateSession", "CloseSession", "OpenSecureChannel"} <= {
        entry["kind"] for entry in mine
    }
