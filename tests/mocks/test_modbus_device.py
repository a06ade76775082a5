"""The Modbus device against two independent clients, byte vectors, and bytes that mean nothing."""

from __future__ import annotations

import asyncio
import contextlib
import random
import struct
from typing import Any

import pytest
from mock_program import PATIENCE_S, MockProgram
from pymodbus.client import AsyncModbusTcpClient
from pyModbusTCP.client import ModbusClient
from pytest_otmcp.mocks.modbus.image import UnitImage
from pytest_otmcp.mocks.modbus.pdu import IllegalRequest, identify

pytestmark = pytest.mark.asyncio


class Raw:
    """A connection that sends bytes as they are."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer
        self._transaction = 0

    @classmethod
    async def connect(cls, modbus: MockProgram) -> Raw:
        return cls(*await asyncio.open_connection(modbus.host, modbus.port))

    async def frame(self) -> tuple[int, int, bytes]:
        """Return transaction identifier, unit and PDU of the next answer."""
        async with asyncio.timeout(PATIENCE_S):
            transaction, protocol, length, unit = struct.unpack(">HHHB", await self.reader.readexactly(7))
            assert protocol == 0
            return transaction, unit, await self.reader.readexactly(length - 1)

    async def ask(self, pdu: str, unit: int = 1) -> str:
        """Return the response PDU to a request PDU, both in hexadecimal digits."""
        self._transaction = (self._transaction + 1) & 0xFFFF
        self.writer.write(adu(self._transaction, pdu, unit))
        transaction, answering, response = await self.frame()
        assert (transaction, answering) == (self._transaction, unit)
        return response.hex()

    async def ended(self) -> bytes:
        """Return everything that arrives until the device closes the connection."""
        async with asyncio.timeout(PATIENCE_S):
            return await self.reader.read()


def adu(transaction: int, pdu: str, unit: int = 1) -> bytes:
    body = bytes.fromhex(pdu)
    return struct.pack(">HHHB", transaction, 0, len(body) + 1, unit) + body


async def cells(modbus: MockProgram, table: str) -> list[Any]:
    found: list[Any] = (await modbus.control.image())["units"]["1"][table]
    return found


async def poke(modbus: MockProgram, table: str, address: int, *values: Any) -> None:
    await modbus.control.ask("poke", params={"unit": 1, "table": table, "address": address, "values": list(values)})


# Request PDU, response PDU. The examples of the specification have other addresses than this device.
VECTORS = {
    "read coils": ("01 0000 000a", "01 02 0100"),
    "read all coils": ("01 0000 0064", "01 0d 01" + "00" * 12),
    "read discrete inputs": ("02 0000 0002", "02 01 02"),
    "read holding registers": ("03 0000 0003", "03 06 0032 001e 0028"),
    "read the last holding register": ("03 0063 0001", "03 02 0000"),
    "read input registers": ("04 0000 0004", "04 08 00fa 0096 003c 01f4"),
    "write coil on": ("05 000a ff00", "05 000a ff00"),
    "write coil off": ("05 000a 0000", "05 000a 0000"),
    "write register": ("06 000a ffff", "06 000a ffff"),
    "write coils": ("0f 000a 000a 02 cd01", "0f 000a 000a"),
    "write registers": ("10 000a 0002 04 000a 0102", "10 000a 0002"),
    "mask write": ("16 000a 00f2 0025", "16 000a 00f2 0025"),
    "read/write reads what it wrote": ("17 000a 0002 000b 0001 02 abcd", "17 04 0000 abcd"),
    "unknown function 07": ("07", "87 01"),
    "unknown function 08": ("08 0000 a537", "88 01"),
    "unknown function 55": ("55", "d5 01"),
    "unknown function 2b with another MEI type": ("2b 0d 00 00", "ab 01"),
    "no function can be above 7f": ("83 0000 0001", "83 01"),
    "coil 100 of 100": ("01 0064 0001", "81 02"),
    "across the end of the coils": ("01 0063 0002", "81 02"),
    "discrete input 65535": ("02 ffff 0001", "82 02"),
    "holding register 9999": ("03 270f 0001", "83 02"),
    "across the end of the address space": ("03 ffff 0002", "83 02"),
    "input register 100": ("04 0064 0001", "84 02"),
    "write coil 100": ("05 0064 ff00", "85 02"),
    "write register 100": ("06 0064 0001", "86 02"),
    "write coils across the end": ("0f 0060 0008 01 ff", "8f 02"),
    "write registers across the end": ("10 0063 0002 04 0001 0002", "90 02"),
    "mask write 100": ("16 0064 ffff 0000", "96 02"),
    "read/write reads too far": ("17 0063 0002 0000 0001 02 0001", "97 02"),
    "read/write writes too far": ("17 0000 0001 0063 0002 04 0001 0002", "97 02"),
    "0 coils": ("01 0000 0000", "81 03"),
    "2001 coils": ("01 0000 07d1", "81 03"),
    "2000 coils are too many for this device only": ("01 0000 07d0", "81 02"),
    "0 registers": ("03 0000 0000", "83 03"),
    "126 registers": ("03 0000 007e", "83 03"),
    "125 registers are too many for this device only": ("04 0000 007d", "84 02"),
    "coil value 1234": ("05 0000 1234", "85 03"),
    "coil value 0001": ("05 0000 0001", "85 03"),
    "coil value ff01": ("05 0000 ff01", "85 03"),
    "write 0 coils": ("0f 0000 0000 00", "8f 03"),
    "write 1969 coils": ("0f 0000 07b1 f7" + "00" * 247, "8f 03"),
    "write coils with a wrong byte count": ("0f 0000 0009 01 ff", "8f 03"),
    "write coils with bytes missing": ("0f 0000 0010 02 ff", "8f 03"),
    "write 0 registers": ("10 0000 0000 00", "90 03"),
    "write 124 registers": ("10 0000 007c f8" + "00" * 246, "90 03"),
    "write 123 registers are too many for this device only": ("10 0000 007b f6" + "00" * 246, "90 02"),
    "write registers with a wrong byte count": ("10 0000 0002 03 0001 00", "90 03"),
    "write registers with a byte too many": ("10 0000 0001 02 0001 00", "90 03"),
    "read/write of 126": ("17 0000 007e 0000 0001 02 0001", "97 03"),
    "read/write with 122 to write, which fit into no PDU": ("17 0000 0001 0000 007a f4" + "00" * 243, "97 03"),
    "read/write with a wrong byte count": ("17 0000 0001 0000 0001 04 0001", "97 03"),
    "the value is checked before the address": ("03 270f 0000", "83 03"),
    "the coil value is checked before the address": ("05 270f 0001", "85 03"),
    "the byte count is checked before the address": ("10 270f 0001 04 0001", "90 03"),
    "a request cut short": ("03 0000", "83 03"),
    "a request with a byte too many": ("03 0000 0001 00", "83 03"),
    "a function alone": ("06", "86 03"),
    "a mask write cut short": ("16 0000 ffff", "96 03"),
    "a read/write cut short": ("17 0000 0001 0000", "97 03"),
    "identification with an unknown code": ("2b 0e 05 00", "ab 03"),
    "identification with code 0": ("2b 0e 00 00", "ab 03"),
    "identification cut short": ("2b 0e 01", "ab 03"),
    "identification of an unknown object": ("2b 0e 04 07", "ab 02"),
    "identification of one object": ("2b 0e 04 02", "2b 0e 04 82 00 00 01 02 03 312e30"),
}


async def test_every_request_gets_exactly_the_answer_of_the_specification(modbus: MockProgram) -> None:
    before = await modbus.control.image()
    connection = await Raw.connect(modbus)
    wrong = {}
    for name, (request, expected) in VECTORS.items():
        await modbus.control.ask("reset")
        answer = await connection.ask(request)
        if answer != bytes.fromhex(expected).hex():
            wrong[name] = answer
        elif bytes.fromhex(answer)[0] & 0x80:
            assert await modbus.control.image() == before, f"{name}: refused, and something changed"
    assert wrong == {}
    connection.writer.close()


async def test_writes_change_what_they_name_and_nothing_else(modbus: MockProgram) -> None:
    expected = (await modbus.control.image())["units"]["1"]
    connection = await Raw.connect(modbus)

    async def check(pdu: str, table: str, address: int, *values: Any) -> None:
        await connection.ask(pdu)
        expected[table][address : address + len(values)] = values
        assert (await modbus.control.image())["units"]["1"] == expected

    await check("05 0063 ff00", "coils", 99, True)
    await check("06 0063 1234", "holding_registers", 99, 0x1234)
    # The example of section 6.11: CD 01 are the bits 1100 1101 0000 0001, least significant first.
    bits = [True, False, True, True, False, False, True, True, True, False]
    await check("0f 0013 000a 02 cd01", "coils", 19, *bits)
    # Bits beyond the quantity are padding.
    await check("0f 0030 0003 01 ff", "coils", 48, True, True, True)
    await check("10 0001 0002 04 000a 0102", "holding_registers", 1, 0x000A, 0x0102)
    # The example of section 6.16: 12 masked with F2 and 25 gives 17.
    await check("06 0004 0012", "holding_registers", 4, 0x12)
    await check("16 0004 00f2 0025", "holding_registers", 4, 0x17)
    await check("17 0003 0006 000e 0003 06 00ff 00ff 00ff", "holding_registers", 14, 0xFF, 0xFF, 0xFF)
    connection.writer.close()


@pytest.mark.parametrize("unit", [0, 2, 247, 255])
async def test_a_unit_that_is_not_configured_is_refused_by_the_gateway(modbus: MockProgram, unit: int) -> None:
    before = await modbus.control.image()
    connection = await Raw.connect(modbus)
    assert await connection.ask("06 0000 0001", unit) == "860b"
    assert await modbus.control.image() == before
    [request] = await modbus.control.journal(kind="request")
    assert (request["unit"], request["state_changing"]) == (unit, True)
    connection.writer.close()


# -- streams ------------------------------------------------------------------------------------------------


async def test_requests_in_one_segment_are_all_answered_in_order(modbus: MockProgram) -> None:
    await poke(modbus, "holding_registers", 20, *range(500, 550))
    connection = await Raw.connect(modbus)
    connection.writer.write(b"".join(adu(0x100 + i, f"03 {20 + i:04x} 0001") for i in range(50)))
    for i in range(50):
        assert await connection.frame() == (0x100 + i, 1, struct.pack(">BBH", 3, 2, 500 + i))
    connection.writer.close()


async def test_a_request_may_arrive_byte_by_byte(modbus: MockProgram) -> None:
    connection = await Raw.connect(modbus)
    for transaction in (1, 2):
        for byte in adu(transaction, "10 000a 0002 04 000a 0102"):
            connection.writer.write(bytes([byte]))
            await modbus.control.ask("ready")  # the device has had its turn: the bytes do not travel together
        assert await connection.frame() == (transaction, 1, bytes.fromhex("10 000a 0002"))
    connection.writer.close()


async def test_a_request_and_a_half_leave_the_half_waiting(modbus: MockProgram) -> None:
    connection = await Raw.connect(modbus)
    both = adu(1, "03 0000 0001") + adu(2, "03 0001 0001")
    connection.writer.write(both[:17])
    assert (await connection.frame())[0] == 1
    assert len(await modbus.control.journal(kind="request")) == 1
    connection.writer.write(both[17:])
    assert (await connection.frame())[0] == 2
    connection.writer.close()


@pytest.mark.parametrize(
    "header",
    [
        "0001 0001 0006 01",
        "0001 dead 0006 01",
        "0001 0000 0000 01",
        "0001 0000 0001 01",
        "0001 0000 00ff 01",
        "0001 0000 ffff",
    ],
)
async def test_a_header_that_is_none_drops_the_connection(modbus: MockProgram, header: str) -> None:
    good, bad = await Raw.connect(modbus), await Raw.connect(modbus)
    bad.writer.write(adu(7, "03 0000 0001") + bytes.fromhex(header) + bytes.fromhex("06 0000 0001"))
    try:
        answered = await bad.ended()
        assert answered in (b"", bytes.fromhex("0007 0000 0005 01 03 02 0032"))
    except ConnectionResetError:
        pass
    [entry] = await modbus.control.journal(kind="malformed")
    assert entry["bytes"].startswith(header.replace(" ", ""))
    assert ("protocol identifier" if header[5:9] != "0000" else "MBAP length") in entry["reason"]
    assert [request["transaction_id"] for request in await modbus.control.journal(kind="request")] == [7]
    assert await good.ask("03 0000 0001") == "03020032"
    for connection in (good, bad):
        connection.writer.close()


async def test_a_connection_that_ends_inside_a_frame_is_told_as_such(modbus: MockProgram) -> None:
    connection = await Raw.connect(modbus)
    connection.writer.write(adu(1, "06 0000 0001")[:9])
    connection.writer.close()
    [entry] = await modbus.control.wait(kind="malformed")
    assert entry["bytes"] == adu(1, "06 0000 0001")[:9].hex()
    assert await modbus.control.journal(kind="request") == []


@pytest.mark.long
async def test_a_client_that_never_reads_is_no_longer_listened_to(modbus: MockProgram) -> None:
    deaf, good = await Raw.connect(modbus), await Raw.connect(modbus)
    reading = adu(1, "03 0000 0064") * 1000
    for _ in range(200):
        deaf.writer.write(reading)
    stuck = asyncio.create_task(deaf.writer.drain())
    # Every request and every answer is an entry; the good client itself adds about four in each round.
    before, seen = -100, await modbus.control.next()
    while seen - before > 10:
        assert await good.ask("03 0000 0001") == "03020032"
        before, seen = seen, await modbus.control.next()
    assert seen < 2 * 200_000
    stuck.cancel()
    deaf.writer.transport.abort()
    good.writer.close()


async def test_bytes_that_mean_nothing_never_kill_the_device(modbus: MockProgram) -> None:
    chance = random.Random(20240601)
    good = await Raw.connect(modbus)
    for round_ in range(300):
        connection = await Raw.connect(modbus)
        pdu = chance.randbytes(chance.randrange(1, 254))
        if round_ % 3 == 0:
            noise = chance.randbytes(chance.randrange(1, 600))
        elif round_ % 3 == 1:
            noise = struct.pack(">HHHB", round_, 0, len(pdu) + 1, chance.choice([0, 1, 1, 255])) + pdu
        else:
            pdu = bytes([chance.choice([1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43])]) + pdu[1:]
            noise = struct.pack(">HHHB", round_, 0, len(pdu) + 1, 1) + pdu
        connection.writer.write(noise)
        connection.writer.write_eof()
        with contextlib.suppress(ConnectionResetError):
            await connection.ended()
        connection.writer.close()
        if round_ % 50 == 0:
            assert (await good.ask("03 0063 0001")).startswith("0302")
    image = (await modbus.control.image())["units"]["1"]
    assert {name: len(table) for name, table in image.items()} == dict.fromkeys(image, 100)
    assert all(type(value) is int and 0 <= value <= 0xFFFF for value in image["holding_registers"])
    assert all(type(value) is bool for value in image["coils"])
    good.writer.close()


# -- independent clients --------------------------------------------------------------------------------------


async def test_pymodbus_gets_on_with_the_device(modbus: MockProgram) -> None:
    client = AsyncModbusTcpClient(modbus.host, port=modbus.port, retries=0, timeout=PATIENCE_S, reconnect_delay=0)
    assert await client.connect()
    assert (await client.read_input_registers(0, count=4)).registers == [250, 150, 60, 500]
    assert (await client.read_coils(0, count=2)).bits[:2] == [True, False]
    assert (await client.read_discrete_inputs(0, count=2)).bits[:2] == [False, True]
    assert not (await client.write_register(1, 41)).isError()
    assert not (await client.write_registers(20, [1, 2, 3])).isError()
    assert not (await client.write_coil(5, True)).isError()
    assert not (await client.write_coils(6, [True, False, True])).isError()
    assert not (await client.mask_write_register(address=20, and_mask=0xF0, or_mask=0x05)).isError()
    both = await client.readwrite_registers(read_address=20, read_count=3, write_address=22, values=[77])
    assert both.registers == [5, 2, 77]
    assert (await client.read_holding_registers(1, count=1)).registers == [41]
    assert (await client.read_holding_registers(9999, count=1)).exception_code == 2
    assert (await client.read_holding_registers(0, count=1, device_id=9)).exception_code == 0x0B
    parallel = await asyncio.gather(*(client.read_holding_registers(i, count=1) for i in range(20, 24)))
    assert [answer.registers for answer in parallel] == [[5], [2], [77], [0]]
    client.close()
    assert (await cells(modbus, "coils"))[5:9] == [True, True, False, True]


async def test_pymodbus_reads_the_identification_as_a_stream(modbus: MockProgram) -> None:
    client = AsyncModbusTcpClient(modbus.host, port=modbus.port, retries=0, timeout=PATIENCE_S, reconnect_delay=0)
    assert await client.connect()
    for code, objects in ((1, 3), (2, 7), (3, 7)):
        answer = await client.read_device_information(read_code=code, object_id=0)
        assert not answer.isError()
        assert sorted(answer.information) == list(range(objects))
        assert (answer.conformity, answer.more_follows) == (0x82, 0)
    assert answer.information[0] == b"pytest-otmcp"
    client.close()


async def test_pymodbustcp_gets_on_with_the_device(modbus: MockProgram) -> None:
    client = ModbusClient(host=modbus.host, port=modbus.port, unit_id=1, timeout=PATIENCE_S)

    def talk() -> None:
        assert client.read_input_registers(0, 4) == [250, 150, 60, 500]
        assert client.write_multiple_registers(30, [1, 65535])
        assert client.read_holding_registers(29, 4) == [0, 1, 65535, 0]
        assert client.write_single_register(29, 9)
        assert client.write_single_coil(40, True)
        assert client.write_multiple_coils(41, [True] * 9)
        assert client.read_coils(39, 12) == [False] + [True] * 10 + [False]
        assert client.read_discrete_inputs(0, 2) == [False, True]
        assert client.write_read_multiple_registers(30, [8], 29, 2) == [9, 8]
        assert client.read_device_identification(0x04, 0).objects_by_id == {0: b"pytest-otmcp"}
        assert client.read_holding_registers(100, 1) is None
        assert client.last_except == 2

    await asyncio.to_thread(talk)
    client.close()


# -- identification -------------------------------------------------------------------------------------------

LONG = {0: b"v" * 200, 1: b"p" * 40, 2: b"r" * 10, 3: b"u" * 244, 6: b"a"}


def listed(response: bytes) -> tuple[int, int, list[int]]:
    """Return "more follows", the next object and the object ids of a response; check its lengths."""
    assert len(response) <= 253
    more, following, count = response[4], response[5], response[6]
    identifiers, rest = [], response[7:]
    while rest:
        identifiers.append(rest[0])
        assert rest[2 : 2 + rest[1]] == LONG[rest[0]]
        rest = rest[2 + rest[1] :]
    assert count == len(identifiers)
    return more, following, identifiers


async def test_an_identification_too_long_for_one_answer_is_continued() -> None:
    def ask(code: int, first: int) -> tuple[int, int, list[int]]:
        return listed(identify(LONG, bytes([0x0E, code, first])))

    assert ask(1, 0) == (0xFF, 2, [0, 1])
    assert ask(1, 2) == (0, 0, [2])
    assert ask(2, 0) == (0xFF, 2, [0, 1])
    assert ask(2, 2) == (0xFF, 3, [2])
    # 244 bytes are the longest an object can have in a PDU of 253.
    assert ask(2, 3) == (0xFF, 6, [3])
    assert ask(2, 6) == (0, 0, [6])
    # A category beyond the device's gets what the device has; an object that it does not know restarts the stream.
    assert ask(3, 2) == ask(2, 2)
    assert ask(2, 5) == ask(2, 0x80) == ask(2, 0)
    assert ask(1, 6) == ask(1, 0)
    assert ask(4, 3) == (0, 0, [3])
    with pytest.raises(IllegalRequest):
        ask(4, 4)


# -- witness --------------------------------------------------------------------------------------------------


async def test_the_journal_holds_requests_and_answers_decoded(modbus: MockProgram) -> None:
    connection = await Raw.connect(modbus)
    for pdu in (
        "04 0000 0002",
        "01 0000 0003",
        "06 0001 0029",
        "05 0002 ff00",
        "05 0002 1234",
        "0f 0003 0003 01 05",
        "10 0004 0002 04 0001 0002",
        "16 0001 00ff 0100",
        "17 0001 0001 0002 0001 02 0007",
        "03 270f 0001",
        "2b 0e 01 00",
        "55 01 02 03 04",
    ):
        await connection.ask(pdu)
    entries = await modbus.control.journal()
    requests = [entry for entry in entries if entry["kind"] == "request"]
    responses = [entry for entry in entries if entry["kind"] == "response"]
    keys = ("function", "address", "quantity", "values", "state_changing")
    assert [tuple(entry.get(key) for key in keys) for entry in requests] == [
        (4, 0, 2, None, False),
        (1, 0, 3, None, False),
        (6, 1, 1, [41], True),
        (5, 2, 1, [True], True),
        (5, 2, 1, [0x1234], True),
        (15, 3, 3, [True, False, True], True),
        (16, 4, 2, [1, 2], True),
        (22, 1, 1, None, True),
        (23, 2, 1, [7], True),
        (3, 9999, 1, None, False),
        (43, None, None, None, False),
        (0x55, None, None, None, False),
    ]
    assert (requests[7]["and_mask"], requests[7]["or_mask"]) == (0x00FF, 0x0100)
    assert (requests[8]["read_address"], requests[8]["read_quantity"]) == (1, 1)
    assert [(entry["function"], entry["exception"], entry.get("values")) for entry in responses] == [
        (4, None, [250, 150]),
        (1, None, [True, False, False]),
        (6, None, None),
        (5, None, None),
        (5, 3, None),
        (15, None, None),
        (16, None, None),
        (22, None, None),
        (23, None, [0x0129]),
        (3, 2, None),
        (43, None, None),
        (0x55, 1, None),
    ]
    assert requests[2]["pdu"] == "0600010029"
    assert responses[9]["pdu"] == "8302"
    assert [entry["transaction_id"] for entry in requests] == [entry["transaction_id"] for entry in responses]
    assert {(entry["connection"], entry["unit"]) for entry in requests + responses} == {(1, 1)}
    connection.writer.close()


# -- faults ---------------------------------------------------------------------------------------------------


async def plan(modbus: MockProgram, **action: Any) -> None:
    await modbus.control.ask("fault", rules=[{"times": 1, "action": action}])


async def test_each_fault_is_seen_on_the_wire_once_and_then_no_more(modbus: MockProgram) -> None:
    connection = await Raw.connect(modbus)
    read, answer = "03 0000 0001", "03020032"

    async def sent() -> tuple[int, int, str]:
        connection.writer.write(adu(0x10, read))
        transaction, unit, pdu = await connection.frame()
        return transaction, unit, pdu.hex()

    good = (0x10, 1, answer)
    for action, expected in (
        ({"exception": 6}, (0x10, 1, "8306")),
        ({"transaction_id": 1}, (0x11, 1, answer)),
        ({"answer_unit": 9}, (0x10, 9, answer)),
        ({"answer_values": [0xABCD]}, (0x10, 1, "0302abcd")),
        ({"answer_values": [1, 2, 3]}, (0x10, 1, "0306000100020003")),
        ({"delay_s": 0.01}, good),
        ({"delay_s": 0.01, "exception": 5}, (0x10, 1, "8305")),
    ):
        await plan(modbus, **action)
        assert await sent() == expected, action
        assert await sent() == good, action

    await plan(modbus, garbage=True)
    connection.writer.write(adu(1, read))
    assert await connection.reader.readexactly(8) == bytes.fromhex("deadbeefffff0001")
    await plan(modbus, truncate=5)
    connection.writer.write(adu(1, read))
    assert await connection.reader.readexactly(5) == adu(1, answer)[:5]
    await plan(modbus, drop=True)
    connection.writer.write(adu(1, "06 0032 0007"))
    assert await sent() == good  # nothing came before it
    assert (await cells(modbus, "holding_registers"))[50] == 7
    assert await modbus.control.ask("fault", rules=[]) == {"hits": [1]}
    connection.writer.close()


async def test_a_delayed_answer_does_not_hold_up_the_next(modbus: MockProgram) -> None:
    connection = await Raw.connect(modbus)
    await modbus.control.ask("fault", rules=[{"address": 0, "action": {"delay_s": 0.05}}])
    connection.writer.write(adu(1, "03 0000 0001") + adu(2, "03 0001 0001"))
    assert [(await connection.frame())[0] for _ in range(2)] == [2, 1]
    connection.writer.close()


async def test_close_ends_a_connection_and_reset_breaks_it(modbus: MockProgram) -> None:
    closed, broken = await Raw.connect(modbus), await Raw.connect(modbus)
    await plan(modbus, close=True)
    closed.writer.write(adu(1, "06 0032 0007"))
    assert await closed.ended() == b""
    await plan(modbus, reset=True)
    broken.writer.write(adu(1, "06 0033 0008"))
    with pytest.raises(ConnectionResetError):
        await broken.ended()
    assert (await cells(modbus, "holding_registers"))[50:52] == [7, 8]
    for connection in (closed, broken):
        connection.writer.close()


@pytest.mark.parametrize(
    "write", ["05 0001 ff00", "06 0001 0007", "0f 0001 0001 01 01", "10 0001 0001 02 0007", "16 0001 0000 0007"]
)
async def test_an_acknowledged_write_that_is_not_done(modbus: MockProgram, write: str) -> None:
    before = await modbus.control.image()
    await plan(modbus, ack_only=True)
    connection = await Raw.connect(modbus)
    answer = await connection.ask(write)
    assert not bytes.fromhex(answer)[0] & 0x80
    assert await modbus.control.image() == before
    assert await connection.ask(write) == answer
    assert await modbus.control.image() != before
    connection.writer.close()


async def test_bits_are_answered_as_bits(modbus: MockProgram) -> None:
    await plan(modbus, answer_values=[0, 1, 1])
    connection = await Raw.connect(modbus)
    assert await connection.ask("01 0000 0003") == "010106"
    await plan(modbus, answer_values=[0, 1, 1])
    assert await connection.ask("06 0032 0001") == "0600320001"
    connection.writer.close()


async def test_the_first_rule_that_fits_applies_and_is_counted(modbus: MockProgram) -> None:
    rules = [
        {"function": 6, "action": {"exception": 4}},
        {"function": 3, "address": 1, "times": 2, "action": {"exception": 5}},
        {"unit": 1, "action": {"exception": 6}},
    ]
    await modbus.control.ask("fault", rules=rules)
    connection = await Raw.connect(modbus)
    asked = ["06 0001 0001", "03 0001 0001", "03 0001 0001", "03 0001 0001", "03 0002 0001"]
    assert [await connection.ask(pdu) for pdu in asked] == ["8604", "8305", "8305", "8306", "8306"]
    assert await connection.ask("03 0002 0001", unit=2) == "830b"
    assert await modbus.control.ask("fault", rules=[]) == {"hits": [1, 2, 2]}
    connection.writer.close()


# -- the plant behind it --------------------------------------------------------------------------------------


def after(unit: UnitImage, seconds: int) -> UnitImage:
    for _ in range(seconds):
        unit.tick()
    return unit


async def test_the_plant_has_no_chance_in_it() -> None:
    assert after(UnitImage(), 500).dump() == after(UnitImage(), 500).dump()


async def test_the_heater_drives_the_temperature_and_raises_the_alarm() -> None:
    unit = UnitImage()
    unit.holding_registers[1], unit.holding_registers[2] = 100, 0
    hot = after(unit, 200).input_registers[0]
    assert hot > 900
    assert unit.coils[1] is True
    # An acknowledged alarm stays off as long as the plant does not cool down and get hot again.
    unit.coils[1] = False
    assert after(unit, 10).coils[1] is False
    unit.holding_registers[1] = 0
    assert after(unit, 200).input_registers[0] < 250


async def test_the_pump_drives_pressure_and_flow() -> None:
    pumping, idle = UnitImage(), UnitImage()
    idle.coils[0] = False
    after(pumping, 5), after(idle, 5)
    assert pumping.input_registers[1] > idle.input_registers[1]
    assert pumping.input_registers[2] > idle.input_registers[2] == 0


async def test_the_command_registers_act_on_mode_and_discrete_inputs() -> None:
    unit = UnitImage()

    def state() -> tuple[bool, bool, int]:
        return unit.discrete_inputs[0], unit.discrete_inputs[1], unit.holding_registers[5]

    def command(*registers: int) -> tuple[bool, bool, int]:
        unit.holding_registers[6:10] = [int(address in registers) for address in range(6, 10)]
        unit.tick()
        return state()

    start, stop, e_stop, reset = 6, 7, 8, 9
    assert state() == (False, True, 1)
    assert command(stop) == (False, False, 0)
    assert command(start) == (False, True, 1)
    assert command(e_stop) == (True, False, 2)
    assert command(e_stop, start, reset) == (True, False, 2)
    assert command() == (True, False, 2)
    assert command(start) == (True, False, 2)
    assert command(reset) == (False, False, 0)
    assert command(start) == (False, True, 1)


async def test_what_a_client_writes_stays(modbus: MockProgram) -> None:
    connection = await Raw.connect(modbus)
    # The plant changes mode and alarm, too, but only on a command and when it gets hot.
    await connection.ask("10 0000 0064 c8" + "0001" * 100)
    await modbus.control.ask("tick", steps=2)
    commanded = await cells(modbus, "holding_registers")
    assert commanded == [1] * 5 + [2] + [1] * 94
    await connection.ask("06 0005 002a")
    await connection.ask("0f 0000 0064 0d" + "ff" * 12 + "0f")
    await modbus.control.ask("tick", steps=120)
    assert (await cells(modbus, "holding_registers"))[5] == 42
    assert await cells(modbus, "coils") == [True] * 100
    connection.writer.close()


async def test_no_setting_drives_a_value_out_of_a_register() -> None:
    for value in (0, 65535):
        unit = UnitImage()
        unit.holding_registers[:5] = [value] * 5
        for _ in range(2000):
            unit.tick()
            assert all(type(cell) is int and 0 <= cell <= 65535 for cell in unit.input_registers)
