"""The PROFINET device against frames as they are on the wire, independent controllers, faults, and bytes that mean nothing."""

from __future__ import annotations

import asyncio
import json
import os
import random
import sys
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from mock_program import PATIENCE_S, MockProgram
from profinet_tools import MODULES, MULTICAST, NAME, Controller

from pytest_otmcp.session.cable import cable_refused
from pytest_otmcp.wire.profinet import dcp
from pytest_otmcp.wire.profinet.blocks import Module, Submodule, blocks_of
from pytest_otmcp.wire.profinet.dcp import Dcp
from pytest_otmcp.wire.profinet.frames import Frame
from pytest_otmcp.wire.profinet.rpc import CONNECT

pytestmark = [
    pytest.mark.asyncio(loop_scope="module"),
    pytest.mark.skipif(cable_refused() is not None, reason=f"no cable here: {cable_refused()}"),
]
MOCK = "profinet"
OUTPUTS = bytes(range(1, 9))


@pytest_asyncio.fixture(loop_scope="module")
async def controller(device: MockProgram) -> AsyncIterator[Controller]:
    # The relation of the test before ends at its watchdog; until then the device sends inputs.
    await device.control.poke(controller=False)
    await device.control.forget()
    joined = await Controller.join(device)
    yield joined
    await joined.close()


async def outputs(device: MockProgram, slot: int = 2) -> bytes:
    found: dict[str, Any] = (await device.control.image())["points"]
    return bytes(value for name, value in found.items() if name.startswith(f"{slot}.1.output."))


async def point(device: MockProgram, name: str) -> Any:
    return (await device.control.image())["points"][name]


def told(answer: Dcp, option: tuple[int, int]) -> bytes:
    found = answer.content(option)
    assert found is not None
    return found[2:]


async def test_both_stations_identify_themselves(controller: Controller) -> None:
    first = await controller.dcp(dcp.IDENTIFY, dcp.Block(dcp.ALL))
    second = Dcp.parse((await controller.frame()).payload)
    assert {told(one, dcp.NAME) for one in (first, second)} == {b"kit-device", b"kit-neighbour"}
    assert told(first, dcp.IDS) == bytes.fromhex("0abc0001")


async def test_a_station_is_found_by_its_name_alone(controller: Controller) -> None:
    found = await controller.dcp(dcp.IDENTIFY, dcp.Block(dcp.NAME, NAME.encode()))
    assert told(found, dcp.IP) == bytes([10, 77, 0, 2, 255, 255, 255, 0, 0, 0, 0, 0])


async def test_a_name_and_an_address_are_set_and_told(device: MockProgram, controller: Controller) -> None:
    done = await controller.dcp(dcp.SET, dcp.Block(dcp.NAME, b"\0\1kit-two"), dcp.Block(dcp.SIGNAL, b"\0\0\1\0"))
    assert [one.content for one in done.blocks] == [b"\2\2\0", b"\5\3\0"]
    await controller.dcp(dcp.SET, dcp.Block(dcp.IP, b"\0\0" + bytes([10, 77, 0, 9, 255, 255, 255, 0, 0, 0, 0, 0])))
    assert (await point(device, "name"), await point(device, "ip")) == ("kit-two", "10.77.0.9")
    found = await controller.dcp(dcp.GET, dcp.Block(dcp.NAME), dcp.Block((9, 9)))
    assert (told(found, dcp.NAME), found.blocks[1]) == (b"kit-two", dcp.Block(dcp.RESULT, b"\x09\x09\1"))
    assert (await device.control.image())["signalled"] == 1
    seen = await device.control.journal(direction="in")
    assert [(entry["service"], entry["state_changing"]) for entry in seen] == [
        ("set", True),
        ("set", True),
        ("get", False),
    ]


async def test_a_name_that_no_station_can_have_is_refused(device: MockProgram, controller: Controller) -> None:
    for name in (b"Kit_Two", b"-kit", b"10.77.0.2", b"port-001", b"a" * 64):
        done = await controller.dcp(dcp.SET, dcp.Block(dcp.NAME, b"\0\1" + name))
        assert done.blocks[0].content == b"\2\2\3", name
    assert await point(device, "name") == NAME


async def test_records_are_read_without_a_relation_and_written_with_one(
    device: MockProgram, controller: Controller
) -> None:
    await device.control.poke(slot=3, inputs="02d5")
    assert await controller.read(3, 0x8028) == (0, bytes.fromhex("0015000a 0100 0180 0180 0002 02d5"))
    assert (await controller.read(0, 0xAFF0))[1][8:16] == b"KIT-PN-1"
    assert await controller.write(1, 1, b"\0\xfa") == 0xDF814005
    assert (await controller.supervise()).status == 0
    assert await controller.write(1, 1, b"\0\xfa") == 0
    assert await controller.read(1, 1) == (0, b"\0\xfa")
    assert await controller.release() == 0
    assert await controller.release() == 0xDC814005


