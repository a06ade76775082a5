"""The BACnet device against two independent clients, byte vectors, faults, and bytes that mean nothing."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from bacnet_tools import GET_OBJECT_LIST, BacnetPeer, bacnet_peer
from bacpypes3.apdu import ErrorRejectAbortNack
from bacpypes3.ipv4.app import NormalApplication
from bacpypes3.local.device import DeviceObject
from bacpypes3.pdu import Address, IPv4Address
from bacpypes3.primitivedata import Null, Real
from mock_program import PATIENCE_S, MockProgram, RefusedError
from rusty_bacnet import (
    BacnetAbortError,
    BACnetClient,
    BacnetProtocolError,
    BacnetRejectError,
    ObjectIdentifier,
    ObjectType,
    PropertyIdentifier,
    PropertyValue,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")
MOCK = "bacnet"

ZONE = ObjectIdentifier(ObjectType.ANALOG_INPUT, 1)
VALVE = ObjectIdentifier(ObjectType.ANALOG_OUTPUT, 1)
LEVEL = ObjectIdentifier(ObjectType.ANALOG_VALUE, 9)
FAN = ObjectIdentifier(ObjectType.BINARY_OUTPUT, 1)
MODE = ObjectIdentifier(ObjectType.MULTI_STATE_VALUE, 1)
DEVICE = ObjectIdentifier(ObjectType.DEVICE, 12345)
PRESENT = PropertyIdentifier.PRESENT_VALUE


@pytest_asyncio.fixture(loop_scope="module")
async def peer(device: MockProgram) -> AsyncIterator[BacnetPeer]:
    async with bacnet_peer(device) as opened:
        yield opened


# Request APDU and the APDU that answers it; the invoke id is 1. The first two are the frames of the standard's own shape in
# annex F: confirmed request, maximum response 1476.
VECTORS = {
    "read a present value": ("0005010c 0c00000001 1955", "30010c 0c00000001 1955 3e 4442910000 3f"),
    "read a slot of the priority array": ("0005010c 0c00400001 1957 2908", "30010c 0c00400001 1957 2908 3e 00 3f"),
    "count the slots": ("0005010c 0c00400001 1957 2900", "30010c 0c00400001 1957 2900 3e 2110 3f"),
    "read a name": (
        "0005010c 0c00400001 194d",
        "30010c 0c00400001 194d 3e 7506 00 56616c7665 3f",
    ),
    "read two properties": (
        "0005010e 0c00000001 1e 0955 0951 1f",
        "30010e 0c00000001 1e 2955 4e 4442910000 4f 2951 4e 10 4f 1f",
    ),
    "an error of one property of several": (
        "0005010e 0c00000001 1e 0957 0955 1f",
        "30010e 0c00000001 1e 2957 5e 9102 9120 5f 2955 4e 4442910000 4f 1f",
    ),
    "no such object": ("0005010c 0c0000004d 1955", "50010c 9101 911f"),
    "no such property": ("0005010c 0c00000001 1957", "50010c 9102 9120"),
    "no array": ("0005010c 0c00000001 1955 2901", "50010c 9102 9132"),
    "no such slot": ("0005010c 0c00400001 1957 2911", "50010c 9102 912a"),
    "the wildcard device": ("0005010c 0c023fffff 1962", "30010c 0c02003039 1962 3e 2101 3f"),
    "write": ("0005010f 0c00400001 1955 3e 4441cc0000 3f 4908", "20010f"),
    "relinquish": ("0005010f 0c00400001 1955 3e 00 3f 4908", "20010f"),
    "write without priority": ("0005010f 0c00400001 1955 3e 4441cc0000 3f", "20010f"),
    "priority of minimum on and off": ("0005010f 0c00400001 1955 3e 4441cc0000 3f 4906", "50010f 9102 9128"),
    "priority 17": ("0005010f 0c00400001 1955 3e 4441cc0000 3f 4911", "600106"),
    "priority 0": ("0005010f 0c00400001 1955 3e 4441cc0000 3f 4900", "600106"),
    "an input": ("0005010f 0c00000001 1955 3e 443f800000 3f", "50010f 9102 9128"),
    "a name cannot be written": ("0005010f 0c00400001 194d 3e 750200 41 3f", "50010f 9102 9128"),
    "the device object": ("0005010f 0c02003039 194d 3e 750200 41 3f", "50010f 9102 9128"),
    "above the limit": ("0005010f 0c00800009 1955 3e 4442480000 3f", "50010f 9102 9125"),
    "not a number": ("0005010f 0c00800009 1955 3e 447fc00000 3f", "50010f 9102 9125"),
    "another datatype": ("0005010f 0c00400001 1955 3e 2105 3f", "50010f 9102 9109"),
    "null without priority array": ("0005010f 0c00800009 1955 3e 00 3f", "50010f 9102 9109"),
    "boolean instead of enumerated": ("0005010f 0c01000001 1955 3e 11 3f", "50010f 9102 9109"),
    "enumerated instead of unsigned": ("0005010f 0c04c00001 1955 3e 9102 3f", "50010f 9102 9109"),
    "a state that there is not": ("0005010f 0c04c00001 1955 3e 2104 3f", "50010f 9102 9125"),
    "write two properties": (
        "00050110 0c00400001 1e 0955 2e 4441cc0000 2f 3908 1f 0c00800009 1e 0955 2e 4440600000 2f 1f",
        "200110",
    ),
    "the second of two writes fails": (
        "00050110 0c00400001 1e 0955 2e 4441cc0000 2f 3908 1f 0c00000001 1e 0955 2e 443f800000 2f 1f",
        "500110 0e 9102 9128 0f 1e 0c00000001 1955 1f",
    ),
    "priority 17 of the second of two writes": (
        "00050110 0c00400001 1e 0955 2e 4441cc0000 2f 0955 2e 4441cc0000 2f 3911 1f",
        "600106",
    ),
    "writes without a value": ("00050110 0c00400001 1e 0955 1f", "600105"),
    "no writes": ("00050110 0c00400001 1e 1f", "600105"),
    "a service that it does not have": ("00050105 0c00400001", "600109"),
    "no property": ("0005010c 0c00400001", "600105"),
    "no value": ("0005010f 0c00400001 1955", "600105"),
    "a length that is wrong": ("0005010c 0b000001 1955", "600104"),
    "more than was asked for": ("0005010c 0c00400001 1955 3955", "600107"),
    "a part of a request": ("08050100040c 0c00000001 1955", "710104"),
    "an answer that is too long": ("0000010c 0c02003039 194c", "710104"),
}


@pytest.mark.parametrize("name", VECTORS)
async def test_a_request_gets_the_answer_of_the_standard(peer: BacnetPeer, name: str) -> None:
    request, answer = VECTORS[name]
    assert await peer.ask(request) == answer.replace(" ", "")


async def test_the_present_value_is_the_slot_of_the_highest_priority(device: MockProgram, peer: BacnetPeer) -> None:
    start = await device.control.points()
    await device.control.ask("poke", params={"object": "analog-output,1", "priority": 5, "value": 99.0})
    assert await peer.ask("0005010f 0c00400001 1955 3e 4441cc0000 3f 4908") == "20010f"
    held = await device.control.points()
    assert (held["analog-output,1/present-value"], held["analog-output,1/priority-array/8"]) == (99.0, 25.5)
    await device.control.ask("poke", params={"object": "analog-output,1", "priority": 5, "value": None})
    assert (await device.control.points())["analog-output,1/present-value"] == 25.5
    assert await peer.ask("0005020f 0c00400001 1955 3e 00 3f 4908") == "20020f"
    assert await device.control.points() == start


async def test_names_are_what_the_kit_says(device: MockProgram, peer: BacnetPeer) -> None:
    for number, (target, asked) in enumerate((("analog-output,1", "0c00400001"), ("device,12345", "0c02003039"))):
        await device.control.ask("poke", params={"object": target, "name": f"\x1b{number}"})
        assert (await peer.ask(f"0005010c {asked} 194d")).endswith(f"3e73001b3{number}3f")
    with pytest.raises(RefusedError, match="name: expected a string"):
        await device.control.ask("poke", params={"object": "device,12345", "name": 5})


async def test_a_schedule_holds_the_lowest_priority_of_the_setpoint(device: MockProgram) -> None:
    before = await device.control.points()
    await device.control.ask("tick", steps=31)
    after = await device.control.points()
    point = "analog-value,2/priority-array/16"
    assert before[point] != after[point] == after["analog-value,2/present-value"] == after["schedule,1/present-value"]


async def test_a_sensor_without_reliability_raises_its_fault_flag(device: MockProgram, peer: BacnetPeer) -> None:
    await device.control.ask("poke", params={"object": "analog-input,1", "reliability": 1})
    assert (await peer.ask("0005010c 0c00000001 196f")).endswith("3e8204403f")


async def test_rusty_bacnet_reads_writes_and_is_refused(device: MockProgram) -> None:
    at = f"127.0.0.1:{device.port}"
    async with BACnetClient("127.0.0.1", 0) as client:
        assert (await client.read_property(at, ZONE, PRESENT)).value == 72.5
        listed = (await client.read_property(at, DEVICE, PropertyIdentifier.OBJECT_LIST)).value
        assert len(listed) == 11
        several = await client.read_property_multiple(
            at, [(ZONE, [(PRESENT, None), (PropertyIdentifier.UNITS, None)]), (FAN, [(PRESENT, None)])]
        )
        assert len(several) == 2
        await client.write_property(at, VALVE, PRESENT, PropertyValue.real(25.5), priority=8)
        assert (await client.read_property(at, VALVE, PropertyIdentifier.PRIORITY_ARRAY, 8)).value == 25.5
        await client.write_property(at, VALVE, PRESENT, PropertyValue.null(), priority=8)
        assert (await client.read_property(at, VALVE, PRESENT)).value == 20.0
        await client.write_property(at, FAN, PRESENT, PropertyValue.enumerated(1), priority=8)
        await client.write_property(at, MODE, PRESENT, PropertyValue.unsigned(3))
        with pytest.raises(BacnetProtocolError, match="class=1 code=31"):
            await client.read_property(at, ObjectIdentifier(ObjectType.ANALOG_INPUT, 77), PRESENT)
        for target, value, error in (
            (ZONE, PropertyValue.real(1.0), (2, 40)),
            (LEVEL, PropertyValue.real(50.0), (2, 37)),
            (MODE, PropertyValue.enumerated(2), (2, 9)),
        ):
            with pytest.raises(BacnetProtocolError, match=f"class={error[0]} code={error[1]}"):
                await client.write_property(at, target, PRESENT, value)
        with pytest.raises(BacnetRejectError):
            await client.delete_object(at, LEVEL)


@pytest_asyncio.fixture(loop_scope="module")
async def bacpypes(device: MockProgram) -> AsyncIterator[NormalApplication]:
    own = DeviceObject(objectIdentifier=("device", 4000000), objectName="test", vendorIdentifier=999)
    application = NormalApplication(own, IPv4Address("127.0.0.1:0"))
    yield application
    application.close()


async def test_bacpypes3_finds_reads_writes_and_is_refused(device: MockProgram, bacpypes: NormalApplication) -> None:
    at = Address(f"127.0.0.1:{device.port}")
    (found,) = await bacpypes.who_is(12345, 12345, address=at)
    assert str(found.iAmDeviceIdentifier) == "device,12345"
    assert await bacpypes.read_property(at, "analog-input,1", "present-value") == 72.5
    for (kind, instance), listed in zip(
        await bacpypes.read_property(at, "device,12345", "object-list"), range(11), strict=True
    ):
        name = await bacpypes.read_property(at, f"{kind},{instance}", "object-name")
        assert isinstance(name, str), listed
    every = await bacpypes.read_property_multiple(at, ["analog-output,1", ["all"], "device,12345", ["all"]])
    assert [one for one in every if isinstance(one[3], Exception)] == []
    assert len(every) == 31
    assert await bacpypes.write_property(at, "analog-output,1", "present-value", Real(25.5), priority=8) is None
    array = await bacpypes.read_property(at, "analog-output,1", "priority-array")
    assert [slot.real for slot in array][7] == 25.5
    assert await bacpypes.write_property(at, "analog-output,1", "present-value", Null(()), priority=8) is None
    with pytest.raises(ErrorRejectAbortNack, match="property: write-access-denied"):
        await bacpypes.write_property(at, "analog-input,1", "present-value", Real(1.0))


async def test_a_who_is_for_another_device_is_not_answered(device: MockProgram, peer: BacnetPeer) -> None:
    peer.send("1008 0a3038 1a3038", npdu="0100", function=0x0B)
    peer.send("1008 0a3039 1a3039", npdu="0120ffff00ff", function=0x0B)
    assert await peer.answer() == "01001000c4020030392205c491032203e7"
    peer.send("1008", npdu="0100")
    assert (await peer.answer()).startswith("01001000")
    peer.send("1007 3d0600 56616c7665", npdu="0100")
    assert await peer.answer() == "0100" + "1001 c402003039 c400400001 750600 56616c7665".replace(" ", "")
    asked = await device.control.journal(request=True)
    assert [entry.get("low") for entry in asked] == [12344, 12345, None, None]
    answered = {entry["answers"] for entry in await device.control.journal(direction="out")}
    assert answered == {entry["seq"] for entry in asked[1:]}


async def test_a_client_behind_a_router_is_answered_by_that_router(peer: BacnetPeer) -> None:
    peer.send("0005010c 0c00000001 1955", npdu="010c 0005 02 0a0b")
    assert (await peer.answer()).startswith("0120 0005 02 0a0b ff 30010c".replace(" ", ""))


async def test_only_what_may_change_the_plant_is_state_changing(device: MockProgram, peer: BacnetPeer) -> None:
    for service in range(33):
        await peer.ask(f"000501{service:02x} 0c00400001 1955")
    changing = await device.control.journal(state_changing=True)
    assert [entry["service"] for entry in changing] == [0, 7, 8, 9, 10, 11, 15, 16, 17, 20, 27]
    mark = await device.control.next()
    for service in range(13):
        peer.send(f"10{service:02x}", npdu="0100")
    await device.control.wait(mark, count=13, direction="in")
    seen = await device.control.journal(mark, direction="in")
    assert [entry.get("service") for entry in seen if entry["state_changing"]] == [6, 9, 10, 12]


async def test_a_request_that_is_repeated_is_answered_again_and_keeps_its_invoke_id(
    device: MockProgram, peer: BacnetPeer
) -> None:
    write = "0005070f 0c00400001 1955 3e 4441cc0000 3f 4908"
    assert [await peer.ask(write), await peer.ask(write)] == ["20070f", "20070f"]
    first, second = await device.control.journal(request=True)
    assert first["bytes"] == second["bytes"]
    assert (first["connection"], first["invoke_id"]) == (second["connection"], second["invoke_id"])


READ = "0005010c 0c00000001 1955"
PROBE, PROBED = "0005630c 0c00000001 1955", "30630c0c0000000119553e44429100003f"
WRITE = "0005010f 0c00400001 1955 3e 4441cc0000 3f 4908"


@pytest.mark.parametrize(
    ("action", "answer"),
    [
        ({"error": [0, 25]}, "50010c 9100 9119"),
        ({"reject": 9}, "600109"),
        ({"abort": 11}, "71010b"),
        ({"invoke_id": 1}, "30020c 0c00000001 1955 3e 4442910000 3f"),
        ({"answer_instance": 2}, "30010c 0c00000002 1955 3e 4442910000 3f"),
        ({"answer_values": [{"type": "unsigned", "value": 7}]}, "30010c 0c00000001 1955 3e 2107 3f"),
        ({"delay_s": 0.01}, "30010c 0c00000001 1955 3e 4442910000 3f"),
    ],
)
async def test_a_rule_falsifies_an_answer(
    device: MockProgram, peer: BacnetPeer, action: dict[str, Any], answer: str
) -> None:
    await device.control.ask("fault", rules=[{"service": 12, "object": "analog-input,1", "times": 1, "action": action}])
    assert await peer.ask(READ) == answer.replace(" ", "")
    assert await peer.ask(READ) == "30010c 0c00000001 1955 3e 4442910000 3f".replace(" ", "")
    assert await device.control.ask("fault", rules=[]) == {"hits": [1]}


async def test_a_rule_names_another_instance_to_who_reads_several_properties(
    device: MockProgram, peer: BacnetPeer
) -> None:
    multiple = "0005010e 0c00000001 1e 0955 1f"
    await device.control.ask("fault", rules=[{"times": 1, "action": {"answer_instance": 2}}])
    told = "30010e 0c0000000{} 1e 2955 4e 4442910000 4f 1f"
    assert await peer.ask(multiple) == told.format(2).replace(" ", "")
    assert await peer.ask(multiple) == told.format(1).replace(" ", "")


@pytest.mark.parametrize(
    ("action", "held", "answers"),
    [
        ({"ack_only": True}, None, 1),
        ({"clamp": [0, 10]}, 10.0, 1),
        ({"drop": True}, 25.5, 0),
        ({"lose": True}, None, 0),
        ({"duplicate": True}, 25.5, 2),
        ({"error": [2, 40]}, None, 1),
    ],
)
async def test_a_rule_decides_what_a_write_does(
    device: MockProgram, peer: BacnetPeer, action: dict[str, Any], held: float | None, answers: int
) -> None:
    await device.control.ask("fault", rules=[{"service": 15, "action": action}])
    peer.send(WRITE)
    # The answer to a later request shows that every answer to the earlier one has come.
    peer.send("00050263")
    got = [await peer.answer()]
    while not got[-1].endswith("600209"):
        got.append(await peer.answer())
    assert len(got) - 1 == answers
    assert (await device.control.points())["analog-output,1/priority-array/8"] == held
    (asked,) = await device.control.journal(state_changing=True)
    assert asked["fault"] == action


async def test_what_is_no_answer_is_in_the_journal_as_it_was_sent(device: MockProgram, peer: BacnetPeer) -> None:
    rules: list[dict[str, Any]] = [{"garbage": True}, {"truncate": 9}, {"mangle": {"flip": [[0, 1]]}}]
    await device.control.ask("fault", rules=[{"times": 1, "action": action} for action in rules])
    got = []
    for _ in rules:
        peer.send(READ)
        got.append((await asyncio.wait_for(peer.received.get(), PATIENCE_S)).hex())
    entries = await device.control.journal(direction="out")
    assert [entry["bytes"] for entry in entries] == got
    assert [(entry["kind"], entry["answers"]) for entry in entries] == [
        ("garbage", None),
        ("mangled", None),
        ("mangled", None),
    ]


async def test_a_black_hole_loses_and_a_stalled_network_delays(device: MockProgram, peer: BacnetPeer) -> None:
    await device.control.ask("poke", params={"network": "black_hole"})
    peer.send(READ)
    await device.control.wait(kind="lost")
    await device.control.ask("poke", params={"network": "stalled"})
    peer.send("0005020c 0c00000001 1955")
    mark = await device.control.next()
    assert await device.control.journal(mark) == []
    await device.control.ask("poke", params={"network": "open"})
    assert (await peer.answer()).startswith("010030020c")
    assert [entry["invoke_id"] for entry in await device.control.journal(request=True)] == [2]


async def test_what_a_stopped_device_did_not_see_is_never_executed(device: MockProgram, peer: BacnetPeer) -> None:
    device.say("stop")
    assert (await device.event())["event"] == "stopped"
    peer.send(WRITE)
    device.say("start")
    await device.ready()
    assert await peer.ask("0005020c 0c00000001 1955") == "30020c0c0000000119553e44429100003f"
    assert await device.control.journal(state_changing=True) == []


async def test_more_objects_than_fit_into_an_answer_are_read_one_by_one(device: MockProgram, peer: BacnetPeer) -> None:
    await device.control.ask("poke", params={"objects": 400})
    assert await peer.ask(f"0005010c {GET_OBJECT_LIST[2:]}".replace("0c0c", "0c 0c")) == "710104"
    assert (await peer.ask("0005010c 0c02003039 194c 2900")).endswith("3e22019b3f")
    assert (await peer.ask("0005010c 0c02003039 194c 2a019b")).endswith("3ec4008005773f")


async def test_objects_of_further_datatypes_hold_texts_large_numbers_and_no_numbers(
    device: MockProgram, peer: BacnetPeer
) -> None:
    await device.control.ask("poke", params={"types": True})
    for name, value in (
        ("positive-integer-value,1", 2**64 - 1),
        ("integer-value,1", -(2**63)),
        ("characterstring-value,1", "\u00e4"),
        ("large-analog-value,1", "-inf"),
        ("analog-input,1", "nan"),
    ):
        await device.control.ask("poke", params={"object": name, "value": value})
        assert (await device.control.points())[f"{name}/present-value"] == value
    for request, held in (
        ("0c0c000001", "2508 ffffffffffffffff"),
        ("0c0b400001", "3508 8000000000000000"),
        ("0c0a000001", "7300 c3a4"),
        ("0c0b800001", "5508 fff0000000000000"),
        ("0c00000001", "44 7fc00000"),
    ):
        answer = await peer.ask(f"0005010c {request} 1955")
        assert answer == f"30010c {request} 1955 3e {held} 3f".replace(" ", "")


async def test_bytes_that_mean_nothing_are_survived_and_change_nothing(device: MockProgram, peer: BacnetPeer) -> None:
    rng = random.Random(20261122)
    start = await device.control.points()
    seeds = [
        bytes.fromhex("810a" + "0000" + "0104" + request)
        for request, _ in VECTORS.values()
        if request[6:8] not in ("0f", "10")
    ]
    for number in range(600):
        data = bytearray(rng.choice(seeds))
        data[2:4] = len(data).to_bytes(2)
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        data = data[: rng.randrange(1, len(data) + 1)] if rng.random() < 0.3 else data
        if data[2:4] != len(data).to_bytes(2) and rng.random() < 0.8:
            data[2:4] = len(data).to_bytes(2)
        peer.transport.sendto(bytes(data))
        if not number % 20:
            # A socket's buffer does not hold all of them.
            peer.send(PROBE)
            while not (await peer.answer()).endswith(PROBED):
                pass
    assert await device.control.points() == start


async def test_clients_are_told_apart_by_their_sockets(device: MockProgram, peer: BacnetPeer) -> None:
    async with bacnet_peer(device) as other:
        await peer.ask(READ)
        await other.ask(READ)
        await peer.ask(READ)
    numbers = [entry["connection"] for entry in await device.control.journal(request=True)]
    first, second, third = numbers
    assert first == third != second


async def test_a_silent_device_is_not_there(device: MockProgram) -> None:
    await device.control.ask("fault", rules=[{"action": {"drop": True}}])
    async with BACnetClient("127.0.0.1", 0, apdu_timeout_ms=50) as client:
        with pytest.raises(BacnetAbortError, match="reason=10"):
            await client.read_property(f"127.0.0.1:{device.port}", ZONE, PRESENT)
