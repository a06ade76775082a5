"""The Modbus witness: examples of the specification, a library as independent peer, segmentation, and the oracle."""

from __future__ import annotations

import random
from typing import Any

import pytest
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU
from pymodbus.pdu.bit_message import ReadCoilsRequest, ReadCoilsResponse, WriteMultipleCoilsRequest
from pymodbus.pdu.register_message import (
    MaskWriteRegisterRequest,
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from pytest_otmcp.protocols.framing import Framer
from pytest_otmcp.protocols.modbus import oracle as oracle
from pytest_otmcp.protocols.modbus.decoder import ModbusConversation, mbap_length

Entry = dict[str, Any]


def frame(pdu: str, *, transaction: int = 1, unit: int = 1) -> bytes:
    body = bytes.fromhex(pdu)
    return transaction.to_bytes(2) + b"\0\0" + (len(body) + 1).to_bytes(2) + bytes([unit]) + body


def journal(*exchanges: str, connection: int = 1) -> list[Entry]:
    """Entries of "request -> response" exchanges, PDUs in hex; "-> ?" for no answer."""
    conversation, entries = ModbusConversation(), []
    for number, exchange in enumerate(exchanges, start=1):
        request, _, response = exchange.partition(" -> ")
        entries += conversation.decode("in", frame(request, transaction=number))
        if response != "?":
            entries += conversation.decode("out", frame(response, transaction=number))
    return [{"seq": seq, "connection": connection, **entry} for seq, entry in enumerate(entries)]


# MODBUS Application Protocol V1.1b3, the examples of section 6.
EXAMPLES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "01 0013 0013 -> 01 03 CD6B05": (
        {"function": 1, "address": 19, "quantity": 19},
        {"values": [bool(int(bit)) for bit in "1011001111010110101"]},
    ),
    "02 00C4 0016 -> 02 03 ACDB35": (
        {"function": 2, "address": 196, "quantity": 22},
        {"values": [bool(int(bit)) for bit in "0011010111011011101011"]},
    ),
    "03 006B 0003 -> 03 06 022B00000064": (
        {"function": 3, "address": 107, "quantity": 3},
        {"values": [555, 0, 100]},
    ),
    "04 0008 0001 -> 04 02 000A": ({"function": 4, "address": 8, "quantity": 1}, {"values": [10]}),
    "05 00AC FF00 -> 05 00AC FF00": (
        {"function": 5, "address": 172, "quantity": 1, "values": [True]},
        {"exception": None},
    ),
    "06 0001 0003 -> 06 0001 0003": (
        {"function": 6, "address": 1, "quantity": 1, "values": [3]},
        {"exception": None},
    ),
    "0F 0013 000A 02 CD01 -> 0F 0013 000A": (
        {"function": 15, "address": 19, "quantity": 10, "values": [bool(int(bit)) for bit in "1011001110"]},
        {"exception": None},
    ),
    "10 0001 0002 04 000A0102 -> 10 0001 0002": (
        {"function": 16, "address": 1, "quantity": 2, "values": [10, 258]},
        {"exception": None},
    ),
    "16 0004 00F2 0025 -> 16 0004 00F2 0025": (
        {"function": 22, "address": 4, "and_mask": 0xF2, "or_mask": 0x25},
        {"exception": None},
    ),
    "17 0003 0006 000E 0003 06 00FF00FF00FF -> 17 0C 00FE0ACD00010003000D00FF": (
        {"function": 23, "read_address": 3, "read_quantity": 6, "address": 14, "quantity": 3, "values": [255] * 3},
        {"values": [0xFE, 0xACD, 1, 3, 13, 255]},
    ),
    "01 04A1 0001 -> 81 02": ({"function": 1, "address": 1185}, {"function": 1, "exception": 2}),
}


@pytest.mark.parametrize("exchange", EXAMPLES)
def test_the_examples_of_the_specification_are_read_as_it_says(exchange: str) -> None:
    request, response = journal(exchange)
    expected_request, expected_response = EXAMPLES[exchange]
    assert (request["kind"], request["direction"], request["unit"]) == ("request", "in", 1)
    assert (response["kind"], response["direction"]) == ("response", "out")
    assert expected_request.items() <= request.items()
    assert expected_response.items() <= response.items()
    assert request["state_changing"] == (request["function"] in {5, 6, 15, 16, 22, 23})
    assert request["pdu"] == exchange.partition(" -> ")[0].replace(" ", "").lower()


