"""The OPC UA mock as a real process, asked by asyncua's client, its journal and its image."""

# asyncua's exports are not declared, and pytest finds mock_program, which mypy does not.
# mypy: disable-error-code="attr-defined, import-not-found"

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from datetime import UTC, datetime
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.ua.ua_binary import struct_from_binary
from asyncua.ua.uaerrors import UaStatusCodeError
from mock_program import PATIENCE_S, MockProgram

URI = "urn:otmcp:plant"
SENSORS = {"Temperature", "Pressure", "FlowRate", "TankLevel", "Vibration", "PhLevel", "Humidity", "MotorSpeed"}
ACTUATORS = {"PumpEnabled", "ValvePosition", "HeaterPower", "FanSpeed", "ConveyorSpeed", "AlarmActive"}
METHODS = {"StartProduction", "StopProduction", "TriggerEmergencyStop", "ResetAlarms", "SetProductionRate"}

pytestmark = pytest.mark.asyncio(loop_scope="module")
MOCK = "opcua"


Connect = Callable[[], Awaitable[Client]]


@pytest_asyncio.fixture(loop_scope="module")
async def connect(device: MockProgram) -> AsyncIterator[Connect]:
    """Function that opens sessions, which are closed after the test."""
    opened: list[Client] = []

    async def opens() -> Client:
        client = Client(f"opc.tcp://{device.host}:{device.port}", timeout=PATIENCE_S, watchdog_intervall=600)
        await client.connect()
        opened.append(client)
        return client

    yield opens
    async with AsyncExitStack() as leaving:
        for client in opened:
            leaving.push_async_callback(client.disconnect)


@pytest_asyncio.fixture(loop_scope="module")
async def client(connect: Connect) -> Client:
    return await connect()


def node(name: str) -> ua.NodeId:
    return ua.NodeId(name, 2)


async def status(call: Awaitable[Any]) -> str:
    """Return the symbol of the status with which a call is refused."""
    with pytest.raises(UaStatusCodeError) as refused:
        await call
    return str(ua.StatusCode(refused.value.code).name)


async def write(client: Client, name: ua.NodeId | str, value: Any, kind: ua.VariantType, **fields: Any) -> str:
    item = ua.WriteValue(
        NodeId=node(name) if isinstance(name, str) else name,
        AttributeId=fields.pop("attribute", ua.AttributeIds.Value),
        Value=ua.DataValue(ua.Variant(value, kind), StatusCode=None),
        **fields,
    )
    (result,) = await client.uaclient.write(ua.WriteParameters(NodesToWrite=[item]))
    return str(result.name)


async def read(client: Client, name: str, **parameters: Any) -> ua.DataValue:
    item = ua.ReadValueId(NodeId=node(name), AttributeId=ua.AttributeIds.Value)
    (result,) = await client.uaclient.read(ua.ReadParameters(NodesToRead=[item], **parameters))
    return result


def description(name: ua.NodeId, **fields: Any) -> ua.BrowseDescription:
    fields.setdefault("ReferenceTypeId", ua.NodeId(ua.ObjectIds.HierarchicalReferences))
    fields.setdefault("ResultMask", ua.BrowseResultMask.All)
    return ua.BrowseDescription(NodeId=name, **fields)


async def browse(client: Client, *descriptions: ua.BrowseDescription, most: int = 0) -> list[ua.BrowseResult]:
    parameters = ua.BrowseParameters(RequestedMaxReferencesPerNode=most, NodesToBrowse=list(descriptions))
    results: list[ua.BrowseResult] = await client.uaclient.browse(parameters)
    return results


async def browse_next(client: Client, *points: bytes, release: bool = False) -> list[ua.BrowseResult]:
    parameters = ua.BrowseNextParameters(ReleaseContinuationPoints=release, ContinuationPoints=list(points))
    results: list[ua.BrowseResult] = await client.uaclient.browse_next(parameters)
    return results


def names(result: ua.BrowseResult) -> list[str]:
    return [reference.BrowseName.Name for reference in result.References]


async def create(device: MockProgram, *wishes: dict[str, Any]) -> None:
    await device.control.ask("poke", params={"create": list(wishes)})


async def limit(device: MockProgram, **limits: int) -> None:
    await device.control.ask("poke", params={"limits": limits})


# -- the address space -----------------------------------------------------------------------------------------


async def test_the_plant_has_the_papers_nodes_in_one_listed_namespace(device: MockProgram, client: Client) -> None:
    assert (await client.get_namespace_array())[2] == URI
    children = await browse(client, *(description(node(folder)) for folder in ("Sensors", "Actuators", "Methods")))
    assert [set(names(result)) for result in children] == [SENSORS, ACTUATORS, METHODS]
    image = await device.control.image()
    assert image["namespace"] == {"index": 2, "uri": URI}
    assert set(image["methods"]) == {f"ns=2;s={name}" for name in METHODS}
    assert len(image["variables"]) == 20
    for identifier, variable in image["variables"].items():
        held = await client.get_node(identifier).read_data_value()
        assert (held.Value.VariantType.name, held.Value.Value) == (variable["data_type"], variable["value"])


