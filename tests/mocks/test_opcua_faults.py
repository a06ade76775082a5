"""What the OPC UA server does wrong when it is told to, and its further nodes, seen by asyncua's client and by raw sockets."""

# asyncua's exports are not declared, and pytest finds mock_program, which mypy does not.
# mypy: disable-error-code="attr-defined, import-not-found"

from __future__ import annotations

import asyncio
import math
import socket
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from datetime import UTC, datetime
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua
from mock_program import PATIENCE_S, MockProgram, RefusedError

URI = "urn:otmcp:plant"
pytestmark = pytest.mark.asyncio(loop_scope="module")
MOCK = "opcua"

Connect = Callable[[], Awaitable[Client]]


@pytest_asyncio.fixture(loop_scope="module")
async def plant(device: MockProgram) -> AsyncIterator[MockProgram]:
    """The mock with its start-up values; again after the test, so that clients can say good-bye."""
    yield device
    await device.control.ask("reset")


@pytest_asyncio.fixture(loop_scope="module")
async def connect(program: MockProgram) -> AsyncIterator[Connect]:
    """Function that opens sessions, which are closed after the test."""
    async with AsyncExitStack() as leaving:

        async def opens() -> Client:
            client = Client(f"opc.tcp://{program.host}:{program.port}", timeout=PATIENCE_S, watchdog_intervall=600)
            await client.connect()
            leaving.push_async_callback(leave, client)
            return client

        yield opens


async def leave(client: Client) -> None:
    """End a session; some of these tests have ended its connection."""
    try:
        async with asyncio.timeout(1):
            await client.disconnect()
    except (OSError, ua.UaError, TimeoutError, asyncio.CancelledError):
        client.disconnect_socket()


@pytest_asyncio.fixture(loop_scope="module")
async def client(plant: MockProgram, connect: Connect) -> Client:
    return await connect()


def node(name: str, index: int = 2) -> ua.NodeId:
    return ua.NodeId(name, index)


async def read(client: Client, name: str) -> ua.DataValue:
    item = ua.ReadValueId(NodeId=node(name), AttributeId=ua.AttributeIds.Value)
    (result,) = await client.uaclient.read(ua.ReadParameters(NodesToRead=[item]))
    return result


async def write(
    client: Client, name: str, value: Any, kind: ua.VariantType = ua.VariantType.Double, **data: Any
) -> str:
    item = ua.WriteValue(
        NodeId=node(name),
        AttributeId=ua.AttributeIds.Value,
        Value=ua.DataValue(ua.Variant(value, kind), **{"StatusCode": None, **data}),
    )
    (result,) = await client.uaclient.write(ua.WriteParameters(NodesToWrite=[item]))
    return str(result.name)


async def browse(client: Client, name: str) -> list[str]:
    found = await client.get_node(node(name)).get_children_descriptions()
    return [one.BrowseName.Name for one in found]


# -- fault rules ----------------------------------------------------------------------------------------------


async def test_a_write_is_done_and_answered_with_another_good_status(plant: MockProgram, client: Client) -> None:
    since = await plant.control.next()
    await plant.control.fault({"with_status": "GoodCompletesAsynchronously"}, service="Write", skip=1)
    assert await write(client, "ValvePosition", 11.0) == "Good"
    assert await write(client, "ValvePosition", 12.0) == "GoodCompletesAsynchronously"
    assert (await read(client, "ValvePosition")).Value.Value == 12.0
    assert await write(client, "Temperature", 1.0) == "BadNotWritable"
    asked = await plant.control.journal(since, kind="Write", direction="in")
    assert [one.get("fault") for one in asked] == [None, *[{"with_status": "GoodCompletesAsynchronously"}] * 2]
    answers = await plant.control.journal(since, kind="Write", direction="out")
    assert [one["results"][0]["status"] for one in answers] == [
        "Good",
        "GoodCompletesAsynchronously",
        "BadNotWritable",
    ]