def test_a_library_of_somebody_else_agrees() -> None:
    peer = FramerSocket(DecodePDU(False))
    bits = [True, False, True, True, False, False, True, True, True]
    requests: list[tuple[Any, dict[str, Any]]] = [
        (ReadHoldingRegistersRequest(address=5, count=7), {"function": 3, "address": 5, "quantity": 7}),
        (WriteSingleRegisterRequest(address=9, registers=[40]), {"function": 6, "address": 9, "values": [40]}),
        (
            WriteMultipleRegistersRequest(address=2, registers=[1, 65535]),
            {"function": 16, "address": 2, "quantity": 2, "values": [1, 65535]},
        ),
        (
            WriteMultipleCoilsRequest(address=3, bits=bits),
            {"function": 15, "address": 3, "quantity": 9, "values": bits},
        ),
        (
            MaskWriteRegisterRequest(address=4, and_mask=0xF2, or_mask=0x25),
            {"function": 22, "address": 4, "and_mask": 0xF2, "or_mask": 0x25},
        ),
        (ReadCoilsRequest(address=1, count=9), {"function": 1, "address": 1, "quantity": 9}),
    ]
    conversation = ModbusConversation()
    for number, (pdu, expected) in enumerate(requests, start=1):
        pdu.dev_id, pdu.transaction_id = 17, number
        (entry,) = conversation.decode("in", peer.buildFrame(pdu))
        assert expected.items() <= entry.items()
        assert (entry["unit"], entry["transaction_id"]) == (17, number)
    for number, answer, values in (
        (1, ReadHoldingRegistersResponse(registers=[7, 65535]), [7, 65535]),
        (6, ReadCoilsResponse(bits=bits), bits),
    ):
        answer.dev_id, answer.transaction_id = 17, number
        (entry,) = conversation.decode("out", peer.buildFrame(answer))
        assert entry["values"] == values


def test_segments_of_any_size_give_the_same_frames() -> None:
    rng = random.Random(11)
    frames = [
        frame(bytes([rng.randrange(1, 128), *rng.randbytes(rng.randrange(252))]).hex(), transaction=number)
        for number in range(200)
    ]
    stream = b"".join(frames)
    for largest in (1, 2, 7, 300, len(stream)):
        framer, cut, at = Framer(mbap_length), [], 0
        while at < len(stream):
            size = rng.randint(1, largest)
            cut += framer.feed(stream[at : at + size])
            at += size
        assert cut == frames
        assert framer.pending == b""
        assert framer.malformed is None


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        ("0001 0001 0006 01", "the protocol identifier is 1, it must be 0"),
        ("0001 0000 0001 01", "the MBAP length is 1, it must be 2 to 254"),
        ("0001 0000 FFFF 01", "the MBAP length is 65535, it must be 2 to 254"),
    ],
)
def test_a_header_that_is_none_ends_the_cutting_and_says_why(header: str, reason: str) -> None:
    framer = Framer(mbap_length)
    good = frame("03 0000 0001")
    assert framer.feed(good + bytes.fromhex(header)) == [good]
    assert framer.malformed == reason
    assert framer.feed(good) == []
    assert framer.pending == bytes.fromhex(header) + good


def test_random_pdus_never_make_the_decoder_fail() -> None:
    rng = random.Random(5)
    conversation = ModbusConversation()
    for _ in range(5000):
        pdu = bytes([rng.choice((1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43, 0x83, 0xFF))]) + rng.randbytes(rng.randrange(14))
        for direction in ("in", "out"):
            (entry,) = conversation.decode(direction, frame(pdu.hex(), transaction=rng.randrange(3)))
            assert entry["pdu"] == pdu.hex()


def test_a_coil_value_that_is_neither_on_nor_off_is_not_taken_for_one() -> None:
    (request, _) = journal("05 0001 1234 -> 85 03")
    assert "values" not in request
    assert request["state_changing"]


# -- the oracle -------------------------------------------------------------------------------------------

READ = "04 0000 0002 -> 04 04 00010002"
WRITE = "06 0001 0028 -> 06 0001 0028"
WRITE_MANY = "10 0001 0001 02 0028 -> 10 0001 0001"
MISSING = "03 270F 0001 -> 83 02"


def words(findings: list[Any]) -> str:
    (finding,) = findings
    return f"{finding.message} [{finding.requirement}] {finding.evidence or ''}"


def test_an_exchange_needs_a_request_and_its_answer() -> None:
    assert oracle.some_exchange(journal(READ)) == []
    assert "it saw none" in words(oracle.some_exchange([]))
    assert "it answered 0 of 1" in words(oracle.some_exchange(journal("03 0000 0001 -> ?")))