async def test_a_value_has_the_times_that_are_asked_for(client: Client) -> None:
    stamps = ua.TimestampsToReturn
    given: dict[str, tuple[bool, bool]] = {}
    for wanted in (stamps.Source, stamps.Server, stamps.Both, stamps.Neither):
        held = await read(client, "Temperature", TimestampsToReturn=wanted)
        given[wanted.name] = (held.SourceTimestamp is not None, held.ServerTimestamp is not None)
    assert given == {"Source": (True, False), "Server": (False, True), "Both": (True, True), "Neither": (False, False)}
    assert await status(read(client, "Temperature", TimestampsToReturn=ua.TimestampsToReturn.Invalid)) == (
        "BadTimestampsToReturnInvalid"
    )
    assert await status(read(client, "Temperature", MaxAge=-1.0)) == "BadMaxAgeInvalid"


async def test_reading_what_there_is_not_has_its_status(device: MockProgram, client: Client) -> None:
    await create(
        device,
        {"variable": "Hidden", "type": "Double", "value": 1.0, "access": "hidden"},
        {"variable": "Denied", "type": "Double", "value": 1.0, "access": "denied"},
        {"variable": "Row", "type": "Int32", "value": [1, 2, 3]},
    )
    value = ua.AttributeIds.Value
    asked = [
        (ua.ReadValueId(NodeId=node("Nobody"), AttributeId=value), "BadNodeIdUnknown"),
        (ua.ReadValueId(NodeId=node("Plant"), AttributeId=value), "BadAttributeIdInvalid"),
        (ua.ReadValueId(NodeId=node("Plant"), AttributeId=99), "BadAttributeIdInvalid"),
        (ua.ReadValueId(NodeId=node("Hidden"), AttributeId=value), "BadNotReadable"),
        (ua.ReadValueId(NodeId=node("Denied"), AttributeId=value), "BadUserAccessDenied"),
        (ua.ReadValueId(NodeId=node("Row"), AttributeId=value, IndexRange="1:2"), "Good"),
        (ua.ReadValueId(NodeId=node("Row"), AttributeId=value, IndexRange="3"), "BadIndexRangeNoData"),
        (ua.ReadValueId(NodeId=node("Row"), AttributeId=value, IndexRange="2:1"), "BadIndexRangeInvalid"),
        (ua.ReadValueId(NodeId=node("Pressure"), AttributeId=value, IndexRange="0"), "BadIndexRangeNoData"),
    ]
    results = await client.uaclient.read(ua.ReadParameters(NodesToRead=[item for item, _ in asked]))
    assert [result.StatusCode.name for result in results] == [expected for _, expected in asked]
    assert results[5].Value.Value == [2, 3]


async def test_a_call_without_operations_or_with_too_many_does_nothing(device: MockProgram, client: Client) -> None:
    await limit(device, nodes_per_read=2, nodes_per_browse=2)
    item = ua.ReadValueId(NodeId=node("Pressure"), AttributeId=ua.AttributeIds.Value)
    assert await status(client.uaclient.read(ua.ReadParameters(NodesToRead=[item] * 3))) == "BadTooManyOperations"
    assert await status(client.uaclient.read(ua.ReadParameters(NodesToRead=[]))) == "BadNothingToDo"
    assert await status(browse(client, *[description(node("Plant"))] * 3)) == "BadTooManyOperations"
    assert await status(browse(client)) == "BadNothingToDo"
    advertised = client.get_node(ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead)
    assert await advertised.read_value() == 2


# -- writing ---------------------------------------------------------------------------------------------------


async def test_a_clients_write_stays_and_drives_the_plant(device: MockProgram, client: Client) -> None:
    assert await write(client, "HeaterPower", 100.0, ua.VariantType.Double) == "Good"
    assert await write(client, "ValvePosition", 25.0, ua.VariantType.Double) == "Good"
    cold = (await read(client, "Temperature")).Value.Value
    await device.control.ask("tick", steps=20)
    assert (await read(client, "HeaterPower")).Value.Value == 100.0
    assert (await read(client, "Temperature")).Value.Value > cold + 5
    assert (await read(client, "FlowRate")).Value.Value == 30.0
    assert await write(client, "PumpEnabled", False, ua.VariantType.Boolean) == "Good"
    await device.control.ask("tick", steps=1)
    assert (await read(client, "FlowRate")).Value.Value == 0.0
    held = (await device.control.image())["variables"]
    assert (held["ns=2;s=PumpEnabled"]["value"], held["ns=2;s=HeaterPower"]["value"]) == (False, 100.0)