async def test_a_value_is_read_with_an_uncertain_status(plant: MockProgram, client: Client) -> None:
    await plant.control.fault({"with_status": "UncertainSensorNotAccurate"}, service="Read", node="ns=2;s=Pressure")
    read_value = await read(client, "Pressure")
    assert (read_value.StatusCode.name, read_value.Value.Value) == ("UncertainSensorNotAccurate", 1.5)
    assert (await read(client, "Humidity")).StatusCode.name == "Good"


async def test_timestamps_and_status_codes_are_refused(plant: MockProgram, client: Client) -> None:
    now, bad = {"SourceTimestamp": datetime.now(UTC)}, {"StatusCode": ua.StatusCode(ua.StatusCodes.BadDeviceFailure)}
    await plant.control.fault({"refuse_timestamps": True}, service="Write")
    assert await write(client, "FanSpeed", 1.0, **now) == "BadWriteNotSupported"
    assert await write(client, "FanSpeed", 2.0, **bad) == "Good"
    await plant.control.fault({"refuse_status": True}, service="Write")
    assert await write(client, "FanSpeed", 3.0, **bad) == "BadWriteNotSupported"
    assert await write(client, "FanSpeed", 4.0, **now) == "Good"
    assert (await read(client, "FanSpeed")).Value.Value == 4.0


async def test_answers_come_out_of_order(plant: MockProgram, client: Client) -> None:
    await plant.control.fault({"delay_s": 0.3}, node="ns=2;s=Pressure")
    since = await plant.control.next()
    found = await asyncio.gather(read(client, "Pressure"), read(client, "Humidity"))
    assert [one.Value.Value for one in found] == [1.5, 45.0]
    first, second = await plant.control.journal(since, kind="Read", direction="in")
    answers = await plant.control.journal(since, kind="Read", direction="out")
    assert [one["answers"] for one in answers] == [second["seq"], first["seq"]]


async def test_a_dripped_answer_is_whole_and_what_follows_waits(plant: MockProgram, client: Client) -> None:
    await plant.control.fault({"drip_s": 0.002}, service="Read", times=1)
    since = await plant.control.next()
    loop = asyncio.get_running_loop()
    began = loop.time()
    found = await asyncio.gather(read(client, "Pressure"), read(client, "Humidity"))
    assert [one.Value.Value for one in found] == [1.5, 45.0]
    assert loop.time() - began > 0.1
    answers = await plant.control.journal(since, kind="Read", direction="out")
    assert [one.get("drip_s") for one in answers] == [0.002, None]


async def test_an_answer_comes_twice(plant: MockProgram, client: Client) -> None:
    await plant.control.fault({"duplicate": True}, service="Read", times=1)
    since = await plant.control.next()
    assert (await read(client, "Pressure")).Value.Value == 1.5
    answers = await plant.control.journal(since, kind="Read", direction="out")
    assert [(one["answers"], one.get("duplicate")) for one in answers] == [(since, None), (since, True)]


async def test_a_half_open_connection_is_dead_and_others_are_served(
    plant: MockProgram, client: Client, connect: Connect
) -> None:
    await plant.control.fault({"half_open": True}, service="Write")
    since = await plant.control.next()
    writing = asyncio.create_task(write(client, "ValvePosition", 77.0))
    await plant.control.wait(since, kind="Write", direction="in")
    other = await connect()
    assert (await read(other, "ValvePosition")).Value.Value == 50.0
    reading = asyncio.create_task(read(client, "Pressure"))
    await plant.control.wait(since, kind="lost")
    assert await plant.control.journal(since, kind="Write", direction="out") == []
    assert not writing.done()
    for task in (writing, reading):
        task.cancel()
    await asyncio.gather(writing, reading, return_exceptions=True)


