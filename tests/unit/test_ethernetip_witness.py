"""The EtherNet/IP witness: frames of the published layout, segmentation, any bytes; and its oracles on exchanges."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest

from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.ethernetip import oracle
from pytest_otmcp.protocols.ethernetip.decoder import EthernetIpConversation
from pytest_otmcp.protocols.ethernetip.entries import carried_out, changes, describe, tag_of, title
from pytest_otmcp.protocols.ethernetip.trace import facts
from pytest_otmcp.protocols.journal import UNTOLD
from pytest_otmcp.wire.ethernetip.frames import frame_length
from pytest_otmcp.wire.framing import Framer, MalformedError

from .journals import Entry, decoded

REGISTER = "6500 0400 00000000 00000000 {context} 00000000 0100 0000"
COUNT = "91 05 436f756e74 00"
"""The path of the tag Count."""
READ = f"4c 04 {COUNT} 0100 -> cc 00 00 00 c400 32000000"
WRITE = f"4d 04 {COUNT} c400 0100 4d000000 -> cd 00 00 00"
WRITE_TWICE = f"4d 04 {COUNT} c400 0100 4d000000 04 {COUNT} c400 0100 4d000000 -> cd 00 00 00"
WRITE_BY_INSTANCE = "4d 03 20 6b 25 00 0d01 c400 0100 4d000000 -> cd 00 00 00"
WRITE_REAL = f"4d 04 {COUNT} ca00 0100 00009a42 -> cd 00 ff 01 0721"
BIT = f"4e 04 {COUNT} 0400 08000000 ffffffff -> ce 00 00 00"
BOTH_BITS = f"4e 04 {COUNT} 0400 18000000 ffffffff -> ce 00 00 00"
MISSING = f"4c 04 {COUNT} 0100 -> cc 00 04 01 0000"
ELEMENTS = "4c 05 91 06 4c6576656c73 28 01 0300 -> cc 00 00 00 ca00" + "00" * 12
TWO = (
    f"0a 02 20 02 24 01 0200 0600 1800 4d04 {COUNT} c400 0100 4d000000 4d03 20 6b 25 00 1001 c400 0100 07000000 -> "
    "8a 00 1e 00 0200 0600 0a00 cd000000 cd000f00"
)
SET_CLOCK = "04 02 20 8b 24 01 0100 0600 0000000000000000 -> 84 00 00 00 0100 0600 0000"
OPEN = (
    "54 02 20 06 24 01 0a0e 00000000 55000000 0700 3412 63000000 03000000 80841e00 f443 80841e00 f443 {transport} 03 0100 2002 2401 -> "
    "d4 00 00 00 01000020 55000000 0700 3412 63000000 80841e00 80841e00 0000"
)
IMAGE: Any = {"symbols": {"269": "Count", "272": "Other"}, "points": {"Count": 77, "Levels[0]": 1.0, "Levels[3]": 2.0}}


def framed(command: int, data: bytes, context: int, status: int = 0) -> bytes:
    return struct.pack("<HHIIQI", command, len(data), 0x4B000001, status, context, 0) + data


def unconnected(message: str, context: int) -> bytes:
    body = bytes.fromhex(message)
    return framed(0x6F, bytes(6) + struct.pack("<HHHHH", 2, 0, 0, 0xB2, len(body)) + body, context)


def connected(message: str, connection: int, count: int, context: int = 0) -> bytes:
    body = struct.pack("<H", count) + bytes.fromhex(message)
    head = struct.pack("<HHHIHH", 2, 0xA1, 4, connection, 0xB1, len(body))
    return framed(0x70, bytes(6) + head + body, context)


def journal(*exchanges: str) -> list[Entry]:
    """Return the entries of "request -> answer" exchanges without a connection, messages in hex; "-> ?" for no answer."""
    frames: list[tuple[Direction, bytes]] = []
    for context, exchange in enumerate(exchanges):
        request, _, answer = exchange.partition(" -> ")
        frames.append(("in", unconnected(request, context)))
        if answer != "?":
            frames.append(("out", unconnected(answer, context)))
    return decoded(EthernetIpConversation(), *frames)


def codes(findings: list[Any]) -> list[tuple[str, str]]:
    return [(finding.code, finding.requirement) for finding in findings]


# -- decoding ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("exchange", "service", "changing", "item", "result"),
    [
        (READ, "read", False, {"tag": "Count", "count": 1}, {"status": 0, "data": "c40032000000"}),
        (WRITE, "write", True, {"tag": "Count", "type": 0xC4, "count": 1, "data": "4d000000"}, {"status": 0}),
        (WRITE_TWICE, "write", True, {"tag": "Count", "data": "4d000000", "excess": 17}, {"status": 0}),
        (WRITE_BY_INSTANCE, "write", True, {"class": 0x6B, "instance": 269, "data": "4d000000"}, {"status": 0}),
        (WRITE_REAL, "write", True, {"type": 0xCA}, {"status": 0xFF, "extended": 0x2107}),
        (BIT, "modify", True, {"tag": "Count", "or_mask": "08000000", "and_mask": "ffffffff"}, {"status": 0}),
        (MISSING, "read", False, {"tag": "Count"}, {"status": 4, "extended": 0}),
        (ELEMENTS, "read", False, {"tag": "Levels[1]", "count": 3}, {"status": 0}),
        (SET_CLOCK, "set_clock", True, {"class": 0x8B, "instance": 1}, {"status": 0}),
        ("05 02 20 01 24 01 -> 85 00 08 00", "other", True, {"class": 1}, {"status": 8}),
        ("4c 09 91 05 -> cc 00 26 00", "other", False, {"code": 0x4C}, {"status": 0x26}),
    ],
)
def test_a_request_and_its_answer_are_one_exchange(
    exchange: str, service: str, changing: bool, item: dict[str, Any], result: dict[str, Any]
) -> None:
    request, response = journal(exchange)
    assert (request["service"], request["state_changing"], request["request"]) == (service, changing, True)
    assert item.items() <= request["items"][0].items()
    assert (response["answers"], response["service"]) == (request["seq"], service)
    assert result.items() <= response["items"][0].items()


def test_services_of_one_packet_are_told_apart() -> None:
    request, response = journal(TWO)
    assert [tag_of(item, IMAGE) for item in request["items"]] == ["Count", "Other"]
    assert (response["status"], [item["status"] for item in response["items"]]) == (0x1E, [0, 0x0F])
    assert carried_out(request, response) is True


def test_an_unconnected_send_is_what_it_carries() -> None:
    inner = READ.partition(" -> ")[0]
    size = len(bytes.fromhex(inner))
    wrapped = f"52 02 20 06 24 01 0a0e {size:02x}00 {inner} 01 00 0100 -> cc 00 00 00 c400 32000000"
    [request, _] = journal(wrapped)
    assert (request["service"], request["route"], request["items"][0]["tag"]) == ("read", "0100", "Count")


def test_connecting_asks_the_plant_for_nothing_unless_it_drives_outputs() -> None:
    register = bytes.fromhex(REGISTER.format(context="00" * 8))
    entries = decoded(EthernetIpConversation(), ("in", register), ("out", register))
    assert [entry["kind"] for entry in entries] == ["register", "register_response"]
    entries += journal(OPEN.format(transport="a3"))
    assert [entry["kind"] for entry in entries[2:]] == ["forward_open", "forward_open_response"]
    assert not any(entry["request"] or entry["state_changing"] for entry in entries)
    drives = journal(OPEN.format(transport="01"))[0]
    assert (drives["kind"], drives["state_changing"]) == ("request", True)
    (identity,) = decoded(EthernetIpConversation(), ("in", framed(0x63, b"", 1)))
    assert (identity["service"], identity["request"]) == ("list_identity", True)


def test_a_request_that_a_connection_repeats_is_one_change() -> None:
    conversation = EthernetIpConversation()
    opening, _, opened = OPEN.format(transport="a3").partition(" -> ")
    write, _, done = WRITE.partition(" -> ")
    entries = decoded(
        conversation,
        ("in", unconnected(opening, 1)),
        ("out", unconnected(opened, 1)),
        ("in", connected(write, 0x20000001, 5)),
        ("in", connected(write, 0x20000001, 5)),
        ("out", connected(done, 0x55, 5)),
        ("in", connected(write, 0x20000001, 6)),
        ("out", connected(done, 0x55, 6)),
    )
    writes = [entry for entry in entries if entry["state_changing"]]
    assert [entry["sequence"] for entry in writes] == [5, 5, 6]
    assert changes(entries) == [writes[0], writes[2]]
    assert [entry["answers"] for entry in entries if entry["kind"] == "response"] == [
        writes[1]["seq"],
        writes[2]["seq"],
    ]
    assert codes(oracle.exactly_one_write(entries[:5], IMAGE, "Count", "DINT", 77)) == []


def test_an_error_of_the_header_answers_its_request() -> None:
    request = unconnected(WRITE.partition(" -> ")[0], 9)
    entries = decoded(EthernetIpConversation(), ("in", request), ("out", framed(0x6F, b"", 9, status=0x64)))
    assert (entries[1]["answers"], entries[1]["encapsulation"]) == (entries[0]["seq"], 0x64)
    assert carried_out(*entries) is False


def test_any_segments_and_any_bytes_are_decoded_without_an_exception() -> None:
    chance = random.Random(20261123)
    every = [READ, WRITE, TWO, BIT, ELEMENTS, SET_CLOCK, OPEN.format(transport="a3")]
    stream = b"".join(unconnected(one.partition(" -> ")[0], 1) for one in every)
    for _ in range(50):
        framer, found = Framer(frame_length), []
        rest = stream
        while rest:
            size = chance.randrange(1, 40)
            found += framer.feed(rest[:size])
            rest = rest[size:]
        assert b"".join(found) == stream
    for _ in range(1000):
        frame = bytearray(unconnected(chance.choice(every).split(" -> ")[chance.randrange(2)], 1))
        if chance.randrange(4) == 0:
            frame = bytearray(connected(chance.choice(every).split(" -> ")[0], 1, 1))
        for _ in range(chance.randrange(1, 8)):
            frame[chance.randrange(24, len(frame))] = chance.randrange(256)
        for direction in ("in", "out"):
            EthernetIpConversation().decode(direction, bytes(frame[: chance.randrange(24, len(frame) + 1)]))
    with pytest.raises(MalformedError):
        frame_length(b"\x6f\0\xff\xff")


# -- entries ----------------------------------------------------------------------------------------------------


def test_an_entry_is_described_and_gives_facts() -> None:
    request, response = journal(WRITE_REAL)
    assert describe(request) == "write tag Count type CA x1=00009a42"
    assert (title(request), describe(response)) == ("request: write tag", "response")
    assert describe(journal(BIT)[0]) == "read-modify-write tag Count or 08000000 and ffffffff"
    assert describe(journal(WRITE_BY_INSTANCE)[0]) == "write tag class 6B instance 269 type C4 x1=4d000000"
    assert 0x4D in facts(request)["service"]
    assert facts(request)["tag"] == ["Count"]
    assert facts(journal(WRITE_BY_INSTANCE)[0])["tag"] == [UNTOLD]
    assert (0xFF in facts(response)["status"], 0x2107 in facts(response)["extended_status"]) == (True, True)
    assert 0x0A in facts(journal(TWO)[0])["service"]
    assert facts({**request, "kind": "register"}) == {}
    assert carried_out(request, response) is False
    assert carried_out(request, None) is None


# -- oracles ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("exchanges", "found"),
    [
        ([WRITE], []),
        ([WRITE_TWICE], []),
        ([WRITE_BY_INSTANCE], []),
        ([WRITE.replace("436f756e74", "436f554e54")], []),
        ([READ], [("not_written_once", "WR-001")]),
        ([WRITE, WRITE], [("not_written_once", "WR-003")]),
        ([WRITE_REAL], [("not_written_once", "ENC-001")]),
        ([WRITE.replace("4d000000", "0000004d")], [("not_written_once", "ENC-001")]),
        ([WRITE.replace("4d000000", "4e000000")], [("not_written_once", "WR-001")]),
        ([WRITE.replace("436f756e74", "4f74686572")], [("not_written_once", "ADR-001")]),
        ([TWO], [("not_written_once", "WR-001")]),
    ],
)
def test_exactly_one_write(exchanges: list[str], found: list[tuple[str, str]]) -> None:
    assert codes(oracle.exactly_one_write(journal(*exchanges), IMAGE, "Count", "DINT", 77)) == found


def test_a_write_among_several_services() -> None:
    assert oracle.exactly_one_write(journal(TWO), IMAGE, "Count", "DINT", 77, among=2) == []
    assert oracle.exactly_one_write(journal(TWO), IMAGE, "Other", "DINT", 7, among=2) == []


@pytest.mark.parametrize(
    ("exchange", "found"),
    [
        (BIT, []),
        (BOTH_BITS, [("not_one_bit", "WR-011")]),
        (WRITE, [("not_one_bit", "WR-011")]),
        (BIT.replace("436f756e74", "4f74686572"), [("not_written_once", "WR-001")]),
        (READ, [("not_written_once", "WR-001")]),
    ],
)
def test_exactly_one_bit_write(exchange: str, found: list[tuple[str, str]]) -> None:
    assert codes(oracle.exactly_one_bit_write(journal(exchange), IMAGE, "Count", 3, True)) == found


def test_a_read_covers_elements() -> None:
    entries = journal(ELEMENTS)
    assert oracle.reached(entries, IMAGE, ["Levels[1]", "Levels[3]"])
    assert not oracle.reached(entries, IMAGE, ["Levels[0]"])
    assert not oracle.reached(entries, IMAGE, ["Levels[4]"])
    assert oracle.read_from_device(journal(READ), IMAGE, ["Count"]) == []
    assert codes(oracle.read_from_device(journal(READ), IMAGE, ["Other"])) == [("no_exchange", "RD-004")]


def test_refusals_the_clock_and_what_is_left_open() -> None:
    assert oracle.refused_with(journal(WRITE_REAL), 0xFF, 0x2107) == []
    assert oracle.refused_with(journal(TWO), 0x0F) == []
    assert codes(oracle.refused_with(journal(WRITE_REAL), 0xFF, 0x2105)) == [("no_refusal", "ERR-002")]
    assert oracle.one_clock_setting(journal(SET_CLOCK)) == []
    assert codes(oracle.one_clock_setting(journal(WRITE))) == [("not_written_once", "WR-001")]
    assert (oracle.changes_asked_for(journal(WRITE)), oracle.changes_asked_for(journal(READ))) == (True, False)
    assert oracle.connections_left({"connections": 1}, most=1) == []
    assert codes(oracle.connections_left({"connections": 2}, most=1)) == [("connections_left", "RES-001")]
    assert codes(oracle.connections_forgotten({"forgotten": 2}, most=1)) == [("connections_left", "RES-001")]
    assert oracle.connections_forgotten({"forgotten": 1}, most=1) == []


def test_values_are_encoded_as_a_controller_has_them() -> None:
    assert oracle.content("DINT", 1, -2).hex() == "01000000feffffff"
    assert oracle.content("BOOL", True).hex() == "ff"
    text = oracle.content("STRING", "né")
    assert (len(text), text[:7].hex()) == (88, "020000006ee900")