async def test_the_simulation_runs_freely_until_it_is_paused(device: MockProgram, client: Client) -> None:
    changed: asyncio.Queue[int] = asyncio.Queue()

    class Handler:
        def datachange_notification(self, source: Any, value: int, data: Any) -> None:
            changed.put_nowait(value)

    subscription = await client.create_subscription(50, Handler())
    await subscription.subscribe_data_change(client.get_node(node("Uptime")))
    assert await asyncio.wait_for(changed.get(), PATIENCE_S) == 0
    await device.control.ask("resume")
    # On a busy machine the plant makes up for missed seconds: the first notification may be about the third second.
    assert await asyncio.wait_for(changed.get(), PATIENCE_S) > 0
    await device.control.ask("pause")
    await subscription.delete()


@pytest.mark.parametrize(
    ("name", "value", "kind", "expected"),
    [
        ("Nobody", 1.0, "Double", "BadNodeIdUnknown"),
        ("Temperature", 1.0, "Double", "BadNotWritable"),
        ("Actuators", 1.0, "Double", "BadAttributeIdInvalid"),
        ("Denied", 1.0, "Double", "BadUserAccessDenied"),
        ("ValvePosition", "half", "String", "BadTypeMismatch"),
        ("ValvePosition", 1, "Int32", "BadTypeMismatch"),
        ("ValvePosition", 1.0, "Float", "BadTypeMismatch"),
        ("ValvePosition", True, "Boolean", "BadTypeMismatch"),
        ("ValvePosition", None, "Null", "BadTypeMismatch"),
        ("ValvePosition", [1.0], "Double", "BadTypeMismatch"),
        ("ValvePosition", math.nan, "Double", "BadOutOfRange"),
        ("ValvePosition", math.inf, "Double", "BadOutOfRange"),
        ("Bounded", 10.5, "Double", "BadOutOfRange"),
        ("Bounded", 10.0, "Double", "Good"),
        ("Row", 1, "Int32", "BadTypeMismatch"),
        ("Row", [1, 2], "Int32", "BadTypeMismatch"),
        ("Row", [[1, 2, 3]], "Int32", "BadTypeMismatch"),
        ("Row", [4, 5, 6], "Int32", "Good"),
        ("Grid", [[1, 2], [3, 4]], "Int16", "Good"),
        ("Grid", [1, 2], "Int16", "BadTypeMismatch"),
    ],
)
async def test_a_write_is_checked_like_on_a_strict_server(
    device: MockProgram, client: Client, name: str, value: Any, kind: str, expected: str
) -> None:
    await create(
        device,
        {"variable": "Denied", "type": "Double", "value": 0.0, "access": "denied"},
        {"variable": "Bounded", "type": "Double", "value": 0.0, "range": [0, 10]},
        {"variable": "Row", "type": "Int32", "value": [1, 2, 3], "dimensions": [3]},
        {"variable": "Grid", "type": "Int16", "value": [[0, 0], [0, 0]]},
    )
    before = await device.control.image()
    mark = await device.control.next()
    assert await write(client, name, value, ua.VariantType[kind]) == expected
    after = await device.control.image()
    (answer,) = await device.control.journal(mark, kind="Write", direction="out")
    assert answer["results"] == [{"status": expected}]
    if expected == "Good":
        assert after["variables"][f"ns=2;s={name}"]["value"] == value
    else:
        assert after == before


async def test_attributes_other_than_the_value_cannot_be_written(client: Client) -> None:
    for attribute, expected in ((ua.AttributeIds.AccessLevel, "BadNotWritable"), (99, "BadAttributeIdInvalid")):
        assert await write(client, "Temperature", 3, ua.VariantType.Byte, attribute=attribute) == expected
    assert await write(client, "ValvePosition", 1.0, ua.VariantType.Double, IndexRange="0") == "BadWriteNotSupported"


async def test_the_journal_tells_what_was_written_besides_the_value(device: MockProgram, client: Client) -> None:
    mark = await device.control.next()
    await write(client, "FanSpeed", 12.5, ua.VariantType.Double)
    timed = ua.DataValue(ua.Variant(13.5, ua.VariantType.Double), SourceTimestamp=datetime(2026, 1, 1, tzinfo=UTC))
    await client.get_node(node("FanSpeed")).write_value(timed)
    first, second = (entry["nodes"] for entry in await device.control.journal(mark, kind="Write", direction="in"))
    plain = {"node_id": "ns=2;s=FanSpeed", "attribute": "Value", "variant_type": "Double"}
    assert first == [{**plain, "value": 12.5, "has_status": False, "has_timestamp": False}]
    assert second == [{**plain, "value": 13.5, "has_status": False, "has_timestamp": True}]
    # The plant has its own clock.
    assert (await read(client, "FanSpeed")).SourceTimestamp != timed.SourceTimestamp