async def test_a_black_hole_does_not_even_say_hello(plant: MockProgram) -> None:
    await plant.control.poke(network="black_hole")
    url = f"opc.tcp://{plant.host}:{plant.port}".encode()
    body = struct.pack("<IIIIII", 0, 65536, 65536, 0, 0, len(url)) + url
    hello = b"HELF" + struct.pack("<I", 8 + len(body)) + body

    def ask(timeout_s: float) -> bytes:
        with socket.create_connection((plant.host, plant.port), PATIENCE_S) as raw:
            raw.sendall(hello)
            raw.settimeout(timeout_s)
            return raw.recv(4)

    since = await plant.control.next()
    with pytest.raises(TimeoutError):
        await asyncio.to_thread(ask, 0.3)
    assert [one["count"] for one in await plant.control.journal(since, kind="lost")] == [len(hello)]
    await plant.control.poke(network="open")
    assert await asyncio.to_thread(ask, PATIENCE_S) == b"ACKF"


# -- subscriptions --------------------------------------------------------------------------------------------


class Seen:
    """The data changes that a subscription reports."""

    def __init__(self) -> None:
        self.values: asyncio.Queue[Any] = asyncio.Queue()

    def datachange_notification(self, source: Any, value: Any, data: Any) -> None:
        self.values.put_nowait(value)


async def withheld(plant: MockProgram) -> None:
    """Return as soon as the server has withheld the value of a notification."""
    async with asyncio.timeout(PATIENCE_S):
        while not (await plant.control.image())["clients"]["withheld_notifications"]:
            pass


async def test_a_subscription_is_kept_silent(plant: MockProgram, client: Client) -> None:
    seen = Seen()
    subscription = await client.create_subscription(20, seen)
    await subscription.subscribe_data_change(client.get_node(node("FanSpeed")))
    async with asyncio.timeout(PATIENCE_S):
        assert await seen.values.get() == 40.0
    await plant.control.poke(subscriptions="silent")
    since = await plant.control.next()
    assert await write(client, "FanSpeed", 41.0) == "Good"
    await withheld(plant)
    assert seen.values.empty()
    assert await plant.control.journal(since, kind="Publish", direction="out") == []
    await plant.control.poke(subscriptions="normal")
    assert await write(client, "FanSpeed", 42.0) == "Good"
    async with asyncio.timeout(PATIENCE_S):
        assert [await seen.values.get() for _ in range(2)] == [41.0, 42.0]


async def test_a_subscription_says_that_nothing_has_changed(plant: MockProgram, client: Client) -> None:
    seen = Seen()
    subscription = await client.create_subscription(20, seen)
    await subscription.subscribe_data_change(client.get_node(node("FanSpeed")))
    async with asyncio.timeout(PATIENCE_S):
        assert await seen.values.get() == 40.0
    await plant.control.poke(subscriptions="stale")
    assert await write(client, "FanSpeed", 41.0) == "Good"
    await withheld(plant)
    await plant.control.poke(subscriptions="normal")
    assert await write(client, "FanSpeed", 42.0) == "Good"
    async with asyncio.timeout(PATIENCE_S):
        assert await seen.values.get() == 42.0


# -- nodes ----------------------------------------------------------------------------------------------------

BUILT_IN = [
    kind for kind in ua.VariantType if kind.value and kind.name not in ("DataValue", "Variant", "DiagnosticInfo")
]


