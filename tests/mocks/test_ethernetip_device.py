"""The Logix controller: its answers byte by byte, two clients of other authors, malformed input, faults."""

# Neither library declares its exports.
# mypy: disable-error-code="import-untyped"

from __future__ import annotations

import asyncio
import random
import struct
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from ethernetip_tools import RawEip, cip, forward_close, forward_open, frame, multiple, packet, symbol
from mock_program import MockProgram, RefusedError
from pycomm3 import LogixDriver
from pylogix import PLC

pytestmark = pytest.mark.asyncio(loop_scope="module")
MOCK = "ethernetip"

READ, PART, WRITE, WRITE_PART, MODIFY = 0x4C, 0x52, 0x4D, 0x53, 0x4E
SYMBOLS, MANAGER, CLOCK = bytes.fromhex("206b2400"), bytes.fromhex("20062401"), bytes.fromhex("208b2401")
VALVE = symbol("ValvePosition")


@pytest_asyncio.fixture(loop_scope="module")
async def raw(device: MockProgram) -> AsyncIterator[RawEip]:
    connection = RawEip()
    await connection.open(device)
    yield connection
    await connection.close()


# -- sessions and connections ---------------------------------------------------------------------------------


async def test_a_session_is_registered_once_and_needed(device: MockProgram) -> None:
    connection = RawEip()
    await connection.dial(device)
    read = packet((0, b""), (0xB2, cip(READ, VALVE, "0100")))
    assert (await connection.ask(frame(0x6F, read)))[8:12].hex() == "64000000"
    assert (await connection.ask(frame(0x65, b"\x02\0\0\0")))[8:12].hex() == "69000000"
    assert (await connection.ask(frame(0x65, b"\x01\0")))[8:12].hex() == "65000000"
    first = await connection.ask(frame(0x65, b"\x01\0\0\0"))
    assert first[8:12].hex() == "00000000"
    assert (await connection.ask(frame(0x65, b"\x01\0\0\0")))[8:12].hex() == "01000000"
    session = int.from_bytes(first[4:8], "little")
    assert (await connection.ask(frame(0x6F, read, session=session + 1)))[8:12].hex() == "64000000"
    assert (await connection.ask(frame(0x6F, b"\0" * 8, session=session)))[8:12].hex() == "03000000"
    assert (await connection.ask(frame(0x99, session=session)))[8:12].hex() == "01000000"
    assert (await device.control.image())["sessions"] == 1
    connection.writer.write(frame(0x00) + frame(0x66, session=session))
    assert await connection.ended()
    await connection.close()
    await device.control.wait(kind="DISCONNECTED")
    assert (await device.control.image())["sessions"] == 0
    refused = await device.control.journal(kind="request")
    assert [entry["items"][0]["tag"] for entry in refused] == ["ValvePosition"] * 2


async def test_the_controller_tells_who_it_is_without_a_session(device: MockProgram) -> None:
    connection = RawEip()
    await connection.dial(device)
    identity = await connection.ask(frame(0x63))
    assert identity.endswith(b"\x0b1756-L83E/B\x03")
    assert b"Communications" in await connection.ask(frame(0x04))
    assert (await connection.ask(frame(0x64)))[24:].hex() == "0000"
    await connection.close()
    [asked] = await device.control.journal(kind="request")
    assert (asked["service"], asked["state_changing"]) == ("list_identity", False)


@pytest.mark.parametrize(
    "sent", [b"\x65\0\xff\xff", frame(0x65, b"\x01\0\0\0", status=1), frame(0x65, b"\x01\0\0\0")[:20] + b"\1\0\0\0" * 2]
)
async def test_what_is_no_request_ends_the_connection(device: MockProgram, sent: bytes) -> None:
    connection = RawEip()
    await connection.dial(device)
    connection.writer.write(sent)
    assert await connection.ended()
    await connection.close()
    assert [entry["bytes"] for entry in await device.control.journal(kind="malformed")] == [sent.hex()]