# -- browsing --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", [1, 2, 3, 7, 8, 9])
async def test_pages_are_as_long_as_asked_for_and_complete_together(
    device: MockProgram, client: Client, page: int
) -> None:
    mark = await device.control.next()
    (result,) = await browse(client, description(node("Sensors")), most=page)
    found, turns = names(result), 0
    while result.ContinuationPoint:
        assert len(result.References) == page
        (result,) = await browse_next(client, result.ContinuationPoint)
        found += names(result)
        turns += 1
    assert sorted(found) == sorted(SENSORS)
    assert turns == math.ceil(8 / page) - 1
    assert len(await device.control.journal(mark, kind="BrowseNext", direction="in")) == turns
    assert (await device.control.image())["clients"]["continuation_points"] == 0


async def test_the_server_may_want_shorter_pages_than_the_client(device: MockProgram, client: Client) -> None:
    await limit(device, references_per_node=3)
    for most, expected in ((0, 3), (2, 2), (5, 3)):
        (result,) = await browse(client, description(node("Sensors")), most=most)
        assert len(result.References) == expected


async def test_a_continuation_point_is_good_for_one_turn_of_its_own_session(
    device: MockProgram, connect: Connect
) -> None:
    client, other = await connect(), await connect()
    (first,) = await browse(client, description(node("Sensors")), most=3)
    (stranger,) = await browse_next(other, first.ContinuationPoint)
    assert stranger.StatusCode.name == "BadContinuationPointInvalid"
    (second,) = await browse_next(client, first.ContinuationPoint)
    assert second.StatusCode.name == "Good"
    again, invented = await browse_next(client, first.ContinuationPoint, b"invented")
    assert {again.StatusCode.name, invented.StatusCode.name} == {"BadContinuationPointInvalid"}
    assert (await device.control.image())["clients"]["continuation_points"] == 1
    assert await browse_next(client, second.ContinuationPoint, release=True) == []
    (released,) = await browse_next(client, second.ContinuationPoint)
    assert released.StatusCode.name == "BadContinuationPointInvalid"
    assert (await device.control.image())["clients"]["continuation_points"] == 0


async def test_continuation_points_run_out_and_end_with_their_session(device: MockProgram, connect: Connect) -> None:
    await limit(device, continuation_points=2)
    client, other = await connect(), await connect()
    results = await browse(client, *[description(node("Sensors"))] * 3, most=1)
    assert [result.StatusCode.name for result in results] == ["Good", "Good", "BadNoContinuationPoints"]
    (result,) = await browse(other, description(node("Sensors")), most=1)
    assert result.StatusCode.name == "Good"
    await client.disconnect()
    clients = (await device.control.image())["clients"]
    assert (clients["sessions"], clients["continuation_points"]) == (1, 1)


async def test_a_browse_is_filtered_as_it_says(client: Client) -> None:
    temperature, sensors = node("Temperature"), node("Sensors")
    inverse = description(temperature, BrowseDirection=ua.BrowseDirection.Inverse)
    exact = description(sensors, ReferenceTypeId=ua.NodeId(ua.ObjectIds.HierarchicalReferences), IncludeSubtypes=False)
    component = description(sensors, ReferenceTypeId=ua.NodeId(ua.ObjectIds.HasComponent))
    everything = description(sensors, ReferenceTypeId=ua.NodeId(), BrowseDirection=ua.BrowseDirection.Both)
    objects = description(node("Plant"), NodeClassMask=ua.NodeClass.Variable)
    results = await browse(client, inverse, exact, component, everything, objects)
    assert [len(result.References) for result in results] == [1, 0, 8, 10, 0]
    assert names(results[0]) == ["Sensors"]


async def test_fields_that_are_not_asked_for_are_null(client: Client) -> None:
    (bare,) = await browse(client, description(node("Sensors"), ResultMask=0))
    (full,) = await browse(client, description(node("Sensors")))
    assert {reference.NodeId for reference in bare.References} == {node(name) for name in SENSORS}
    reference = bare.References[0]
    assert (reference.BrowseName.Name, reference.DisplayName.Text, reference.NodeClass) == (None, None, 0)
    assert reference.ReferenceTypeId.is_null()
    reference = full.References[0]
    assert reference.ReferenceTypeId == ua.NodeId(ua.ObjectIds.HasComponent)
    assert reference.TypeDefinition == ua.NodeId(ua.ObjectIds.BaseDataVariableType)
    assert (reference.IsForward, reference.NodeClass) == (True, ua.NodeClass.Variable)


