"""The Modbus witness: examples of the specification, a library as independent peer, and segmentation."""

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

from pytest_otmcp.protocols import conversation
from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.modbus.decoder import ModbusConversation
from pytest_otmcp.wire.framing import Framer
from pytest_otmcp.wire.modbus import mbap_length

from .journals import Entry, decoded


def frame(pdu: str, *, transaction: int = 1, unit: int = 1) -> bytes:
    body = bytes.fromhex(pdu)
    return transaction.to_bytes(2) + b"\0\0" + (len(body) + 1).to_bytes(2) + bytes([unit]) + body


def journal(*exchanges: str) -> list[Entry]:
    """Return the entries of "request -> response" exchanges, PDUs in hex; "-> ?" for no answer."""
    frames: list[tuple[Direction, bytes]] = []
    for number, exchange in enumerate(exchanges, start=1):
        request, _, response = exchange.partition(" -> ")
        frames.append(("in", frame(request, transaction=number)))
        if response != "?":
            frames.append(("out", frame(response, transaction=number)))
    return decoded(ModbusConversation(), *frames)


# The examples are those of MODBUS Application Protocol V1.1b3, section 6.
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
    assert (request["request"], request["answers"]) == (True, None)
    assert request["state_changing"] == (request["function"] in {5, 6, 15, 16, 22, 23})
    assert (response["request"], response["state_changing"], response["answers"]) == (False, False, request["seq"])
    assert request["pdu"] == exchange.partition(" -> ")[0].replace(" ", "").lower()


def test_an_independent_library_agrees() -> None:
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
        (entry,) = decoded(conversation, ("in", peer.buildFrame(pdu)))
        assert expected.items() <= entry.items()
        assert (entry["unit"], entry["transaction_id"]) == (17, number)
    for number, answer, values in (
        (1, ReadHoldingRegistersResponse(registers=[7, 65535]), [7, 65535]),
        (6, ReadCoilsResponse(bits=bits), bits),
    ):
        answer.dev_id, answer.transaction_id = 17, number
        (entry,) = decoded(conversation, ("out", peer.buildFrame(answer)))
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
    directions: tuple[Direction, Direction] = ("in", "out")
    for _ in range(5000):
        pdu = bytes([rng.choice((1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43, 0x83, 0xFF))]) + rng.randbytes(rng.randrange(14))
        for direction in directions:
            (message,) = conversation.decode(direction, frame(pdu.hex(), transaction=rng.randrange(3)))
            assert message.fields["pdu"] == pdu.hex()


def test_an_answer_belongs_to_the_newest_request_with_its_identifiers() -> None:
    conversation = ModbusConversation()
    read, other = frame("03 0000 0001"), frame("03 0000 0001", unit=2)
    answer = frame("03 02 0007")
    entries = decoded(conversation, ("in", read), ("in", read), ("in", other), ("out", answer), ("out", answer))
    assert [entry["answers"] for entry in entries] == [None, None, None, 1, None]


def test_of_too_many_requests_without_an_answer_the_oldest_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conversation, "_MOST_OUTSTANDING", 2)
    requests: list[tuple[Direction, bytes]] = [("in", frame("03 0000 0001", transaction=n)) for n in (1, 2, 1, 3)]
    answers: list[tuple[Direction, bytes]] = [("out", frame("03 02 0007", transaction=n)) for n in (1, 2, 3)]
    entries = decoded(ModbusConversation(), *requests, *answers)
    assert [entry["answers"] for entry in entries[4:]] == [2, None, 3]


def test_a_coil_value_that_is_neither_on_nor_off_is_not_taken_for_one() -> None:
    (request, _) = journal("05 0001 1234 -> 85 03")
    assert request["values"] == [0x1234]
    assert request["state_changing"]