async def test_there_is_a_node_of_every_built_in_type(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(nodes="types")
    assert sorted(await browse(client, "Types")) == sorted(kind.name for kind in BUILT_IN)
    for kind in BUILT_IN:
        found = await read(client, kind.name)
        assert (found.StatusCode.name, found.Value.VariantType) == ("Good", kind), kind
    structure = (await read(client, "ExtensionObject")).Value.Value
    assert (structure.Low, structure.High) == (0.0, 100.0)
    assert await write(client, "UInt64", 2**53 + 1, ua.VariantType.UInt64) == "Good"
    points = (await plant.control.image())["points"]
    assert points["ns=2;s=UInt64"] == 2**53 + 1
    await plant.control.ask("reset")
    assert (await read(client, "UInt64")).StatusCode.name == "BadNodeIdUnknown"


async def test_special_values_arrive_as_they_are(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(nodes=["special"])
    found = {name: (await read(client, name)).Value for name in await browse(client, "Special")}
    assert math.isnan(found["Double.NaN"].Value)
    assert found["Float.MinusInfinity"].Value == -math.inf
    assert math.copysign(1, found["Double.MinusZero"].Value) == -1
    assert (found["Float.Subnormal"].Value, found["Double.Subnormal"].Value) == (2.0**-149, 5e-324)
    assert found["UInt64.Above2To53"].Value == 2**53 + 1
    assert found["DateTime.Min"].Value == datetime(1601, 1, 1, tzinfo=UTC)
    assert found["DateTime.Max"].Value.year == 9999
    assert [found[f"String.{name}"].Value for name in ("Nul", "Bidi", "Emoji", "Empty")] == [
        "a\0b",
        "a\u202eb\u202c",
        "\U0001f600",
        "",
    ]
    assert found["ByteString.Empty"].Value == b""
    for name in ("Null", "DateTime.Null", "String.Null"):
        assert (found[name].Value, found[name].VariantType) == (None, ua.VariantType.Null)
    points = (await plant.control.image())["points"]
    assert (points["ns=2;s=Double.NaN"], points["ns=2;s=Float.MinusInfinity"]) == ("NaN", "-Infinity")
    since = await plant.control.next()
    await read(client, "Double.NaN")
    [answer] = await plant.control.journal(since, kind="Read", direction="out")
    assert answer["results"][0]["value"] == "NaN"


async def test_arrays_and_structures_have_their_shapes(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(nodes=["arrays", "structures"])
    assert (await read(client, "Int32.Vector")).Value.Value == [1, -2, 3]
    matrix = (await read(client, "Double.Matrix")).Value
    assert matrix.Dimensions == [2, 3]
    assert matrix.Value[0] == [1.0, 2.0, 3.0]
    empty = (await read(client, "Int32.Empty")).Value
    assert (empty.Value, empty.is_array) == ([], True)
    ranges = (await read(client, "Range.Vector")).Value.Value
    assert [(one.Low, one.High) for one in ranges] == [(0.0, 1.0), (1.0, 2.0)]
    assert (await read(client, "EUInformation")).Value.Value.UnitId == 4408652


async def test_a_structure_of_a_type_that_nobody_knows_comes_as_its_bytes(plant: MockProgram, client: Client) -> None:
    unknown = {"ns=2;i=4711": "AP8="}
    await plant.control.poke(
        create=[{"variable": "Odd", "type": "ExtensionObject", "value": unknown, "data_type": "i=22"}]
    )
    found = (await read(client, "Odd")).Value.Value
    assert (found.TypeId.to_string(), found.Body) == ("ns=2;i=4711", b"\x00\xff")


async def test_a_value_has_the_times_and_the_status_that_it_is_given(plant: MockProgram, client: Client) -> None:
    item = ua.ReadValueId(NodeId=node("Temperature"), AttributeId=ua.AttributeIds.Value)
    both = ua.ReadParameters(TimestampsToReturn=ua.TimestampsToReturn.Both, NodesToRead=[item])
    source, server = "2026-01-02T03:04:05.678+00:00", "2026-01-02T03:04:06.789+00:00"
    for given in ((source, server), (source, None), (None, server), (None, None)):
        await plant.control.poke(node="Temperature", value=1.0, source_timestamp=given[0], server_timestamp=given[1])
        (found,) = await client.uaclient.read(both)
        times = (found.SourceTimestamp, found.ServerTimestamp)
        assert times == tuple(None if text is None else datetime.fromisoformat(text) for text in given)
    await plant.control.poke(node="Temperature", value=1.0, status=0xC0000000)
    (found,) = await client.uaclient.read(both)
    assert found.StatusCode.value == 0xC0000000
    assert None not in (found.SourceTimestamp, found.ServerTimestamp)


@pytest.mark.parametrize("action", [{"close": True}, {"reset": True}, {"service_fault": "BadSecureChannelIdInvalid"}])
async def test_a_session_whose_connection_the_device_has_ended_is_none_that_its_client_has_left(
    plant: MockProgram, connect: Connect, action: dict[str, object]
) -> None:
    async def sessions() -> int:
        return int((await plant.control.image())["clients"]["sessions"])

    left, cut = await connect(), await connect()
    for one in (left, cut):
        await one.create_subscription(1000.0, None)
    await plant.control.fault(action, service="Read", times=1)
    with pytest.raises((ConnectionError, TimeoutError, ua.UaError)):
        await asyncio.wait_for(read(cut, "Temperature"), 1.0)
    cut.disconnect_socket()
    await plant.control.wait(0, kind="DISCONNECTED")
    assert await sessions() == 1
    left.disconnect_socket()
    await plant.control.wait(0, kind="DISCONNECTED", count=2)
    # The session that its client has left behind by itself counts.
    assert await sessions() == 1


async def test_sessions_are_closed_and_their_connections_stay(plant: MockProgram, connect: Connect) -> None:
    first, since = await connect(), await plant.control.next()
    await plant.control.poke(sessions="closed")
    assert (await plant.control.image())["clients"]["sessions"] == 0
    with pytest.raises(ua.uaerrors.BadSessionIdInvalid):
        await read(first, "Temperature")
    assert await plant.control.journal(since, kind="DISCONNECTED") == []
    assert (await read(await connect(), "Temperature")).Value.Value == 25.0


async def test_a_request_before_there_is_a_session_is_refused_and_the_connection_stays(plant: MockProgram) -> None:
    client = Client(f"opc.tcp://{plant.host}:{plant.port}", timeout=PATIENCE_S)
    await client.connect_socket()
    try:
        await client.send_hello()
        await client.open_secure_channel()
        with pytest.raises(ua.uaerrors.BadSessionIdInvalid):
            await read(client, "Temperature")
        await client.create_session()
        await client.activate_session()
        assert (await read(client, "Temperature")).Value.Value == 25.0
        await client.close_session()
    finally:
        client.disconnect_socket()


async def test_an_answer_says_how_many_continuation_points_are_open(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(limits={"references_per_node": 4})
    since = await plant.control.next()
    await browse(client, "Actuators")
    pages = await plant.control.journal(since, direction="out")
    assert [page.get("open_points") for page in pages if page["kind"].startswith("Browse")] == [1, None]


async def test_access_rights_differ(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(nodes="access")
    assert {name: await write(client, name, 9.0) for name in ("ReadOnly", "Denied", "Hidden", "Writable")} == {
        "ReadOnly": "BadNotWritable",
        "Denied": "BadUserAccessDenied",
        "Hidden": "BadNotWritable",
        "Writable": "Good",
    }
    assert (await read(client, "Denied")).Value.Value == 2.0
    assert (await read(client, "Hidden")).StatusCode.name == "BadNotReadable"


async def test_an_analog_item_has_a_range(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(nodes="analog")
    level = client.get_node(node("Level"))
    span = await (await level.get_child("0:EURange")).read_value()
    assert (span.Low, span.High) == (0.0, 100.0)
    assert await level.read_type_definition() == ua.NodeId(ua.ObjectIds.AnalogItemType)
    assert [await write(client, "Level", value) for value in (100.0, 100.5)] == ["Good", "BadOutOfRange"]


async def test_folders_form_a_circle(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(nodes="cycle")
    assert [await browse(client, name) for name in ("CycleA", "CycleB", "CycleC")] == [
        ["CycleB"],
        ["CycleC"],
        ["CycleA"],
    ]


async def test_calls_of_methods_are_journalled_with_their_arguments(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(nodes="methods")
    arguments = [ua.Variant(-7, ua.VariantType.Int32), ua.Variant("x", ua.VariantType.String)]
    since = await plant.control.next()
    assert await client.get_node(node("Methods")).call_method(node("Mix"), *arguments) == [-7, "x"]
    [asked] = await plant.control.journal(since, kind="Call", direction="in")
    assert (asked["methods"][0]["arguments"], asked["methods"][0]["types"]) == ([-7, "x"], ["Int32", "String"])
    assert (await plant.control.image())["methods"]["ns=2;s=Mix"] == {"calls": 1}


@pytest.mark.long
async def test_thousands_of_nodes_come_and_go(plant: MockProgram, client: Client) -> None:
    await plant.control.poke(nodes=["wide", "many"])
    assert len(await browse(client, "Wide.Folder")) == 2_500
    assert await write(client, "Wide2499", 7, ua.VariantType.Int32) == "Good"
    assert [(await read(client, name)).Value.Value for name in ("Wide2499", "Wide2498")] == [7, 0]
    assert await client.get_node(node("Many9999")).read_browse_name() == ua.QualifiedName("Many9999", 2)
    assert len((await plant.control.image())["points"]) > 12_500
    await plant.control.ask("reset")
    assert (await read(client, "Many9999")).StatusCode.name == "BadNodeIdUnknown"
    assert "Wide.Folder" not in await browse(client, "Plant")


async def test_namespaces_are_in_another_order_and_connections_end(
    plant: MockProgram, client: Client, connect: Connect
) -> None:
    await plant.control.poke(namespaces=["urn:a", "urn:b"])
    again = await connect()
    assert await again.get_namespace_index(URI) == 4
    value = await again.get_node(node("Temperature", 4)).read_value()
    assert value == 25.0
    assert (await read(again, "Temperature")).StatusCode.name == "BadNodeIdUnknown"
    plant_node = again.get_node(node("Plant", 4))
    names = [one.BrowseName for one in await plant_node.get_children_descriptions()]
    assert names == [ua.QualifiedName(name, 4) for name in ("Sensors", "Actuators", "Status", "Methods")]
    rate = ua.Variant(7.0, ua.VariantType.Double)
    assert await again.get_node(node("Methods", 4)).call_method(node("SetProductionRate", 4), rate) == 100.0
    await plant.control.ask("tick", steps=1)
    image = await plant.control.image()
    assert image["namespace"] == {"index": 4, "uri": URI}
    assert image["points"]["ns=4;s=ProductionRate"] == 7.0
    await plant.control.ask("reset")
    third = await connect()
    assert await third.get_namespace_index(URI) == 2
    assert (await read(third, "Temperature")).Value.Value == 25.0


async def test_pokes_and_rules_that_are_not_understood_are_refused_in_a_sentence(plant: MockProgram) -> None:
    for params, sentence in (
        ({"nodes": "everything"}, "nodes: expected one of types, special"),
        ({"subscriptions": "off"}, "expected one of normal, stale, silent"),
        ({"namespaces": [URI]}, "expected a list of other URIs"),
        ({"network": "gone"}, "one of open, black_hole, stalled"),
        ({"node": "Temperature", "value": "warm"}, "'warm' does not fit into Double"),
        ({"node": "Temperature", "value": 1.0, "status": 2**32}, "unknown status code 4294967296"),
        ({"node": "Temperature", "value": 1.0, "server_timestamp": "noon"}, "expected a time in ISO 8601 or null"),
        ({"sessions": "gone"}, "sessions: expected closed"),
    ):
        with pytest.raises(RefusedError) as refused:
            await plant.control.poke(**params)
        assert sentence in str(refused.value)
    for action in ({"with_status": "Excellent"}, {"refuse_status": 1}, {"drip_s": "slow"}):
        with pytest.raises(RefusedError, match="a fault rule cannot have"):
            await plant.control.fault(action)