async def test_a_browse_of_nonsense_has_its_status(client: Client) -> None:
    results = await browse(
        client,
        description(node("Nobody")),
        description(node("Sensors"), ReferenceTypeId=node("Temperature")),
        description(node("Sensors")),
    )
    assert [result.StatusCode.name for result in results] == ["BadNodeIdUnknown", "BadReferenceTypeIdInvalid", "Good"]


# -- methods ---------------------------------------------------------------------------------------------------


async def call(client: Client, name: str, *arguments: ua.Variant, owner: str = "Methods") -> ua.CallMethodResult:
    request = ua.CallMethodRequest(ObjectId=node(owner), MethodId=node(name), InputArguments=list(arguments))
    (result,) = await client.uaclient.call([request])
    return result


async def test_methods_do_what_their_names_say(device: MockProgram, client: Client) -> None:
    async def mode() -> Any:
        return (await read(client, "Mode")).Value.Value

    steps = [
        ("StopProduction", "Good", "STOPPED"),
        ("StartProduction", "Good", "RUNNING"),
        ("TriggerEmergencyStop", "Good", "EMERGENCY_STOP"),
        ("StartProduction", "BadInvalidState", "EMERGENCY_STOP"),
        ("StopProduction", "Good", "EMERGENCY_STOP"),
        ("ResetAlarms", "Good", "STOPPED"),
        ("StartProduction", "Good", "RUNNING"),
    ]
    for name, expected, then in steps:
        assert ((await call(client, name)).StatusCode.name, await mode()) == (expected, then)
    result = await call(client, "SetProductionRate", ua.Variant(120.0, ua.VariantType.Double))
    assert [output.Value for output in result.OutputArguments] == [100.0]
    image = await device.control.image()
    assert image["variables"]["ns=2;s=ProductionRate"]["value"] == 120.0
    assert image["methods"]["ns=2;s=StartProduction"]["calls"] == 2


@pytest.mark.parametrize(
    ("name", "arguments", "expected", "each"),
    [
        ("Nothing", [], "BadMethodInvalid", []),
        ("Temperature", [], "BadMethodInvalid", []),
        ("SetProductionRate", [], "BadArgumentsMissing", []),
        ("SetProductionRate", [(1.0, "Double"), (1.0, "Double")], "BadTooManyArguments", []),
        ("SetProductionRate", [("1", "String")], "BadInvalidArgument", ["BadTypeMismatch"]),
        ("SetProductionRate", [([1.0], "Double")], "BadInvalidArgument", ["BadTypeMismatch"]),
        ("SetProductionRate", [(-1.0, "Double")], "BadInvalidArgument", ["BadOutOfRange"]),
        ("SetProductionRate", [(math.nan, "Double")], "BadInvalidArgument", ["BadOutOfRange"]),
        ("Echo", [(7, "Int32"), ("x", "String")], "Good", ["Good", "Good"]),
        ("Echo", [(7, "Int32"), (7, "Int32")], "BadInvalidArgument", ["Good", "BadTypeMismatch"]),
    ],
)
async def test_a_methods_arguments_are_checked(
    device: MockProgram, client: Client, name: str, arguments: list[tuple[Any, str]], expected: str, each: list[str]
) -> None:
    await create(device, {"method": "Echo", "inputs": ["Int32", "String"]})
    before = await device.control.image()
    result = await call(client, name, *(ua.Variant(value, ua.VariantType[kind]) for value, kind in arguments))
    assert result.StatusCode.name == expected
    assert [argument.name for argument in result.InputArgumentResults] == each
    if expected != "Good":
        assert await device.control.image() == before


async def test_texts_are_what_the_kit_says(device: MockProgram, client: Client) -> None:
    names = {"browse_name": "2:browsed", "display_name": "sh\x1bown", "description": "described"}
    await create(
        device,
        {"variable": "Named", "type": "Int32", "value": 1, **names},
        {"method": "Speaks", "inputs": [], "returns": "a \u202e text"},
    )
    named = client.get_node(node("Named"))
    assert (await named.read_browse_name()).Name == "browsed"
    assert (await named.read_display_name()).Text == "sh\x1bown"
    assert (await named.read_description()).Text == "described"
    listed = await client.get_node(node("Plant")).get_references()
    assert [one.DisplayName.Text for one in listed if one.NodeId == named.nodeid] == ["sh\x1bown"]
    assert [one.Value for one in (await call(client, "Speaks")).OutputArguments] == ["a \u202e text"]


async def test_a_method_belongs_to_its_object(client: Client) -> None:
    assert (await call(client, "ResetAlarms", owner="Plant")).StatusCode.name == "BadMethodInvalid"
    assert (await call(client, "ResetAlarms", owner="Nobody")).StatusCode.name == "BadNodeIdUnknown"