OPENED = {
    "another slot": (forward_open(path="0101 2002 2401"), 0x0312),
    "another port": (forward_open(path="0200 2002 2401"), 0x0311),
    "no message router": (forward_open(path="0100 2004 2401"), 0x0315),
    "data of the plant": (forward_open(transport=0x01), 0x0103),
    "too few bytes": (forward_open(size=16), 0x0109),
    "too many bytes": (forward_open(size=5000), 0x0109),
}


@pytest.mark.parametrize("name", OPENED)
async def test_a_connection_that_leads_elsewhere_is_refused(device: MockProgram, raw: RawEip, name: str) -> None:
    request, reason = OPENED[name]
    answer = await raw.unconnected(request)
    assert (answer[2], answer[3], int.from_bytes(answer[4:6], "little")) == (1, 1, reason)
    assert (await device.control.image())["connections"] == 0
    drives = name == "data of the plant"
    [entry] = await device.control.journal(service="forward_open", direction="in")
    assert (entry["request"], entry["state_changing"]) == (drives, drives)


async def test_connections_are_counted_limited_and_closed(device: MockProgram, raw: RawEip) -> None:
    await device.control.ask("poke", params={"connection_limit": 2})
    await raw.join(1)
    await raw.join(2, size=4002)
    assert (await raw.unconnected(forward_open(2)))[4:6].hex() == "0001"
    assert (await raw.unconnected(forward_open(3)))[4:6].hex() == "1301"
    assert (await raw.unconnected(forward_close(1)))[2] == 0
    assert (await raw.unconnected(forward_close(1)))[4:6].hex() == "0701"
    assert (await device.control.image())["connections"] == 1
    await raw.close()
    await device.control.wait(kind="DISCONNECTED")
    image = await device.control.image()
    assert (image["connections"], image["forgotten"]) == (0, 1)


async def test_a_request_on_a_connection_is_executed_once_and_never_on_an_unknown_one(
    device: MockProgram, raw: RawEip
) -> None:
    await raw.join()
    write = cip(WRITE, VALVE, "c400 0100 29000000")
    assert (await raw.connected(write)).hex() == "cd000000"
    await device.control.ask("poke", params={"tag": "ValvePosition", "value": 1})
    raw.count -= 1
    assert (await raw.connected(write)).hex() == "cd000000"
    assert (await device.control.points())["ValvePosition"] == 1
    await device.control.ask("poke", params={"connections": "forget"})
    raw.send_connected(write)
    assert (await raw.unconnected(cip(READ, VALVE, "0100"))).hex() == "cc000000c40001000000"
    writes = await device.control.journal(service="write", direction="in")
    assert [entry["sequence"] for entry in writes] == [1, 1, 2]
    assert len(await device.control.journal(service="write", direction="out")) == 2


async def test_a_message_is_no_longer_than_was_agreed(device: MockProgram, raw: RawEip) -> None:
    await raw.join(size=64)
    assert (await raw.connected(cip(READ, symbol("Counts"), "4000")))[2] == 6
    raw.send_connected(cip(READ, VALVE, "0100" + "00" * 60))
    assert await raw.ended()


