"""What the Modbus device does wrong when it is told to, seen by a raw socket and by pymodbus."""

from __future__ import annotations

import asyncio
import base64
import struct
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from mock_program import PATIENCE_S, MockProgram, RefusedError
from pymodbus.client import AsyncModbusTcpClient

pytestmark = pytest.mark.asyncio

READ_THREE = "03 0000 0003"
"""Answered with 50, 30 and 40 by unit 1."""


class Raw:
    """A connection that sends bytes as they are."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    def send(self, pdu: str, *, transaction: int = 7, unit: int = 1) -> None:
        body = bytes.fromhex(pdu)
        self.writer.write(struct.pack(">HHHB", transaction, 0, len(body) + 1, unit) + body)

    async def take(self, count: int) -> bytes:
        async with asyncio.timeout(PATIENCE_S):
            return await self.reader.readexactly(count)

    async def frame(self) -> tuple[int, int, str]:
        """Return transaction identifier, unit and PDU (hexadecimal digits) of the next answer."""
        transaction, protocol, length, unit = struct.unpack(">HHHB", await self.take(7))
        assert protocol == 0
        return transaction, unit, (await self.take(length - 1)).hex()

    async def ask(self, pdu: str, *, unit: int = 1) -> str:
        self.send(pdu, unit=unit)
        return (await self.frame())[2]

    async def silent(self) -> bool:
        """Tell whether nothing arrives, not even an end."""
        try:
            async with asyncio.timeout(0.3):
                await self.reader.read(1)
        except TimeoutError:
            return True
        return False


@pytest_asyncio.fixture
async def raw(modbus: MockProgram) -> AsyncIterator[Raw]:
    async with asyncio.timeout(PATIENCE_S):
        raw = Raw(*await asyncio.open_connection(modbus.host, modbus.port))
    yield raw
    raw.writer.close()


async def cells(modbus: MockProgram, table: str = "holding_registers", unit: int = 1) -> list[Any]:
    found: list[Any] = (await modbus.control.image())["units"][str(unit)][table]
    return found


# Action, request PDU, the bytes of the answer to transaction 7 of unit 1.
FALSE_ANSWERS = {
    "transaction identifier 0": ({"answer_transaction": 0}, "06 000a 0005", "0000 0000 0006 01 06 000a 0005"),
    "protocol identifier 1": ({"protocol_id": 1}, "06 000a 0005", "0007 0001 0006 01 06 000a 0005"),
    "length one too large": ({"length": 1}, "06 000a 0005", "0007 0000 0007 01 06 000a 0005"),
    "length two too small": ({"length": -2}, "06 000a 0005", "0007 0000 0004 01 06 000a 0005"),
    "byte count two too large": ({"byte_count": 2}, "03 0000 0001", "0007 0000 0005 01 03 04 0032"),
    "byte count 0": ({"byte_count": -2}, "03 0000 0001", "0007 0000 0005 01 03 00 0032"),
    "another function": ({"answer_function": 4}, "03 0000 0001", "0007 0000 0005 01 04 02 0032"),
    "another exception's function": (
        {"answer_function": 0x84, "exception": 2},
        "03 0000 0001",
        "0007 0000 0003 01 84 02",
    ),
    "another value of a register": ({"echo": {"value": 6}}, "06 000a 0005", "0007 0000 0006 01 06 000a 0006"),
    "another value of a coil": ({"echo": {"value": 0}}, "05 000a ff00", "0007 0000 0006 01 05 000a 0000"),
    "another address": ({"echo": {"address": 11}}, "06 000a 0005", "0007 0000 0006 01 06 000b 0005"),
    "another number": ({"echo": {"count": 1}}, "10 000a 0002 04 0001 0002", "0007 0000 0006 01 10 000a 0001"),
    "another address of many coils": ({"echo": {"address": 9}}, "0f 000a 0002 01 03", "0007 0000 0006 01 0f 0009 0002"),
    "another address of a mask": ({"echo": {"address": 9}}, "16 000a ffff 0000", "0007 0000 0008 01 16 0009 ffff 0000"),
    "an echo concerns writes only": ({"echo": {"address": 9}}, "03 0000 0001", "0007 0000 0005 01 03 02 0032"),
    "twice": ({"duplicate": True}, "03 0000 0001", "0007 0000 0005 01 03 02 0032" * 2),
    "byte by byte": ({"drip_s": 0.001}, "03 0000 0001", "0007 0000 0005 01 03 02 0032"),
    "twice, byte by byte": ({"drip_s": 0.001, "duplicate": True}, "03 0000 0001", "0007 0000 0005 01 03 02 0032" * 2),
}


@pytest.mark.parametrize("name", FALSE_ANSWERS)
async def test_an_answer_is_falsified_and_the_journal_has_what_was_sent(
    modbus: MockProgram, raw: Raw, name: str
) -> None:
    action, request, expected = FALSE_ANSWERS[name]
    await modbus.control.fault(action, times=1)
    raw.send(request)
    sent = bytes.fromhex(expected)
    assert await raw.take(len(sent)) == sent
    [asked] = await modbus.control.journal(kind="request")
    assert asked["fault"] == action
    answers = await modbus.control.journal(kind="response")
    one = sent[: len(sent) // len(answers)]
    for answer in answers:
        assert answer["answers"] == asked["seq"]
        header = (answer["transaction_id"], answer.get("protocol_id", 0), answer.get("length", len(one) - 6))
        assert header == struct.unpack_from(">HHH", one)
        assert answer["pdu"] == one[7:].hex()
    raw.send(READ_THREE)
    assert (await raw.frame())[2] == "03060032001e0028"
    assert "fault" not in (await modbus.control.journal(kind="request"))[-1]


async def test_an_answer_is_mangled_and_the_journal_has_the_bytes(modbus: MockProgram, raw: Raw) -> None:
    # Position 18 is byte 7 of the eleven: positions are counted round and round.
    await modbus.control.fault({"mangle": {"flip": [[1, 255], [18, 1]], "cut": 1, "append": "abcd"}}, times=1)
    raw.send("03 0000 0001")
    sent = bytes.fromhex("00f8 0000 0005 01 03 03 00 abcd")
    assert await raw.take(len(sent)) == sent
    assert [entry["bytes"] for entry in await modbus.control.journal(kind="mangled")] == [sent.hex()]
    assert await modbus.control.journal(kind="response") == []
    raw.send(READ_THREE)
    assert (await raw.frame())[2] == "03060032001e0028"
    await modbus.control.fault({"mangle": {"cut": 300, "end": True}})
    raw.send(READ_THREE)
    assert await raw.reader.read() == b""


async def test_a_rule_may_let_requests_pass_first(modbus: MockProgram, raw: Raw) -> None:
    rules = [
        {"function": 3, "skip": 2, "times": 1, "action": {"exception": 4}},
        {"action": {"exception": 6}, "skip": 3},
    ]
    await modbus.control.ask("fault", rules=rules)
    answers = [(await raw.ask("03 0000 0001"))[:2] + "/" for _ in range(6)]
    found = [entry["exception"] for entry in await modbus.control.journal(kind="response")]
    # The third request does not reach the second rule.
    assert found == [None, None, 4, None, 6, 6], answers


async def test_a_dripped_answer_takes_its_time_and_the_next_one_waits_behind_it(modbus: MockProgram, raw: Raw) -> None:
    await modbus.control.fault({"drip_s": 0.02}, times=1)
    raw.send("03 0000 0001", transaction=1)
    raw.send("03 0001 0001", transaction=2)
    loop = asyncio.get_running_loop()
    await raw.take(1)
    first = loop.time()
    await raw.take(10)
    assert loop.time() - first > 0.1
    assert await raw.frame() == (2, 1, "0302001e")
    assert [entry.get("drip_s") for entry in await modbus.control.journal(kind="response")] == [0.02, None]


async def test_pipelined_requests_are_answered_out_of_order(modbus: MockProgram, raw: Raw) -> None:
    await modbus.control.fault({"delay_s": 0.6}, address=0)
    raw.send("03 0000 0001", transaction=1)
    raw.send("03 0001 0001", transaction=2)
    assert await raw.frame() == (2, 1, "0302001e")
    assert await raw.frame() == (1, 1, "03020032")
    assert [entry["transaction_id"] for entry in await modbus.control.journal(kind="response")] == [2, 1]


async def test_a_late_answer_is_followed_by_normal_operation(modbus: MockProgram) -> None:
    await modbus.control.fault({"delay_s": 0.5}, times=1)
    client = AsyncModbusTcpClient(modbus.host, port=modbus.port, timeout=PATIENCE_S, retries=0)
    assert await client.connect()
    try:
        asked = asyncio.create_task(client.read_holding_registers(0, count=1))
        await modbus.control.wait(kind="request")
        # The client gives up, as after a time-out.
        asked.cancel()
        await asyncio.wait([asked])
        await modbus.control.wait(kind="response")
        client.close()
        assert await client.connect()
        assert (await client.read_holding_registers(1, count=1)).registers == [30]
    finally:
        client.close()


async def test_written_registers_are_clamped_and_the_echo_does_not_say_so(modbus: MockProgram, raw: Raw) -> None:
    await modbus.control.fault({"clamp": [10, 20]})
    assert await raw.ask("06 0028 0005") == "0600280005"
    assert await raw.ask("10 0029 0003 06 0005 000f ffff") == "1000290003"
    assert await raw.ask("16 002c 0000 00ff") == "16002c000000ff"
    assert (await cells(modbus))[40:46] == [10, 10, 15, 20, 20, 0]


async def test_a_half_open_connection_is_dead_and_others_are_served(modbus: MockProgram, raw: Raw) -> None:
    await modbus.control.fault({"half_open": True}, function=6)
    raw.send("06 000a 0005")
    # On a busy machine silence says nothing; what arrives together with this request would be part of it.
    await modbus.control.wait(kind="request", count=1)
    assert await raw.silent()
    raw.send(READ_THREE)
    await modbus.control.wait(kind="lost", count=1)
    [lost] = await modbus.control.journal(kind="lost")
    assert (lost["connection"], lost["count"]) == (1, 12)
    assert (await cells(modbus))[10] == 0
    other = Raw(*await asyncio.open_connection(modbus.host, modbus.port))
    assert await other.ask(READ_THREE) == "03060032001e0028"
    assert await modbus.control.ask("reset") == {"dead_connections": 1}
    other.writer.close()
    raw.writer.close()
    await modbus.control.wait(kind="DISCONNECTED", connection=1)
    assert await modbus.control.ask("reset") == {"dead_connections": 0}


async def test_a_black_hole_accepts_and_never_answers(modbus: MockProgram, raw: Raw) -> None:
    assert await raw.ask(READ_THREE)
    await modbus.control.poke(network="black_hole")
    raw.send("06 000a 0005")
    other = Raw(*await asyncio.open_connection(modbus.host, modbus.port))
    other.send("06 000b 0005")
    assert await raw.silent()
    assert await other.silent()
    assert [entry["connection"] for entry in await modbus.control.journal(kind="lost")] == [1, 2]
    await modbus.control.poke(network="open")
    # Connections that lost something stay dead; a new one is served.
    raw.send(READ_THREE)
    assert await raw.silent()
    fresh = Raw(*await asyncio.open_connection(modbus.host, modbus.port))
    assert await fresh.ask(READ_THREE) == "03060032001e0028"
    assert (await cells(modbus))[10:12] == [0, 0]
    changes = [(entry["condition"], entry["origin"]) for entry in await modbus.control.journal(kind="network")]
    assert changes == [("black_hole", "kit"), ("open", "kit")]
    for one in (other, fresh):
        one.writer.close()


async def test_a_stalled_network_goes_on_late(modbus: MockProgram, raw: Raw) -> None:
    await modbus.control.poke(network="stalled")
    raw.send("06 000a 0005")
    other = Raw(*await asyncio.open_connection(modbus.host, modbus.port))
    other.send(READ_THREE)
    assert await raw.silent()
    assert await modbus.control.journal(kind="request") == []
    await modbus.control.ask("reset")
    assert await raw.frame() == (7, 1, "06000a0005")
    assert await other.frame() == (7, 1, "03060032001e0028")
    assert (await cells(modbus))[10] == 5
    other.writer.close()


async def test_an_unknown_condition_of_the_network_is_refused(modbus: MockProgram) -> None:
    for params in ({"network": "slow"}, {"network": "open", "unit": 1}):
        with pytest.raises(RefusedError, match="with one of open, black_hole, stalled"):
            await modbus.control.poke(**params)


async def test_units_have_contents_of_their_own(modbus: MockProgram, raw: Raw) -> None:
    await modbus.control.poke(unit=1, table="holding_registers", address=10, values=[4711])
    await modbus.control.poke(units=[1, 2, 17, 247, 255])
    await modbus.control.poke(unit=247, table="coils", address=3, values=[True])
    found = {unit: await raw.ask("03 000a 0002", unit=unit) for unit in (1, 2, 17, 247, 255, 3)}
    assert found == {
        1: "030412670000",
        2: "030400d200d3",
        17: "030406ae06af",
        247: "030460866087",
        255: "030463a663a7",
        3: "830b",
    }
    bits = {unit: tuple((await cells(modbus, "coils", unit))[16:24]) for unit in (1, 2, 17, 247, 255)}
    assert len(set(bits.values())) == 5
    assert await raw.ask("01 0003 0001", unit=247) == "010101"
    await modbus.control.ask("reset")
    assert await raw.ask("03 000a 0001", unit=2) == "830b"


async def test_a_unit_may_have_cells_up_to_the_last_address(modbus: MockProgram, raw: Raw) -> None:
    assert await raw.ask("03 fffe 0002") == "8302"
    await modbus.control.poke(unit=1, cells=0x10000)
    await modbus.control.poke(unit=1, table="holding_registers", address=0xFFFF, values=[4711])
    assert await raw.ask("03 fffe 0002") == "030400001267"
    assert await raw.ask("03 ffff 0002") == "8302"
    assert await raw.ask("06 fffe 0007") == "06fffe0007"
    assert (await raw.ask("01 0064 07d0")).startswith("01fa")
    await modbus.control.ask("reset")
    assert await raw.ask("03 0064 0001") == "8302"


async def test_pokes_that_are_not_understood_are_refused_in_a_sentence(modbus: MockProgram) -> None:
    for params, sentence in (
        ({"units": []}, "units: expected a list of integers from 0 to 255"),
        ({"units": [256]}, "units: expected a list of integers from 0 to 255"),
        ({"cells": 99}, "cells: expected an integer from 100 to 65536, found 99"),
        ({"identification": {"256": ""}}, "expected object ids from 0 to 255"),
        ({"identification": {"0": "?"}}, "object 0 is no base64"),
        ({"identification": {"0": base64.b64encode(b"x" * 245).decode()}}, "245 bytes, and 244 fit"),
        ({"identification": {}, "unit": 2}, "unit 2 is not configured"),
        ({"restless": [{"address": 100}]}, "there is no cell holding_registers 100"),
        ({"restless": [{"address": 1, "table": "coils"}]}, "coils cannot change by 'increment'"),
        ({"restless": [{"address": 1, "speed": 3}]}, "unknown members ['speed']"),
        ({"restless": [{}]}, "lacks 'address'"),
    ):
        with pytest.raises(RefusedError) as refused:
            await modbus.control.poke(**params)
        assert sentence in str(refused.value)
    for action, sentence in (
        ({"echo": {"values": 1}}, "expected an object with value, address, count"),
        ({"clamp": [2, 1]}, "the lower one first"),
        ({"drip_s": -1}, "expected a number from 0 to 60"),
        ({"half_open": 1}, "expected true or false"),
        ({"mangle": {"flip": [[1, 256]]}}, "a list of pairs of position and byte"),
        ({"mangle": {"append": "0"}}, "hexadecimal"),
        ({"mangle": {"drop": True}}, "expected an object with flip"),
    ):
        with pytest.raises(RefusedError) as refused:
            await modbus.control.fault(action)
        assert sentence in str(refused.value)


async def test_the_identification_holds_any_bytes(modbus: MockProgram, raw: Raw) -> None:
    vendor, private = b"Ol\xff\x00\x1b[31m", "\u202eegalp".encode()
    objects = {"0": base64.b64encode(vendor).decode(), "128": base64.b64encode(private).decode(), "2": None}
    await modbus.control.poke(identification=objects)
    assert await raw.ask("2b 0e 04 00") == "2b0e0482000001" + bytes([0, len(vendor)]).hex() + vendor.hex()
    assert await raw.ask("2b 0e 04 80") == "2b0e0482000001" + bytes([128, len(private)]).hex() + private.hex()
    assert await raw.ask("2b 0e 04 02") == "ab02"


async def test_a_restless_register_counts_the_requests_of_its_unit(modbus: MockProgram, raw: Raw) -> None:
    await modbus.control.poke(units=[1, 2])
    await modbus.control.poke(
        restless=[{"address": 20}, {"address": 3, "table": "discrete_inputs", "change": "toggle"}]
    )
    assert [await raw.ask("03 0014 0001") for _ in range(2)] == ["03020001", "03020002"]
    await raw.ask("03 0000 0001", unit=2)
    assert [await raw.ask("02 0003 0001") for _ in range(2)] == ["020101", "020100"]
    assert (await modbus.control.image())["restless"][0]["changes"] == 4
    await modbus.control.poke(restless=[])
    assert await raw.ask("03 0014 0001") == "03020004"
    assert "restless" not in await modbus.control.image()


async def test_other_bits_change_between_the_read_and_the_write_of_a_mask(modbus: MockProgram) -> None:
    await modbus.control.poke(restless=[{"address": 20, "change": "toggle", "bits": 0xFF00}])
    client = AsyncModbusTcpClient(modbus.host, port=modbus.port, timeout=PATIENCE_S, retries=0)
    assert await client.connect()
    try:
        held = (await client.read_holding_registers(20, count=1)).registers[0]
        await client.write_register(20, held | 1)
        stale = (await cells(modbus))[20]
        # Two requests turned the upper bits twice; the write has put back those of the read.
        assert (held, stale) == (0xFF00, 0xFF01)
        await client.mask_write_register(address=20, and_mask=0xFFFE, or_mask=0)
        assert (await cells(modbus))[20] == 0x0000
    finally:
        client.close()