def test_one_request_means_one() -> None:
    assert oracle.exactly_one_request(journal(READ, MISSING), function=4, address=0, quantity=2) == []
    twice = words(oracle.exactly_one_request(journal(READ, READ), function=4, address=0, quantity=2))
    assert "should have seen 1 request(s) with function 4, address 0, quantity 2, it saw 2" in twice
    assert "FC 04 address 0 quantity 2; FC 04 address 0 quantity 2" in twice
    assert "it saw 0" in words(oracle.exactly_one_request(journal(READ), function=4, address=1))
    assert oracle.request_count(journal(READ, READ), function=4, count=2) == []


@pytest.mark.parametrize("exchange", [WRITE, WRITE_MANY])
def test_a_write_counts_whichever_function_it_uses(exchange: str) -> None:
    assert oracle.exactly_one_write(journal(READ, exchange), "holding_registers", address=1, values=[40]) == []


def test_a_write_that_is_repeated_or_another_one_is_found() -> None:
    twice = words(oracle.exactly_one_write(journal(WRITE, WRITE), "holding_registers", address=1, values=[40]))
    assert "one write of [40] to holding_registers 1, it saw 2" in twice
    assert "[WR-003]" in twice
    for address, values, table in ((2, [40], "holding_registers"), (1, [41], "holding_registers")):
        assert "it saw another write" in words(
            oracle.exactly_one_write(journal(WRITE), table, address=address, values=values)
        )
    assert "it saw 0" in words(oracle.exactly_one_write(journal(READ), "holding_registers", address=1, values=[40]))
    coil = journal("05 0001 FF00 -> 05 0001 FF00")
    assert oracle.exactly_one_write(coil, "coils", address=1, values=[True]) == []
    assert oracle.exactly_one_write(coil, "coils", address=1, values=[1]) != []


@pytest.mark.parametrize(
    "pdu", ["05 0001 FF00", "06 0001 0028", "0F 0000 0001 01 01", "10 0001 0001 02 0028", "16 0001 0000 FFFF",
            "17 0000 0001 0001 0001 02 0028"]
)  # fmt: skip
def test_every_state_changing_function_is_a_write_also_without_an_answer(pdu: str) -> None:
    assert oracle.no_state_changing_request(journal(READ, MISSING)) == []
    assert "should have seen no state-changing request, it saw 1" in words(
        oracle.no_state_changing_request(journal(f"{pdu} -> ?"))
    )


def test_an_exception_is_seen_by_its_code() -> None:
    assert oracle.exception_sent(journal(MISSING), 2) == []
    assert "exception 03, its answers were [2]" in words(oracle.exception_sent(journal(MISSING), 3))
    assert "exception 02, its answers were none" in words(oracle.exception_sent([], 2))


def image(**changes: int) -> dict[str, Any]:
    registers = [0] * 10
    for name, value in changes.items():
        registers[int(name.removeprefix("r"))] = value
    cells = points("holding_registers", 0, registers) | points("coils", 0, [False, True])
    return {"points": cells}


def test_images_are_compared_cell_by_cell() -> None:
    assert oracle.only_changed(image(), image(r1=40), points("holding_registers", 1, [40])) == []
    assert oracle.only_changed(image(r3=7), image(r3=7), {}) == []
    neighbour = oracle.only_changed(image(), image(r1=40, r2=40), points("holding_registers", 1, [40]))
    assert "1/holding_registers/2 should hold 0, the device holds 40 [WR-002]" in words(neighbour)
    unwritten = oracle.only_changed(image(), image(), points("holding_registers", 1, [40]))
    assert "should hold 40, the device holds 0 [WR-001]" in words(unwritten)
    assert len(oracle.only_changed(image(), {"points": points("holding_registers", 0, [1] * 10)}, {})) == 5


def test_the_image_is_asked_for_values_of_the_right_type() -> None:
    assert oracle.image_holds(image(r1=40, r2=41), "holding_registers", 1, [40, 41]) == []
    assert oracle.image_holds(image(), "coils", 1, [True]) == []
    assert "1/coils/1 should hold 1, the device holds True" in words(oracle.image_holds(image(), "coils", 1, [1]))
    nowhere = oracle.image_holds(image(), "holding_registers", 1, [0], unit=9)
    assert "9/holding_registers/1 should hold 0, the device has no such point" in words(nowhere)