async def test_an_unconnected_send_goes_to_its_slot(device: MockProgram, raw: RawEip) -> None:
    def wrapped(request: bytes, route: str) -> bytes:
        body = struct.pack("<BBH", 10, 14, len(request)) + request + bytes(len(request) % 2)
        hops = bytes.fromhex(route)
        return cip(0x52, MANAGER, (body + bytes([len(hops) // 2, 0]) + hops).hex())

    assert (await raw.unconnected(wrapped(cip(READ, VALVE, "0100"), "0100"))).hex() == "cc000000c40032000000"
    assert (await raw.unconnected(wrapped(cip(READ, VALVE, "0100"), "0103"))).hex() == "d200010112030100"
    assert (await raw.unconnected(cip(0x52, MANAGER, "0a0e")))[2] == 8
    [first, *_] = await device.control.journal(kind="request")
    assert (first["service"], first["route"], first["items"][0]["tag"]) == ("read", "0100", "ValvePosition")


# -- tags -----------------------------------------------------------------------------------------------------

LEVELS, COUNTS = symbol("Levels"), symbol("Counts")
READS = {
    "a number": (cip(READ, VALVE, "0100"), "cc000000 c400 32000000"),
    "in whichever case": (cip(READ, symbol("valveposition"), "0100"), "cc000000 c400 32000000"),
    "by instance": (cip(READ, bytes.fromhex("206b25000d01"), "0100"), "cc000000 c400 32000000"),
    "a true": (cip(READ, symbol("PumpEnabled"), "0100"), "cc000000 c100 ff"),
    "elements": (cip(READ, symbol("Levels", 1), "0200"), "cc000000 ca00 00004841 00007041"),
    "by a wide index": (cip(READ, LEVELS + bytes.fromhex("2900 0100"), "0100"), "cc000000 ca00 00004841"),
    "a member": (cip(READ, symbol("Recipe", "Rate"), "0100"), "cc000000 ca00 00004841"),
    "a bit of a structure": (cip(READ, symbol("Recipe", "Enabled"), "0100"), "cc000000 c100 00"),
    "a member of a member": (cip(READ, symbol("Recipe", "Name", "LEN"), "0100"), "cc000000 c400 04000000"),
    "of a program": (cip(READ, symbol("Program:MainProgram", "Step"), "0100"), "cc000000 c400 00000000"),
    "a text": (cip(READ, symbol("Message"), "0100"), "cc000000 a002ce0f 05000000" + b"ready".hex() + "00" * 79),
    "a part": (cip(PART, LEVELS, "0200 04000000"), "d2000000 ca00 00004841"),
    "a missing tag": (cip(READ, symbol("NoSuchTag"), "0100"), "cc000401 0000"),
    "a missing program": (cip(READ, symbol("Program:Other", "Step"), "0100"), "cc000401 0000"),
    "a hidden tag": (cip(READ, symbol("Hidden"), "0100"), "cc000401 0000"),
    "a missing member": (cip(READ, symbol("Recipe", "Colour"), "0100"), "cc000501 0000"),
    "a missing instance": (cip(READ, bytes.fromhex("206b25000009"), "0100"), "cc000501 0000"),
    "an element of a number": (cip(READ, symbol("ValvePosition", 0), "0100"), "cc000401 0000"),
    "beyond the end": (cip(READ, symbol("Levels", 10), "0100"), "cc000501 0000"),
    "more than there are": (cip(READ, symbol("Levels", 8), "0300"), "cc00ff01 0521"),
    "no element": (cip(READ, LEVELS, "0000"), "cc000300"),
    "no count": (cip(READ, LEVELS), "cc001300"),
    "too much": (cip(READ, LEVELS, "010000"), "cc001500"),
    "a part beyond the end": (cip(PART, LEVELS, "0200 08000000"), "d200ff01 0421"),
    "a path that is cut off": (b"\x4c\x09" + VALVE, "cc002600"),
    "a segment that is none": (cip(READ, b"\xe0\0"), "cc000401 0000"),
    "an object that is none": (cip(0x01, bytes.fromhex("20f52401")), "81000501 0000"),
    "a service that is none": (cip(0x4B, VALVE), "cb000800"),
    "a reset": (cip(0x05, bytes.fromhex("20012401")), "85000800"),
}


@pytest.mark.parametrize("name", READS)
async def test_a_request_is_answered(raw: RawEip, name: str) -> None:
    request, expected = READS[name]
    assert (await raw.unconnected(request)).hex() == expected.replace(" ", "")


WRITES: dict[str, tuple[bytes, str, dict[str, Any]]] = {
    "a number": (cip(WRITE, VALVE, "c400 0100 29000000"), "00", {"ValvePosition": 41}),
    "a true": (cip(WRITE, symbol("FreeBool"), "c100 0100 01"), "00", {"FreeBool": True}),
    "elements": (cip(WRITE, symbol("Counts", 3), "c300 0200 0700feff"), "00", {"Counts[3]": 7, "Counts[4]": -2}),
    "a bit of a structure": (cip(WRITE, symbol("Recipe", "Enabled"), "c100 0100 ff"), "00", {"Recipe.Enabled": True}),
    "more than is announced": (cip(WRITE, VALVE, "c400 0100 29000000 4d04"), "00", {"ValvePosition": 41}),
    "a text": (
        cip(WRITE, symbol("Message"), "a002ce0f 0100 02000000" + b"ok".hex() + "00" * 82),
        "00",
        {"Message": "ok"},
    ),
    "a part": (cip(WRITE_PART, COUNTS, "c300 0300 02000000 0500 0600"), "00", {"Counts[1]": 5, "Counts[2]": 6}),
    "bits": (cip(MODIFY, symbol("Flags"), "0400 08000000 ffffffff"), "00", {"Flags": 8}),
    "another type": (cip(WRITE, VALVE, "ca00 0100 00002442"), "ff", {}),
    "another structure": (cip(WRITE, symbol("Message"), "a0020101 0100" + "00" * 88), "ff", {}),
    "too few bytes": (cip(WRITE, VALVE, "c400 0100 2900"), "13", {}),
    "no value": (cip(WRITE, VALVE, "c400"), "13", {}),
    "too many elements": (cip(WRITE, symbol("Levels", 9), "ca00 0200" + "00" * 8), "ff", {}),
    "what is locked": (cip(WRITE, symbol("Locked"), "c400 0100 29000000"), "0f", {}),
    "what is hidden": (cip(WRITE, symbol("Hidden"), "c400 0100 29000000"), "04", {}),
    "a part beyond the end": (cip(WRITE_PART, COUNTS, "c300 0200 02000000 0500 0600"), "ff", {}),
    "bits of a REAL": (cip(MODIFY, symbol("FreeReal"), "0400 08000000 ffffffff"), "ff", {}),
    "masks of another size": (cip(MODIFY, symbol("Flags"), "0200 0800 ffff"), "03", {}),
    "masks that are cut off": (cip(MODIFY, symbol("Flags"), "0400 08000000 ff"), "13", {}),
}


@pytest.mark.parametrize("name", WRITES)
async def test_a_write_changes_what_it_names_or_nothing(device: MockProgram, raw: RawEip, name: str) -> None:
    request, status, changed = WRITES[name]
    await device.control.ask("poke", params={"tag": "FreeBool", "value": False})
    before = await device.control.points()
    assert (await raw.unconnected(request))[2:3].hex() == status
    after = await device.control.points()
    moving = {"MotorSpeed", "Temperature", "TankLevel", "AlarmHigh", "Program:MainProgram.MotorSpeed"}
    assert {name for name in after if after[name] != before[name]} - moving == set(changed)
    assert changed.items() <= after.items()
    [entry] = await device.control.journal(kind="request")
    assert entry["state_changing"]


async def test_what_is_too_long_comes_in_parts(raw: RawEip) -> None:
    await raw.join(size=64)
    first = await raw.connected(cip(READ, COUNTS, "4000"))
    assert (first[2], len(first)) == (6, 62)
    rest, offset = first[6:], len(first) - 6
    while offset < 128:
        part = await raw.connected(cip(PART, COUNTS, "4000" + struct.pack("<I", offset).hex()))
        rest, offset = rest + part[6:], offset + len(part) - 6
    assert (len(rest), part[2]) == (128, 0)


async def test_services_in_one_packet_have_a_status_each(device: MockProgram, raw: RawEip) -> None:
    write = multiple(
        cip(WRITE, VALVE, "c400 0100 07000000"), cip(WRITE, symbol("Locked"), "c400 0100 07000000"), multiple(b"\x4c\0")
    )
    answer = await raw.unconnected(write)
    assert answer.hex() == "8a001e00 0300 0800 0c00 1000 cd000000 cd000f00 8a000800".replace(" ", "")
    held = await device.control.points()
    assert (held["ValvePosition"], held["Locked"]) == (7, 4711)
    [entry] = await device.control.journal(service="multiple", direction="in")
    assert [item["asks"] for item in entry["items"]] == ["write", "write", "multiple"]
    assert (await raw.unconnected(cip(0x0A, bytes.fromhex("20022401"), "0200 0400")))[2] == 0x13
    assert (await raw.unconnected(multiple(*[cip(READ, symbol("Message"), "0100")] * 8)))[2] == 0x1E


async def test_the_list_of_tags_has_no_hidden_one_and_goes_on_where_it_ended(raw: RawEip) -> None:
    found = {}
    first = 0
    while True:
        path = bytes.fromhex("206b2500") + struct.pack("<H", first)
        answer = await raw.unconnected(cip(0x55, path, "0300 0100 0200 0a00"))
        rest = answer[4:]
        while rest:
            first, length = struct.unpack_from("<IH", rest)
            kind, access = struct.unpack_from("<HB", rest, 6 + length)
            found[rest[6 : 6 + length].decode()] = (kind, access)
            rest = rest[9 + length :]
        first += 1
        if answer[2] != 6:
            break
    assert answer[2] == 0
    assert found["ValvePosition"] == (0xC4, 0)
    assert found["Levels"] == (0x20CA, 0)
    assert found["Message"] == (0x8FCE, 0)
    assert found["Locked"] == (0xC4, 2)
    assert found["Program:MainProgram"] == (0x1068, 0)
    assert "Hidden" not in found
    of_program = await raw.unconnected(cip(0x55, symbol("Program:MainProgram") + SYMBOLS, "0100 0100"))
    assert b"Tank_Levels" in of_program
    assert (await raw.unconnected(cip(0x55, SYMBOLS, "0100 6300")))[2] == 0x0A
    assert (await raw.unconnected(cip(0x55, SYMBOLS, "0200 0100")))[2] == 0x13


async def test_the_clock_is_read_and_set(device: MockProgram, raw: RawEip) -> None:
    moment = 1_936_000_000_000_000
    set_to = "0100 0600" + struct.pack("<Q", moment).hex()
    assert (await raw.unconnected(cip(4, CLOCK, set_to))).hex() == "84000000010006000000"
    answer = await raw.unconnected(cip(3, CLOCK, "0100 0b00"))
    assert answer[:10].hex() == "8300000001000b000000"
    assert 0 <= int.from_bytes(answer[10:], "little") - moment < 60_000_000
    assert (await device.control.points())["Clock"] == "2031-05-08T09:46:40+00:00"
    assert (await raw.unconnected(cip(4, CLOCK, "0100 0600" + "ff" * 8)))[2] == 9
    assert (await raw.unconnected(cip(4, CLOCK, "0100 6300 00")))[2] == 0x0A
    assert (await raw.unconnected(cip(4, CLOCK, set_to + "00")))[2] == 0x15
    assert (await device.control.points())["Clock"] == "2031-05-08T09:46:40+00:00"


async def test_restless_bits_turn_before_every_request(device: MockProgram, raw: RawEip) -> None:
    await device.control.ask("poke", params={"restless": [{"tag": "Flags", "bits": 64}]})
    read = cip(READ, symbol("Flags"), "0100")
    assert [(await raw.unconnected(read))[6] for _ in range(3)] == [64, 0, 64]
    assert (await device.control.image())["restless"] == [{"tag": "Flags", "bits": 64, "changes": 3}]


# -- clients of other authors ---------------------------------------------------------------------------------


async def test_pylogix_reads_and_writes_everything(device: MockProgram) -> None:
    def exchange() -> None:
        with PLC(device.host, port=device.port) as client:
            assert client.Read("Levels", 10).Value == [10.0 + 2.5 * index for index in range(10)]
            several = client.Read(["ValvePosition", "Message", "NoSuchTag", "Program:MainProgram.Tank_Levels[2]"])
            assert [one.Value for one in several] == [50, "ready", None, 32.0]
            assert client.Write("ValvePosition", 31).Status == "Success"
            assert client.Write("Flags.3", 1).Status == "Success"
            assert client.Write("Message", "hello").Status == "Success"
            both = client.Write([("HeaterPower", 5), ("Locked", 3)])
            assert [one.Status for one in both] == ["Success", "Privilege violation"]
            tags = {tag.TagName: tag.DataType for tag in client.GetTagList().Value}
            assert tags["Recipe"] == "Recipe"
            assert tags["Program:MainProgram.Step"] == "DINT"
            assert [field.TagName for field in client.UDTByName["Recipe"].Fields][:3] == ["Name", "Rate", "Count"]
            assert client.GetDeviceProperties().Value.ProductName == "1756-L83E/B"
            assert client.SetPLCTime(0).Status == client.GetPLCTime().Status == "Success"
            # pylogix makes this socket and never closes it (1.1.6).
            client.conn.msg_socket.close()

    await asyncio.to_thread(exchange)
    held = await device.control.points()
    assert [held[name] for name in ("ValvePosition", "Flags", "Message", "HeaterPower")] == [31, 8, "hello", 5]
    await device.control.wait(kind="unregister")
    assert (await device.control.image())["forgotten"] == 0
    assert await device.control.journal(kind="malformed") == []


async def test_pycomm3_reads_and_writes_everything(device: MockProgram) -> None:
    recipe = {"Name": "x", "Rate": 2.5, "Count": 9, "Enabled": True}

    def exchange() -> None:
        with LogixDriver(f"{device.host}:{device.port}/0") as client:
            assert client.info["keyswitch"] == "REMOTE RUN"
            assert client.tags["Locked"]["external_access"] == "Read Only"
            read = client.read("Levels{3}", "PumpEnabled", "Recipe", "Program:MainProgram.Step", "Counts{64}")
            assert [one.error for one in read] == [None] * 5
            assert read[2].value["Name"] == "base"
            assert client.write("ValvePosition", 31)
            written = client.write(("HeaterPower", 5), ("Locked", 3), ("Flags.4", True), ("PumpEnabled", False))
            assert [bool(one) for one in written] == [True, False, True, True]
            assert client.write("Recipe", recipe)
            assert client.read("Recipe").value == recipe
            assert client.get_plc_time()
            assert client.set_plc_time()
            assert client.get_module_info(0)["product_name"] == "1756-L83E/B"

    await asyncio.to_thread(exchange)
    held = await device.control.points()
    assert [held[name] for name in ("ValvePosition", "HeaterPower", "Flags", "PumpEnabled")] == [31, 5, 16, False]
    assert await device.control.journal(kind="malformed") == []
    # pycomm3 sends path, type and value a second time behind the value; that is no second write.
    [single, *_] = [
        entry for entry in await device.control.journal(service="write") if entry["items"][0].get("type") == 0xC4
    ]
    assert (single["items"][0]["data"], single["items"][0]["excess"]) == ("1f000000", 18)


# -- malformed input ------------------------------------------------------------------------------------------


async def test_noise_never_stops_the_controller(device: MockProgram, raw: RawEip) -> None:
    chance = random.Random(20261123)
    messages = [
        cip(WRITE, VALVE, "c400 0100 29000000"),
        multiple(cip(READ, VALVE, "0100"), cip(MODIFY, symbol("Flags"), "0400 08000000 ffffffff")),
        forward_open(3),
        cip(0x55, symbol("Program:MainProgram") + SYMBOLS, "0200 0100 0200"),
    ]
    for number in range(200):
        connection = RawEip()
        if number % 5 == 0:
            await connection.dial(device)
            connection.writer.write(chance.randbytes(chance.randrange(1, 600)))
        else:
            await connection.open(device)
            data = packet((0, b""), (0xB2, chance.choice(messages)))
            sent = bytearray(frame(0x6F, data, session=connection.session))
            # The header stays in most cases, so that the noise arrives behind it.
            first = 24 if number % 5 < 4 else 0
            for _ in range(chance.randrange(1, 6)):
                sent[chance.randrange(first, len(sent))] = chance.randrange(256)
            connection.writer.write(bytes(sent[: chance.randrange(1, len(sent) + 1)] if number % 5 == 3 else sent))
        await connection.close()
    await device.control.wait(kind="DISCONNECTED", count=200)
    assert (await raw.unconnected(cip(READ, symbol("Message"), "0100")))[:8].hex() == "cc000000a002ce0f"


# -- faults ---------------------------------------------------------------------------------------------------

READ_VALVE = cip(READ, VALVE, "0100")
ANSWER = (
    "6f00 1a00 session 00000000 636f6e7465787473 00000000 00000000 0000 0200 0000 0000 b200 0a00 cc000000 c400 32000000"
)
FALSE_ANSWERS = {
    "a status": ({"status": 5}, ANSWER.replace("1a00", "1400").replace("0a00 cc000000 c400 32000000", "0400 cc000500")),
    "an extended status": (
        {"status": 0xFF, "extended": 0x2105},
        ANSWER.replace("1a00", "1600").replace("0a00 cc000000 c400 32000000", "0600 cc00ff01 0521"),
    ),
    "of the header": (
        {"encapsulation": 0x64},
        "6f00 0000 session 64000000 636f6e7465787473 00000000",
    ),
    "a context": ({"context": 1}, ANSWER.replace("636f", "626f")),
    "a service": ({"answer_service": 0x4D}, ANSWER.replace("cc00", "cd00")),
    "a type": ({"answer_type": 0xCA}, ANSWER.replace("c400", "ca00")),
    "other data": (
        {"answer_data": "0700"},
        ANSWER.replace("1a00", "1800").replace("0a00 cc", "0800 cc").replace("32000000", "0700"),
    ),
}


@pytest.mark.parametrize("name", FALSE_ANSWERS)
async def test_an_answer_is_falsified_and_the_journal_has_what_was_sent(
    device: MockProgram, raw: RawEip, name: str
) -> None:
    action, expected = FALSE_ANSWERS[name]
    await device.control.fault(action, service="read", tag="ValvePosition", times=1)
    raw.send(READ_VALVE)
    wanted = expected.replace("session", struct.pack("<I", raw.session).hex()).replace(" ", "")
    assert (await raw.frame()).hex() == wanted
    [asked] = await device.control.journal(kind="request")
    [answer] = await device.control.journal(kind="response")
    assert (asked["fault"], answer["answers"], answer["frame"]) == (action, asked["seq"], wanted)
    assert (await raw.unconnected(READ_VALVE))[2] == 0


async def test_an_answer_on_a_connection_has_another_count_or_connection(device: MockProgram, raw: RawEip) -> None:
    await raw.join()
    rules = [{"times": 1, "action": action} for action in ({"sequence": 1}, {"connection": 2}, {"length": 4})]
    await device.control.ask("fault", rules=rules)
    raw.send_connected(READ_VALVE)
    assert (await raw.frame())[44:46].hex() == "0200"
    raw.send_connected(READ_VALVE)
    assert (await raw.frame())[36:40].hex() == "57000000"
    raw.send_connected(READ_VALVE)
    assert int.from_bytes((await raw.reader.readexactly(24))[2:4], "little") == 32 + 4


async def test_a_rule_is_about_one_service_of_several(device: MockProgram, raw: RawEip) -> None:
    await device.control.fault({"status": 0x10}, tag="HeaterPower")
    answer = await raw.unconnected(
        multiple(cip(WRITE, VALVE, "c400 0100 07000000"), cip(WRITE, symbol("HeaterPower"), "c400 0100 07000000"))
    )
    assert answer.hex() == "8a001e00 0200 0600 0a00 cd000000 cd001000".replace(" ", "")
    held = await device.control.points()
    assert (held["ValvePosition"], held["HeaterPower"]) == (7, 30)


async def test_a_write_is_acknowledged_and_not_done(device: MockProgram, raw: RawEip) -> None:
    await device.control.fault({"ack_only": True})
    assert (await raw.unconnected(cip(WRITE, VALVE, "c400 0100 07000000"))).hex() == "cd000000"
    assert (await raw.unconnected(cip(MODIFY, symbol("Flags"), "0400 08000000 ffffffff"))).hex() == "ce000000"
    assert (await raw.unconnected(cip(4, CLOCK, "0100 0600" + "00" * 8)))[2] == 0
    held = await device.control.points()
    assert (held["ValvePosition"], held["Flags"], held["Clock"]) == (50, 0, None)


async def test_an_answer_is_dropped_delayed_cut_or_replaced(device: MockProgram, raw: RawEip) -> None:
    actions: list[dict[str, Any]] = [{"drop": True}, {"delay_s": 0.6}, {"truncate": 9}, {"garbage": True}]
    await device.control.ask("fault", rules=[{"times": 1, "action": action} for action in actions])
    for tag in ("FanSpeed", "HeaterPower", "FanSpeed", "FanSpeed", "ValvePosition"):
        raw.send(cip(READ, symbol(tag), "0100"))
    assert (await raw.reader.readexactly(9))[:4].hex() == "6f001a00"
    assert (await raw.frame())[:4].hex() == "dead0800"
    assert (await raw.message())[6] == 50
    assert (await raw.message())[6] == 30


@pytest.mark.parametrize("action", [{"close": True}, {"reset": True}])
async def test_the_connection_ends_instead_of_an_answer(
    device: MockProgram, raw: RawEip, action: dict[str, Any]
) -> None:
    await device.control.fault(action, times=1)
    raw.send(cip(WRITE, VALVE, "c400 0100 07000000"))
    assert await raw.ended()
    assert (await device.control.points())["ValvePosition"] == 7


async def test_connecting_is_spared_unless_it_is_named(device: MockProgram) -> None:
    await device.control.fault({"close": True})
    connection = RawEip()
    await connection.open(device)
    await connection.join()
    assert (await connection.unconnected(forward_close()))[2] == 0
    await device.control.fault({"status": 1, "extended": 0x0113}, service="forward_open")
    assert (await connection.unconnected(forward_open()))[2:6].hex() == "01011301"
    await connection.close()
    await device.control.fault({"encapsulation": 2}, service="register")
    await connection.dial(device)
    assert (await connection.ask(frame(0x65, b"\x01\0\0\0")))[8] == 2
    await connection.close()


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"tag": "Nobody", "value": 1}, "there is no tag 'Nobody'"),
        ({"tag": "Levels", "value": 1}, "there is no tag 'Levels'"),
        ({"tag": "ValvePosition", "value": 2**31}, "a DINT cannot hold 2147483648"),
        ({"tag": "ValvePosition", "value": 1.5}, "a DINT cannot hold 1.5"),
        ({"tag": "MotorSpeed", "value": "fast"}, "a REAL cannot hold 'fast'"),
        ({"tag": "MotorSpeed", "value": 1e39}, "a REAL cannot hold 1e"),
        ({"tag": "Message", "value": "x" * 83}, "ASCIISTRING82 cannot hold"),
        ({"tag": "Flags.32", "value": True}, "there is no bit 'Flags.32'"),
        ({"tag": "Flags.3", "value": 1}, "a bit cannot hold 1"),
        ({"tag": "Locked", "external_access": "some"}, "one of read_write, read_only, none"),
        ({"connection_limit": -1}, "from 0 to 1000"),
        ({"connections": "close"}, "expected 'forget'"),
        ({"restless": [{"tag": "Flags", "bits": 0}]}, "from 1 to 4294967295"),
        ({"restless": {}}, "a list of objects"),
    ],
)
async def test_a_poke_that_is_not_understood_is_refused(
    device: MockProgram, params: dict[str, Any], words: str
) -> None:
    with pytest.raises(RefusedError, match=words):
        await device.control.ask("poke", params=params)


async def test_a_tag_may_have_any_name(device: MockProgram) -> None:
    await device.control.ask("poke", params={"create": 'a"\x1b'})
    assert 'a"\x1b' in (await device.control.image())["symbols"].values()
    with pytest.raises(RefusedError, match="create: expected a string"):
        await device.control.ask("poke", params={"create": 5})


async def test_the_plant_moves_and_follows_its_orders(device: MockProgram) -> None:
    for tag, value in (("HeaterPower", 100), ("ConveyorSpeed", 30), ("Flags.3", True), ("FreeReal", "NaN")):
        await device.control.ask("poke", params={"tag": tag, "value": value})
    await device.control.ask("tick", steps=120)
    held = await device.control.points()
    assert held["Temperature"] > 90
    assert held["AlarmHigh"] is True
    assert 720 < held["MotorSpeed"] < 730
    assert (held["Flags"], held["FreeReal"]) == (8, "NaN")