async def test_what_a_record_cannot_have_is_refused(controller: Controller) -> None:
    await controller.supervise()
    assert (await controller.read(9, 1))[0] == 0xDE80B200
    assert (await controller.read(1, 77))[0] == 0xDE80B000
    for index, content, code in ((77, b"\0\1", 0xB0), (1, b"\x13\x88", 0xB7), (1, bytes(4), 0xB1), (2, bytes(4), 0xB6)):
        assert await controller.write(1, index, content) == 0xDF800000 | code << 8


async def test_a_call_that_is_repeated_with_its_number_is_not_executed_again(
    device: MockProgram, controller: Controller
) -> None:
    await controller.supervise()
    assert await controller.write(3, 3, b"\1\2") == 0
    await device.control.poke(slot=3, index=3, record="0506")
    assert await controller.write(3, 3, b"\1\2", again=True) == 0
    assert await point(device, "3.1.record.3.0") == 5
    seen = await device.control.journal(service="write", direction="in")
    assert [(entry["state_changing"], entry.get("repeated", False)) for entry in seen] == [(True, False), (False, True)]


async def test_a_client_with_little_endian_headers_is_understood(controller: Controller) -> None:
    assert (await controller.supervise(little=True)).status == 0
    assert (await controller.call(CONNECT, b"", little=True)).status == 0xDB810100


async def test_a_controller_sends_outputs_and_gets_inputs(device: MockProgram, controller: Controller) -> None:
    await device.control.poke(slot=1, inputs="0102030405060708")
    await controller.control_device()
    assert (await controller.inputs()).data[:9] == bytes.fromhex("010203040506070880")
    controller.drive(OUTPUTS, good=False)
    controller.drive(OUTPUTS)
    controller.drive(OUTPUTS)
    await device.control.wait(kind="request", service="outputs")
    assert await outputs(device) == OUTPUTS
    seen = await device.control.journal(service="outputs")
    assert [entry["subslots"] for entry in seen if entry["kind"] == "request"] == [{"2.1": OUTPUTS.hex()}]
    assert (await controller.read(2, 0x8029))[1][6:19] == bytes.fromhex("00000101000880010203040506")
    await controller.release()
    assert await outputs(device) == bytes(8)


async def test_outputs_are_those_of_the_relation_whatever_socket_sends_them(
    device: MockProgram, controller: Controller
) -> None:
    await controller.control_device()
    other = await Controller.join(device)
    other.mac = controller.mac
    other.drive(OUTPUTS, frame_id=0xC102)
    other.drive(OUTPUTS)
    await device.control.wait(kind="request", service="outputs")
    assert await outputs(device) == OUTPUTS
    foreign, own = await device.control.journal(service="outputs")
    assert (foreign["kind"], foreign["state_changing"]) == ("cycle", False)
    assert (own["state_changing"], own["subslots"]) == (True, {"2.1": OUTPUTS.hex()})
    assert own["connection"] != (await device.control.journal(service="connect"))[0]["connection"]
    await other.close()
    await controller.release()


async def test_a_relation_that_is_used_outlives_others(device: MockProgram, controller: Controller) -> None:
    await controller.control_device()
    controller.drive(OUTPUTS)
    driving = controller.relation
    for _ in range(20):
        controller.relation = os.urandom(16)
        assert (await controller.supervise()).status == 0
    controller.relation = driving
    assert await controller.write(1, 1, b"\0\xfa") == 0
    await controller.release()
    assert await controller.write(1, 1, b"\0\xfa") == 0xDF814005


async def test_outputs_fall_at_the_watchdog(device: MockProgram, controller: Controller) -> None:
    await controller.control_device(watchdog=3)
    controller.drive(OUTPUTS)
    (fallen,) = await device.control.wait(kind="watchdog")
    assert fallen["outputs"] == {"2.1": OUTPUTS.hex(), "4.1": "0000"}
    assert await outputs(device) == bytes(8)


async def test_other_modules_are_told_and_other_controllers_are_refused(
    device: MockProgram, controller: Controller
) -> None:
    await device.control.poke(slot=2, module="00000099")
    answer = await controller.control_device()
    assert [f"{one.type:04x}" for one in blocks_of(answer.blocks)[0]] == ["8101", "8102", "8102", "8104"]
    controller.drive(OUTPUTS)
    await device.control.wait(service="outputs")
    assert await outputs(device) == bytes(8)
    await device.control.poke(controller=True)
    assert (await controller.control_device()).status == 0xDB814004


async def test_a_relation_that_is_too_fast_or_has_no_cyclic_data_is_refused(controller: Controller) -> None:
    assert (await controller.control_device(ratio=16)).status == 0xDB810209
    missing = Module(slot=7, identifier=1, submodules={1: Submodule(identifier=1)})
    answer = await controller.control_device(modules=(*MODULES, missing))
    assert blocks_of(answer.blocks)[0][-1].body[-6:] == bytes(6)