# -- journal, sessions, faults ---------------------------------------------------------------------------------


async def test_every_service_is_on_the_journal_in_order(device: MockProgram, connect: Connect) -> None:
    mark = await device.control.next()
    client = await connect()
    await read(client, "Pressure")
    (page,) = await browse(client, description(node("Sensors")), most=7)
    await browse_next(client, page.ContinuationPoint)
    await client.register_nodes([client.get_node(node("Pressure"))])
    await client.get_node(node("Plant")).get_child("2:Sensors")
    await call(client, "ResetAlarms")
    await write(client, "FanSpeed", 1.0, ua.VariantType.Double)
    await client.disconnect()
    await device.control.wait(mark, kind="DISCONNECTED")
    entries = await device.control.journal(mark)
    services = ["CreateSession", "ActivateSession", "Read", "Browse", "BrowseNext", "RegisterNodes"]
    services += ["TranslateBrowsePaths", "Call", "Write", "CloseSession"]
    assert [entry["kind"] for entry in entries if entry["direction"] == "in"] == [
        *("CONNECTED", "OpenSecureChannel", *services, "CloseSecureChannel", "DISCONNECTED")
    ]
    assert [entry["kind"] for entry in entries if entry["direction"] == "out"] == ["OpenSecureChannel", *services]
    assert [entry["kind"] for entry in entries if entry.get("state_changing") and entry["direction"] == "in"] == [
        *("Call", "Write")
    ]
    assert {entry["service_result"] for entry in entries if entry["direction"] == "out"} == {"Good"}
    assert len({entry["connection"] for entry in entries}) == 1
    assert await device.control.journal(entries[-1]["seq"]) == [entries[-1]]


class Silent:
    """A subscriber to whom it does not matter what it is told."""

    def datachange_notification(self, source: Any, value: Any, data: Any) -> None:
        pass


async def test_a_session_with_subscriptions_outlives_its_connection_until_the_reset(
    device: MockProgram, connect: Connect
) -> None:
    first, other = await connect(), await connect()
    await (await first.create_subscription(1000, Silent())).subscribe_data_change(first.get_node(node("FanSpeed")))
    mark = await device.control.next()
    first.disconnect_socket()
    await device.control.wait(mark, kind="DISCONNECTED")
    assert (await device.control.image())["clients"]["sessions"] == 2
    await device.control.ask("reset")
    assert (await device.control.image())["clients"]["sessions"] == 1
    assert await other.get_node(node("FanSpeed")).read_value() == 40.0


async def test_sessions_are_counted_and_limited(device: MockProgram, connect: Connect) -> None:
    await limit(device, sessions=2)
    first, _ = await connect(), await connect()
    assert (await device.control.image())["clients"]["sessions"] == 2
    assert await status(connect()) == "BadTooManySessions"
    mark = await device.control.next()
    first.disconnect_socket()
    await device.control.wait(mark, kind="DISCONNECTED")
    await connect()
    assert (await device.control.image())["clients"]["sessions"] == 2
    # The client that vanished has not asked for the end of its session.
    assert await device.control.journal(mark, kind="CloseSession") == []


@pytest.mark.parametrize("opened", [False, True])
async def test_a_message_of_no_channel_ends_its_connection_with_the_reason(device: MockProgram, opened: bool) -> None:
    client = Client(f"opc.tcp://{device.host}:{device.port}", timeout=PATIENCE_S)
    await client.connect_socket()
    await client.send_hello()
    if opened:
        await client.open_secure_channel()
        client.uaclient.protocol._connection.security_token.ChannelId += 1
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(NodeId=ua.NodeId(2258), AttributeId=ua.AttributeIds.Value)]
    mark = await device.control.next()
    answer = client.uaclient.protocol._send_request(request)
    await device.control.wait(mark, kind="DISCONNECTED")
    with pytest.raises((ConnectionError, ua.UaError, asyncio.CancelledError)):
        await answer
    client.disconnect_socket()


async def test_a_phantom_write_is_acknowledged_and_not_done(device: MockProgram, client: Client) -> None:
    await device.control.fault({"ack_only": True}, service="Write")
    assert await write(client, "FanSpeed", 77.0, ua.VariantType.Double) == "Good"
    assert (await read(client, "FanSpeed")).Value.Value == 40.0
    assert await write(client, "Temperature", 77.0, ua.VariantType.Double) == "BadNotWritable"


async def test_a_clamped_write_says_so(device: MockProgram, client: Client) -> None:
    await device.control.fault({"clamp": 80.0}, service="Write")
    assert await write(client, "FanSpeed", 120.0, ua.VariantType.Double) == "GoodClamped"
    assert (await read(client, "FanSpeed")).Value.Value == 80.0


