"""The S7 controller: its answers byte by byte, two clients of other authors, malformed input, faults."""

# Neither library declares its exports.
# mypy: disable-error-code="attr-defined, import-untyped"

from __future__ import annotations

import asyncio
import random
import struct
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from mock_program import MockProgram, RefusedError
from pyS7 import S7Client
from s7_tools import RawS7, areas, frame, item, job, user_data
from snap7.async_client import AsyncClient
from snap7.error import S7Error

pytestmark = pytest.mark.asyncio(loop_scope="module")
MOCK = "s7"

DB, FLAGS = 0x84, 0x83


@pytest_asyncio.fixture(loop_scope="module")
async def raw(device: MockProgram) -> AsyncIterator[RawS7]:
    connection = RawS7()
    assert await connection.open(device) == 480
    yield connection
    await connection.close()


# -- connecting -----------------------------------------------------------------------------------------------


async def test_another_slot_is_refused_and_journalled(device: MockProgram) -> None:
    connection = RawS7()
    # X.224 13.5: a disconnect request to our reference 9, reason 3, address unknown.
    assert (await connection.connect(device, tsap="0102")).hex() == "06800009000003"
    assert await connection.ended()
    await connection.close()
    [request] = await device.control.journal(kind="connect_request")
    assert (request["rack"], request["slot"], request["request"]) == (0, 2, False)
    assert await device.control.journal(kind="connect_refused")


async def test_the_smaller_pdu_is_agreed_to(device: MockProgram) -> None:
    for asked, allowed, agreed in ((480, 480, 480), (960, 480, 480), (480, 240, 240), (100, 480, 240)):
        await device.control.ask("poke", params={"pdu_size": allowed})
        connection = RawS7()
        assert await connection.open(device, pdu_size=asked) == agreed
        await connection.close()


@pytest.mark.parametrize(
    "sent",
    [
        frame(b"\x02\xf0\x80" + job(b"\x04\x01" + item(DB, 10, 0))),
        b"\x04\x00\x00\x10",
        b"\x03\x00\x00\x03",
        frame(bytes.fromhex("06e00000000900")),
        frame(bytes.fromhex("0ae000000009001002c2040101")),
        frame(bytes.fromhex("0ae00000000900c20401010101")),
    ],
)
async def test_what_is_no_beginning_of_a_session_ends_it(device: MockProgram, sent: bytes) -> None:
    connection = RawS7()
    await connection.dial(device)
    connection.writer.write(sent)
    assert await connection.ended()
    await connection.close()
    assert [entry["bytes"] for entry in await device.control.journal(kind="malformed")] == [sent.hex()]


# -- reading and writing --------------------------------------------------------------------------------------

READS = {
    "bytes": ([item(DB, 10, 0, count=4)], "ff040020 0032001e"),
    "integers": ([item(DB, 10, 0, transport=5, count=2)], "ff050020 0032001e"),
    "a real": ([item(DB, 10, 8, transport=8)], "ff070004 42c80000"),
    "characters": ([item(DB, 10, 22, transport=3, count=5)], "ff090005 7265616479"),
    "a bit": ([item(0x82, 0, 0, bit=0, transport=1)], "ff030001 01"),
    "several, padded to even lengths": (
        [item(0x82, 0, 0), item(DB, 99, 0), item(DB, 10, 1)],
        "ff040008 01 00 0a000000 ff040008 32",
    ),
    "a missing block": ([item(DB, 99, 0)], "0a000000"),
    "a missing area": ([item(0x99, 0, 0)], "0a000000"),
    "a protected block": ([item(DB, 9, 0)], "03000000"),
    "an optimized block": ([item(DB, 20, 0)], "05000000"),
    "past the end": ([item(DB, 10, 60, count=16)], "05000000"),
    "the last byte": ([item(DB, 10, 63)], "ff040008 00"),
    "no element": ([item(DB, 10, 0, count=0)], "05000000"),
    "two bits": ([item(DB, 10, 0, transport=1, count=2)], "05000000"),
    "a byte that begins inside of a byte": ([item(DB, 10, 0, bit=3)], "05000000"),
    "a counter": ([item(DB, 10, 0, transport=0x1C)], "06000000"),
    "more than a PDU holds": ([item(DB, 1, 0, count=256), item(DB, 1, 0, count=256)], "error 8500"),
    "too many": ([item(DB, 10, 0)] * 21, "error 8500"),
}


@pytest.mark.parametrize("name", READS)
async def test_a_read_is_answered(raw: RawS7, name: str) -> None:
    items, expected = READS[name]
    assert await raw.read(*items) == (expected if "error" in expected else expected.replace(" ", ""))