@pytest.mark.parametrize(
    ("action", "kinds"),
    [
        ({"drop": True}, []),
        ({"lose": True}, []),
        ({"garbage": True}, ["garbage"]),
        ({"truncate": 20}, ["mangled"]),
        ({"mangle": {"cut": 4}}, ["mangled"]),
        ({"duplicate": True}, ["response", "response"]),
    ],
)
async def test_answers_get_lost_and_damaged(
    device: MockProgram, controller: Controller, action: dict[str, Any], kinds: list[str]
) -> None:
    await device.control.fault(action, service="read", times=1)
    reading = asyncio.ensure_future(controller.read(1, 1))
    await device.control.wait(service="read")
    found = [entry["kind"] for entry in await device.control.journal(direction="out")]
    assert found == kinds
    reading.cancel()


async def test_what_is_said_otherwise_than_it_is(device: MockProgram, controller: Controller) -> None:
    rules = [
        {"service": "read", "times": 1, "action": {"error": 0xA0}},
        {"service": "read", "times": 1, "action": {"answer_slot": 7, "answer_data": "0102"}},
        {"service": "write", "action": {"ack_only": True}},
    ]
    await device.control.ask("fault", rules=rules)
    assert (await controller.read(1, 1))[0] == 0xDE80A000
    assert await controller.read(1, 1) == (0, b"\1\2")
    await controller.supervise()
    assert await controller.write(3, 3, b"\7\7") == 0
    assert await point(device, "3.1.record.3.0") == 0


async def test_frames_that_mean_nothing_do_not_end_the_device(device: MockProgram, controller: Controller) -> None:
    rng = random.Random(3)
    for _ in range(300):
        ethertype = rng.choice((0x8892, 0x8892, 0x0800, 0x0806, 0x86DD))
        head = rng.choice((b"", b"\xfe\xfe\5\0", b"\xfe\xfd\4\0", b"\xc1\1", b"E\0"))
        controller.send(head + rng.randbytes(rng.randrange(120)), ethertype=ethertype, to=rng.choice((None, MULTICAST)))
    assert (await controller.read(1, 1))[0] == 0


async def test_frames_that_are_nearly_right_do_not_end_the_device(device: MockProgram, controller: Controller) -> None:
    await controller.control_device()
    controller.drive(OUTPUTS)
    known, rng = list(controller.sent), random.Random(5)
    for _ in range(300):
        raw = bytearray(rng.choice(known))
        raw[rng.randrange(14, len(raw))] ^= 1 << rng.randrange(8)
        controller.send_raw(bytes(raw[: rng.choice((len(raw), rng.randrange(14, len(raw))))]))
    assert (await controller.read(0, 0xAFF0))[0] == 0


async def test_a_tag_of_a_virtual_network_is_passed_over() -> None:
    tagged = Frame.parse(bytes(12) + bytes.fromhex("8100c000 8892 fefe"))
    assert (tagged.ethertype, tagged.payload) == (0x8892, b"\xfe\xfe")


# -- controllers of other authors -----------------------------------------------------------------------------


async def of_another_author(device: MockProgram, script: str, library: str, *words: str) -> asyncio.subprocess.Process:
    pytest.importorskip(library, reason=f"the client of another author is not installed: {library}")
    address = device.ready_event["endpoints"]["profinet"]
    join = ("nsenter", "-t", str(address["join"]), "-U", "-n", "--preserve-credentials")
    path = str(Path(__file__).with_name(script))
    return await asyncio.create_subprocess_exec(*join, sys.executable, path, *words, stdin=PIPE, stdout=PIPE)


async def told_by(client: asyncio.subprocess.Process) -> dict[str, Any]:
    assert client.stdout is not None
    async with asyncio.timeout(PATIENCE_S):
        found: dict[str, Any] = json.loads(await client.stdout.readline() or b"{}")
    return found


@pytest.mark.long
async def test_profinet_py_accesses_records_and_exchanges_cyclic_data(device: MockProgram) -> None:
    await device.control.poke(slot=1, inputs="0102030405060708")
    client = await of_another_author(device, "profinet_py_controller.py", "profinet", "otmcp0", NAME)
    told = await told_by(client)
    assert told == {
        "name": NAME,
        "ip": "10.77.0.2",
        "record": "00fa",
        "order": "KIT-PN-1",
        "refused": True,
        "inputs": "0102030405060708",
    }
    await device.control.wait(kind="request", service="outputs")
    assert await outputs(device) == OUTPUTS
    await client.communicate(b"\n")
    seen = await device.control.journal(direction="in")
    assert [entry["kind"] for entry in seen if entry["kind"] == "malformed"] == []
    assert [entry["data"] for entry in seen if entry["state_changing"] and entry["service"] == "write"] == [
        "00fa",
        "1388",
    ]


@pytest.mark.long
async def test_profi_dcp_finds_names_and_signals_stations(device: MockProgram) -> None:
    client = await of_another_author(device, "profi_dcp_client.py", "profi_dcp", "10.77.0.1")
    told = await told_by(client)
    await client.communicate()
    mac = (await device.control.image())["stations"]["kit-device"]["mac"]
    assert [told[NAME][0].lower(), told["kit-neighbour"][1]] == [mac, "10.77.0.3"]
    assert (told["name"], "kit-three" in (await device.control.image())["stations"]) == ("kit-three", True)
    seen = await device.control.journal(direction="in")
    assert {entry["service"] for entry in seen} == {"identify", "set", "get", "signal"}