async def test_a_delayed_answer_holds_up_no_other(device: MockProgram, client: Client) -> None:
    await device.control.fault({"delay_s": 3.0}, service="Read", node="ns=2;s=Pressure")
    order: list[str] = []

    async def ask(name: str) -> None:
        await read(client, name)
        order.append(name)

    await asyncio.gather(ask("Pressure"), ask("Temperature"))
    assert order == ["Temperature", "Pressure"]


@pytest.mark.parametrize("action", ["drop", "close", "reset"])
async def test_a_write_without_answer_was_done_all_the_same(device: MockProgram, connect: Connect, action: str) -> None:
    client = await connect()
    await device.control.fault({action: True}, service="Write", times=1)
    mark = await device.control.next()
    writing = asyncio.create_task(write(client, "FanSpeed", 55.0, ua.VariantType.Double))
    await device.control.wait(mark, kind="Write", direction="in")
    if action == "drop":
        await read(client, "Pressure")
        assert not writing.done()
        writing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await writing
    else:
        with pytest.raises(ConnectionError):
            await writing
    assert await device.control.journal(mark, kind="Write", direction="out") == []
    assert (await device.control.image())["variables"]["ns=2;s=FanSpeed"]["value"] == 55.0


async def test_status_and_service_faults_are_applied_as_often_as_told(device: MockProgram, client: Client) -> None:
    await device.control.fault({"status": "BadSensorFailure"}, times=1)
    assert (await read(client, "Pressure")).StatusCode.name == "BadSensorFailure"
    assert (await read(client, "Pressure")).StatusCode.name == "Good"
    await device.control.fault({"service_fault": "BadServerHalted"}, service="Browse")
    mark = await device.control.next()
    assert await status(browse(client, description(node("Sensors")))) == "BadServerHalted"
    (answer,) = await device.control.journal(mark, kind="Browse", direction="out")
    assert answer["service_result"] == "BadServerHalted"
    assert (await device.control.ask("fault", rules=[]))["hits"] == [1]


async def test_a_bad_value_does_not_stop_the_simulation(device: MockProgram) -> None:
    await device.control.ask("poke", params={"node": "ValvePosition", "value": 1.0, "status": "BadSensorFailure"})
    await device.control.ask("poke", params={"node": "HeaterPower", "value": math.nan})
    await device.control.ask("tick", steps=2)
    held = (await device.control.image())["variables"]
    assert held["ns=2;s=Uptime"]["value"] == 2
    assert held["ns=2;s=ValvePosition"]["status"] == "BadSensorFailure"


async def test_what_was_added_is_gone_after_a_reset(device: MockProgram, client: Client) -> None:
    before = await device.control.image()
    await create(
        device,
        {"folder": "Cell"},
        {"folder": "Inner", "in": "Cell"},
        {"variable": "Part", "in": "Inner", "type": "UInt16", "value": 7},
        {"variable": "Limit", "in": "Part", "type": "UInt16", "value": 9, "property": True},
        {"method": "Echo", "inputs": ["Int32"]},
        {"reference": "Inner", "to": "Cell"},
        {"reference": "Inner", "to": "Sensors"},
    )
    (inner,) = await browse(client, description(node("Inner")))
    assert names(inner) == ["Part", "Cell", "Sensors"]
    await device.control.ask("reset")
    assert await device.control.image() == before
    both = ua.BrowseDirection.Both
    gone, sensors = await browse(client, description(node("Inner")), description(node("Sensors"), BrowseDirection=both))
    assert gone.StatusCode.name == "BadNodeIdUnknown"
    assert set(names(sensors)) == SENSORS | {"Plant"}


# -- what the library leaves out -------------------------------------------------------------------------------


async def test_the_endpoint_offers_the_ways_to_log_in_that_work(device: MockProgram, client: Client) -> None:
    (endpoint,) = await client.get_endpoints()
    offered = [policy.TokenType for policy in endpoint.UserIdentityTokens]
    assert offered == [ua.UserTokenType.Anonymous, ua.UserTokenType.UserName]
    assert endpoint.Server.ApplicationUri == "urn:otmcp:mock"
    assert (await client.get_namespace_array())[:3] == ["http://opcfoundation.org/UA/", "urn:otmcp:mock", URI]
    assert await client.get_node(ua.NodeId(ua.ObjectIds.Server_ServerArray)).read_value() == ["urn:otmcp:mock"]
    named = Client(f"opc.tcp://{device.host}:{device.port}", timeout=PATIENCE_S, watchdog_intervall=600)
    named.set_user("operator")
    named.set_password("secret")
    async with named:
        assert (await named.get_namespace_array())[2] == URI