WRITES = {
    "an integer": (item(DB, 10, 0, transport=5), 5, 16, "0029", "ff"),
    "bytes": (item(DB, 10, 0, count=2), 4, 16, "0029", "ff"),
    "a real": (item(DB, 10, 8, transport=8), 7, 4, "3f800000", "ff"),
    "too few bytes": (item(DB, 10, 0, count=2), 4, 8, "29", "07"),
    "another transport size": (item(DB, 10, 0, transport=5), 4, 16, "0029", "07"),
    "a missing block": (item(DB, 99, 0), 4, 8, "00", "0a"),
    "a protected block": (item(DB, 9, 0), 4, 8, "00", "03"),
    "past the end": (item(DB, 10, 64), 4, 8, "00", "05"),
    "data that is cut off": (item(DB, 10, 0, count=2), 4, 16, "00", "error 8500"),
}


@pytest.mark.parametrize("name", WRITES)
async def test_a_write_changes_what_it_names_or_nothing(device: MockProgram, raw: RawS7, name: str) -> None:
    address, transport, length, content, expected = WRITES[name]
    before = await areas(device)
    assert await raw.write(address, transport, length, content) == expected
    after = await areas(device)
    if expected == "ff":
        start = int.from_bytes(address[9:]) // 8
        block = bytearray(before["DB10"])
        block[start : start + len(content) // 2] = bytes.fromhex(content)
        before["DB10"] = bytes(block)
    assert after == before


async def test_a_bit_is_written_alone(device: MockProgram, raw: RawS7) -> None:
    await device.control.ask("poke", params={"area": "M", "byte": 3, "data": "4a"})
    assert await raw.write(item(FLAGS, 0, 3, bit=5, transport=1), 3, 1, "01") == "ff"
    assert (await areas(device))["M"][3] == 0x6A
    assert await raw.write(item(FLAGS, 0, 3, bit=1, transport=1), 3, 1, "00") == "ff"
    assert (await areas(device))["M"][3] == 0x68
    write = (await device.control.journal(service="write"))[0]
    assert write["items"] == [{"area": FLAGS, "db": 0, "byte": 3, "bit": 5, "transport": 1, "count": 1, "data": "01"}]


async def test_reads_and_writes_can_be_switched_off(device: MockProgram, raw: RawS7) -> None:
    await device.control.ask("poke", params={"put_get": False})
    assert await raw.read(item(DB, 10, 0)) == "error 8104"
    assert await raw.write(item(DB, 10, 0), 4, 8, "07") == "error 8104"
    assert (await areas(device))["DB10"][0] == 0
    assert (await raw.ask(user_data(4, 1, bytes.fromhex("04240000"))))[-20:].hex().startswith("4302ff08")


async def test_restless_bits_turn_before_every_request(device: MockProgram, raw: RawS7) -> None:
    await device.control.ask("poke", params={"restless": [{"area": "M", "byte": 3, "bits": 64}]})
    assert [await raw.read(item(FLAGS, 0, 3)) for _ in range(3)] == ["ff04000840", "ff04000800", "ff04000840"]
    assert (await device.control.image())["restless"] == [{"area": "M", "byte": 3, "bits": 64, "changes": 3}]


# -- control and user data ------------------------------------------------------------------------------------

STOP = b"\x29\0\0\0\0\0\x09P_PROGRAM"
START = b"\x28\0\0\0\0\0\0\xfd\0\0\x09P_PROGRAM"


async def test_the_cpu_is_stopped_and_started_and_says_so(device: MockProgram, raw: RawS7) -> None:
    async def state() -> str:
        return (await raw.ask(user_data(4, 1, bytes.fromhex("04240000"))))[-20:].hex()[:8]

    assert await state() == "4302ff08"
    batch = (await areas(device))["DB1"][:20]
    assert RawS7.data(await raw.ask(job(STOP))) == ""
    assert await state() == "4303ff04"
    assert RawS7.data(await raw.ask(job(STOP))) == "error 8402"
    await device.control.ask("tick", steps=5)
    assert (await areas(device))["DB1"][:20] == batch
    assert RawS7.data(await raw.ask(job(START))) == ""
    await device.control.ask("tick", steps=5)
    assert (await areas(device))["DB1"][:20] != batch
    asked = await device.control.journal(kind="request", state_changing=True)
    assert [entry["service"] for entry in asked] == ["stop", "stop", "control"]
    assert RawS7.data(await raw.ask(job(b"\x28\0\0\0\0\0\0\xfd\0\0\x05_GARB"))) == "error 8104"


async def test_an_answer_that_is_too_long_for_the_pdu_comes_in_parts(device: MockProgram) -> None:
    await device.control.ask("poke", params={"pdu_size": 240})
    connection = RawS7()
    assert await connection.open(device) == 240
    first = await connection.ask(user_data(4, 1, bytes.fromhex("001c0000")))
    assert first[10:22].hex() == "000112081284010100010000"
    rest = await connection.ask(job(bytes.fromhex("000112081244010100000000"), bytes.fromhex("0a000000"), rosctr=7))
    assert rest[19] == 0
    records = first[26:] + rest[26:]
    assert records[:8].hex() == "001c000000220007"
    assert len(records) == 8 + 7 * 34
    await connection.close()


async def test_unknown_lists_functions_and_groups_are_refused(raw: RawS7) -> None:
    assert (await raw.ask(user_data(4, 1, bytes.fromhex("09990000"))))[20:22].hex() == "d401"
    assert (await raw.ask(user_data(3, 1, b"")))[20:22].hex() == "d401"
    assert RawS7.data(await raw.ask(job(b"\x1d\0\0\0"))) == "error 8104"
    assert RawS7.data(await raw.ask(job(b"\0\1\x12", rosctr=7))) == "error 8500"


# -- clients of other authors ---------------------------------------------------------------------------------


async def test_python_snap7_reads_writes_and_asks_for_everything(device: MockProgram) -> None:
    client = AsyncClient()
    await client.connect(device.host, 0, 1, device.port)
    assert struct.unpack(">4hfi", await client.db_read(10, 0, 16)) == (50, 30, 40, 60, 100.0, 7)
    await client.db_write_real(10, 8, 2.5)
    assert await client.db_read_real(10, 8) == 2.5
    assert await client.db_read_string(10, 20) == "ready"
    await asyncio.gather(*(client.db_read_int(10, offset) for offset in (0, 2, 4, 6) * 5))
    for block, start, size, words in ((99, 0, 1, "0x0a"), (10, 60, 16, "0x05"), (9, 0, 1, "0x03"), (20, 0, 1, "0x05")):
        with pytest.raises(S7Error, match=words):
            await client.db_read(block, start, size)
    assert (await client.get_cpu_info()).ModuleTypeName == b"CPU 315-2 PN/DP"
    assert (await client.get_order_code()).OrderCode == b"6ES7 315-2EH14-0AB0"
    assert (await client.get_plc_datetime()).year >= 2024
    await client.plc_stop()
    assert (await client.read_szl(0x424)).Data[7] == 4
    await client.plc_hot_start()
    assert (await device.control.image())["cpu"] == "RUN"
    await client.disconnect()
    assert (await device.control.wait(kind="disconnect_request"))[0]["request"] is False


async def test_python_snap7_has_no_cpu_state(device: MockProgram) -> None:
    """Its request is malformed and is refused; an adapter has to read the system status instead."""
    client = AsyncClient()
    await client.connect(device.host, 0, 1, device.port)
    with pytest.raises(S7Error, match="0x85"):
        await client.get_cpu_state()
    await client.disconnect()


async def test_pys7_reads_and_writes(device: MockProgram) -> None:
    def exchange() -> tuple[Any, Any, str]:
        with S7Client(device.host, 0, 1, port=device.port) as client:
            first = client.read(["DB1,R0", "DB10,I0", "M3.5", "DB2,S2.30", "Q0.0"])
            client.write(["DB10,I2", "M3.5", "DB10,R8", "DB10,B17"], [7, True, 2.5, 9])
            return first, client.read(["DB10,I2", "M3.5", "DB10,R8", "DB10,B17"]), client.get_cpu_status()

    assert await asyncio.to_thread(exchange) == ([900.0, 50, False, "no message", True], [7, True, 2.5, 9], "RUN")
    held = await areas(device)
    assert (held["DB10"][2:4].hex(), held["M"][3], held["DB10"][17]) == ("0007", 0x20, 9)


# -- malformed input ------------------------------------------------------------------------------------------


async def test_noise_never_stops_the_controller(device: MockProgram, raw: RawS7) -> None:
    chance = random.Random(20261122)
    for number in range(200):
        connection = RawS7()
        if number % 4 == 0:
            await connection.dial(device)
            connection.writer.write(chance.randbytes(chance.randrange(1, 600)))
        else:
            await connection.open(device)
            pdu = bytearray(job(b"\x05\x01" + item(DB, 10, 40, count=2), b"\0\4\0\x10\0\7"))
            if number % 4 == 1:
                pdu = bytearray(user_data(4, 1, bytes.fromhex("001c0000")))
            for _ in range(chance.randrange(1, 6)):
                pdu[chance.randrange(len(pdu))] = chance.randrange(256)
            connection.send(bytes(pdu[: chance.randrange(1, len(pdu) + 1)] if number % 4 == 3 else pdu))
        await connection.close()
    await device.control.wait(kind="DISCONNECTED", count=200)
    assert (await raw.read(item(DB, 10, 0, transport=5))).startswith("ff050010")


# -- faults ---------------------------------------------------------------------------------------------------

READ_VALVE = job(b"\x04\x01" + item(DB, 10, 0, transport=5))
ANSWER = "3203 0000 0007 0002 0006 0000 0401 ff050010 0032"
FALSE_ANSWERS = {
    "a reference": ({"reference": 1}, ANSWER.replace("0007", "0008", 1)),
    "exactly this reference": ({"answer_reference": 0}, ANSWER.replace("0007", "0000", 1)),
    "a function": ({"answer_function": 5}, ANSWER.replace("0401", "0501")),
    "a count": ({"answer_count": 2}, ANSWER.replace("0401", "0402")),
    "other data": ({"answer_data": "07"}, "3203 0000 0007 0002 0005 0000 0401 ff050008 07"),
    "a longer length": ({"data_length": 16}, ANSWER.replace("ff050010", "ff050020")),
    "an error": ({"error": 0x8104}, "3203 0000 0007 0000 0000 8104"),
    "a return code": ({"return_code": 1}, "3203 0000 0007 0002 0004 0000 0401 01000000"),
}


@pytest.mark.parametrize("name", FALSE_ANSWERS)
async def test_an_answer_is_falsified_and_the_journal_has_what_was_sent(
    device: MockProgram, raw: RawS7, name: str
) -> None:
    action, expected = FALSE_ANSWERS[name]
    await device.control.fault(action, service="read", db=10, byte=0, times=1)
    assert (await raw.ask(READ_VALVE)).hex() == expected.replace(" ", "")
    [asked] = await device.control.journal(kind="request")
    [answer] = await device.control.journal(kind="response")
    assert (asked["fault"], answer["answers"]) == (action, asked["seq"])
    assert answer["pdu"] == expected.replace(" ", "")
    assert (await raw.ask(READ_VALVE)).hex() == ANSWER.replace(" ", "")


async def test_a_write_is_acknowledged_and_not_done(device: MockProgram, raw: RawS7) -> None:
    await device.control.fault({"ack_only": True})
    assert await raw.write(item(DB, 10, 0), 4, 8, "07") == "ff"
    assert RawS7.data(await raw.ask(job(STOP))) == ""
    image = await device.control.image()
    assert (image["areas"]["DB10"][:2], image["cpu"]) == ("00", "RUN")


async def test_an_answer_is_dropped_delayed_cut_or_replaced(device: MockProgram, raw: RawS7) -> None:
    actions: list[dict[str, Any]] = [{"drop": True}, {"delay_s": 0.6}, {"truncate": 9}, {"garbage": True}]
    rules = [{"times": 1, "action": action} for action in actions]
    await device.control.ask("fault", rules=rules)
    for reference in range(1, 6):
        raw.send(job(b"\x04\x01" + item(DB, 10, 0, transport=5), reference=reference))
    whole = len(bytes.fromhex(ANSWER.replace(" ", ""))) + 7
    assert (await raw.take(9))[:4].hex() == f"0300{whole:04x}"
    assert await raw.take(8) == b"\xde\xad\xbe\xef\xff\xff\x00\x01"
    assert (await raw.pdu())[4:6].hex() == "0005"
    assert (await raw.pdu())[4:6].hex() == "0002"


@pytest.mark.parametrize("action", [{"close": True}, {"reset": True}])
async def test_the_connection_ends_instead_of_an_answer(
    device: MockProgram, raw: RawS7, action: dict[str, Any]
) -> None:
    await device.control.fault(action, times=1)
    raw.send(job(b"\x05\x01" + item(DB, 10, 1), b"\0\4\0\x08\x07"))
    assert await raw.ended()
    assert (await areas(device))["DB10"][1] == 7


async def test_the_agreement_on_a_pdu_is_spared_unless_it_is_named(device: MockProgram) -> None:
    await device.control.fault({"close": True})
    connection = RawS7()
    assert await connection.open(device) == 480
    await connection.close()
    await device.control.fault({"error": 0x8302}, service="setup")
    assert (await connection.connect(device))[1] == 0xD0
    assert RawS7.data(await connection.ask(job(struct.pack(">BBHHH", 0xF0, 0, 1, 1, 480)))) == "error 8302"
    await connection.close()


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"area": "DB20", "byte": 0, "data": "00"}, "unknown area 'DB20'"),
        ({"area": "DB10", "byte": 64, "data": "00"}, "it has 0..63"),
        ({"area": "DB10", "byte": 0, "data": "0"}, "hexadecimal"),
        ({"cpu": "HALT"}, "one of RUN, STOP"),
        ({"pdu_size": 100}, "from 240 to 960"),
        ({"put_get": 1}, "true or false"),
        ({"restless": [{"area": "M", "byte": 3, "bits": 0}]}, "from 1 to 255"),
        ({"restless": {}}, "a list of objects"),
    ],
)
async def test_a_poke_that_is_not_understood_is_refused(
    device: MockProgram, params: dict[str, Any], words: str
) -> None:
    with pytest.raises(RefusedError, match=words):
        await device.control.ask("poke", params=params)