async def test_a_methods_arguments_have_names(device: MockProgram, client: Client) -> None:
    await create(device, {"method": "Echo", "inputs": ["Double", "String"]})

    async def arguments(method: str, which: str) -> list[tuple[str, ua.NodeId]]:
        held = await (await client.get_node(node(method)).get_child(f"0:{which}")).read_value()
        return [(argument.Name, argument.DataType) for argument in held]

    double, string = ua.NodeId(ua.ObjectIds.Double), ua.NodeId(ua.ObjectIds.String)
    assert await arguments("SetProductionRate", "InputArguments") == [("Rate", double)]
    assert await arguments("SetProductionRate", "OutputArguments") == [("PreviousRate", double)]
    assert await arguments("Echo", "InputArguments") == [("Argument1", double), ("Argument2", string)]


async def test_a_node_without_history_says_so(client: Client) -> None:
    asked = [ua.HistoryReadValueId(NodeId=node(name)) for name in ("Temperature", "Nowhere")]
    results = await client.uaclient.history_read(
        ua.HistoryReadParameters(HistoryReadDetails=ua.ReadRawModifiedDetails(), NodesToRead=asked)
    )
    assert [result.StatusCode.name for result in results] == ["BadHistoryOperationUnsupported", "BadNodeIdUnknown"]


async def asked(client: Client, request: Any, answer: Any, **parameters: Any) -> Any:
    """Send a request by hand: asyncua's client acknowledges each notification, and cannot be told to ask for one again."""
    for name, value in parameters.items():
        setattr(request.Parameters, name, value)
    response = struct_from_binary(answer, await client.uaclient.session._send_request(request))
    response.ResponseHeader.ServiceResult.check()
    return response


async def test_only_a_notification_that_is_kept_is_sent_again(connect: Connect) -> None:
    client, stranger = await connect(), await connect()
    wishes = {"RequestedPublishingInterval": 20.0, "RequestedLifetimeCount": 10_000, "RequestedMaxKeepAliveCount": 1000}
    created = await asked(client, ua.CreateSubscriptionRequest(), ua.CreateSubscriptionResponse, **wishes)
    subscription = created.Parameters.SubscriptionId
    item = ua.MonitoredItemCreateRequest(
        ItemToMonitor=ua.ReadValueId(NodeId=node("ValvePosition"), AttributeId=ua.AttributeIds.Value),
        MonitoringMode=ua.MonitoringMode.Reporting,
        RequestedParameters=ua.MonitoringParameters(ClientHandle=1, QueueSize=1),
    )
    monitored = ua.CreateMonitoredItemsParameters(SubscriptionId=subscription, ItemsToCreate=[item])
    (result,) = await client.uaclient.create_monitored_items(monitored)
    result.StatusCode.check()

    async def again(who: Client, number: int, sequence: int) -> ua.NotificationMessage:
        wanted = {"SubscriptionId": number, "RetransmitSequenceNumber": sequence}
        return (await asked(who, ua.RepublishRequest(), ua.RepublishResponse, **wanted)).NotificationMessage

    message = ua.NotificationMessage()
    while not message.NotificationData:  # the first message may keep a subscription alive that has no item yet
        published = await asked(client, ua.PublishRequest(), ua.PublishResponse)
        message = published.Parameters.NotificationMessage
    for _ in range(2):
        repeated = await again(client, subscription, message.SequenceNumber)
        assert (repeated.SequenceNumber, repeated.NotificationData) == (
            message.SequenceNumber,
            message.NotificationData,
        )
    assert await status(again(client, subscription, message.SequenceNumber + 1)) == "BadMessageNotAvailable"
    assert await status(again(client, subscription + 1, message.SequenceNumber)) == "BadSubscriptionIdInvalid"
    assert await status(again(stranger, subscription, message.SequenceNumber)) == "BadSubscriptionIdInvalid"

    await write(client, "ValvePosition", 12.5, ua.VariantType.Double)
    taken = ua.SubscriptionAcknowledgement(SubscriptionId=subscription, SequenceNumber=message.SequenceNumber)
    await asked(client, ua.PublishRequest(), ua.PublishResponse, SubscriptionAcknowledgements=[taken])
    assert await status(again(client, subscription, message.SequenceNumber)) == "BadMessageNotAvailable"


@pytest.mark.long
async def test_more_connections_than_it_serves_are_closed_without_a_word(device: MockProgram) -> None:
    # The library serves a thousand; a module's mock must have written nothing to stderr when it ends.
    opened = [await asyncio.open_connection(device.host, device.port) for _ in range(1001)]
    try:
        async with asyncio.timeout(PATIENCE_S):
            assert await opened[-1][0].read() == b""
    finally:
        for _, writer in opened:
            writer.close()
        await asyncio.gather(*(writer.wait_closed() for _, writer in opened), return_exceptions=True)
