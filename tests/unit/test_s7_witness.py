"""The S7 witness: frames as they are publicly known, segmentation, any bytes; and its oracles on exchanges."""

from __future__ import annotations

import random
from typing import Any

import pytest

from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.s7 import oracle
from pytest_otmcp.protocols.s7.decoder import S7Conversation
from pytest_otmcp.protocols.s7.entries import as_s7, carried_out, describe, points
from pytest_otmcp.protocols.s7.trace import facts
from pytest_otmcp.wire.framing import Framer
from pytest_otmcp.wire.s7 import tpkt_length

from .journals import Entry, decoded

SETUP = "3201 0000 0001 0008 0000 f000 0001 0001 01e0 -> 3203 0000 0001 0008 0000 0000 f000 0001 0001 01e0"
READ = (
    "3201 0000 0002 000e 0000 0401 120a1002 0008 0001 84 000000 -> "
    "3203 0000 0002 0002 000c 0000 0401 ff040040 4461000041400000"
)
WRITE = (
    "3201 0000 0003 000e 0008 0501 120a1002 0004 000a 84 000020 0004 0020 42f6e979 -> "
    "3203 0000 0003 0002 0001 0000 0501 ff"
)
WRITE_BIT = (
    "3201 0000 0004 000e 0005 0501 120a1001 0001 0000 83 00001d 0003 0001 01 -> 3203 0000 0004 0002 0001 0000 0501 ff"
)
WRITE_BYTE = (
    "3201 0000 0005 000e 0005 0501 120a1002 0001 0000 83 000018 0004 0008 21 -> 3203 0000 0005 0002 0001 0000 0501 ff"
)
MISSING = "3201 0000 0006 000e 0000 0401 120a1002 0002 0063 84 000000 -> 3203 0000 0006 0002 0004 0000 0401 0a000000"
REFUSED = "3201 0000 0007 000e 0000 0401 120a1002 0002 000a 84 000000 -> 3203 0000 0007 0000 0000 8104"
STATE = (
    "3207 0000 0008 0008 0008 0001120411440100 ff090004 04240000 -> "
    "3207 0000 0008 000c 0020 000112081284010000000000 ff09001c 04240000 0014 0001 4302ff08" + "00" * 16
)
STOP = "3201 0000 0009 0010 0000 2900000000 0009 505f50524f4752414d -> 3203 0000 0009 0001 0000 0000 29"
SET_CLOCK = (
    "3207 0000 000a 0008 000e 0001120411470200 ff09000a 00192611221200000001 -> "
    "3207 0000 000a 000c 0004 000112081287020000000000 0a000000"
)
MANY = (
    "3201 0000 000b 001a 000c 0502 120a1002 0001 000a 84 000008 120a1005 0001 000a 84 000010 0004 0008 07 00 00050010 fffe -> "
    "3203 0000 000b 0002 0002 0000 0502 ff0a"
)


def framed(pdu: str) -> bytes:
    body = b"\x02\xf0\x80" + bytes.fromhex(pdu)
    return b"\3\0" + (len(body) + 4).to_bytes(2, "big") + body


def journal(*exchanges: str) -> list[Entry]:
    """Return the entries of "request -> response" exchanges, PDUs in hex; "-> ?" for no answer."""
    frames: list[tuple[Direction, bytes]] = []
    for exchange in exchanges:
        request, _, response = exchange.partition(" -> ")
        frames.append(("in", framed(request)))
        if response != "?":
            frames.append(("out", framed(response)))
    return decoded(S7Conversation(), *frames)


def unanswered(exchange: str) -> str:
    return exchange.partition(" -> ")[0] + " -> ?"


def words(findings: list[Any]) -> str:
    (finding,) = findings
    return f"{finding.message} [{finding.code} {finding.requirement}]"


# -- decoder ----------------------------------------------------------------------------------------------------

EXAMPLES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "read": (
        READ,
        {"service": "read", "function": 4, "reference": 2},
        {"error": None, "items": [{"code": 0xFF, "data": "4461000041400000"}]},
    ),
    "write": (
        WRITE,
        {
            "service": "write",
            "items": [{"area": 0x84, "db": 10, "byte": 4, "bit": 0, "transport": 2, "count": 4, "data": "42f6e979"}],
        },
        {"items": [{"code": 0xFF}]},
    ),
    "a bit": (
        WRITE_BIT,
        {"items": [{"area": 0x83, "db": 0, "byte": 3, "bit": 5, "transport": 1, "count": 1, "data": "01"}]},
        {"items": [{"code": 0xFF}]},
    ),
    "a missing block": (MISSING, {"service": "read"}, {"items": [{"code": 10}]}),
    "PUT/GET off": (REFUSED, {"service": "read"}, {"error": 0x8104, "items": []}),
    "a status list": (
        STATE,
        {"service": "szl", "group": 4, "subfunction": 1, "szl_id": 0x0424, "szl_index": 0},
        {"service": "szl", "error": None, "code": 0xFF},
    ),
    "stop": (STOP, {"service": "stop", "function": 0x29}, {"service": "stop", "error": None}),
    "set clock": (SET_CLOCK, {"service": "set_clock"}, {"code": 0x0A}),
    "several, padded": (
        MANY,
        {
            "items": [
                {"area": 0x84, "db": 10, "byte": 1, "bit": 0, "transport": 2, "count": 1, "data": "07"},
                {"area": 0x84, "db": 10, "byte": 2, "bit": 0, "transport": 5, "count": 1, "data": "fffe"},
            ]
        },
        {"items": [{"code": 0xFF}, {"code": 0x0A}]},
    ),
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_exchange_is_decoded(name: str) -> None:
    exchange, asked, told = EXAMPLES[name]
    request, response = journal(exchange)
    assert asked.items() <= request.items()
    assert told.items() <= response.items()
    assert (request["kind"], response["kind"], response["answers"]) == ("request", "response", request["seq"])
    assert request["request"]
    assert request["state_changing"] is (name not in ("read", "a missing block", "PUT/GET off", "a status list"))


def test_connecting_asks_the_plant_for_nothing() -> None:
    connect = bytes.fromhex("03000016 11e00000000900 c0010a c1020100 c2020142")
    refused = bytes.fromhex("0300000b 06800009000003")
    entries = decoded(S7Conversation(), ("in", connect), ("out", refused))
    assert [entry["kind"] for entry in entries] == ["connect_request", "connect_refused"]
    assert (entries[0]["rack"], entries[0]["slot"]) == (2, 2)
    entries += journal(SETUP)
    assert [entry["kind"] for entry in entries[2:]] == ["setup", "setup_response"]
    assert not any(entry["request"] or entry["state_changing"] for entry in entries)


def test_any_segments_and_any_bytes_are_decoded_without_an_exception() -> None:
    chance = random.Random(20261122)
    stream = b"".join(framed(one.partition(" -> ")[0]) for one in (SETUP, READ, WRITE, MANY, STATE, STOP))
    for _ in range(50):
        framer, found = Framer(tpkt_length), []
        rest = stream
        while rest:
            size = chance.randrange(1, 40)
            found += framer.feed(rest[:size])
            rest = rest[size:]
        assert b"".join(found) == stream
    for _ in range(500):
        frame = bytearray(framed(chance.choice([READ, WRITE, MANY, STATE, STOP]).split(" -> ")[chance.randrange(2)]))
        for _ in range(chance.randrange(1, 8)):
            frame[chance.randrange(4, len(frame))] = chance.randrange(256)
        for direction in ("in", "out"):
            S7Conversation().decode(direction, bytes(frame[: chance.randrange(7, len(frame) + 1)]))


# -- entries ----------------------------------------------------------------------------------------------------


def test_an_entry_is_described_and_gives_facts() -> None:
    assert describe(journal(WRITE)[0]) == "write variables DB10 4 x4=42f6e979"
    assert describe(journal(WRITE_BIT)[0]) == "write variables M 3.5=01"
    assert describe(journal(STATE)[0]) == "read system status list 0424"
    request, response = journal(MISSING)
    assert facts(request) == {"references": [6], "function": [4], "area": [0x84], "db": [99], "start": [0]}
    assert facts(response) == {"error_code": [None], "return_code": [10]}
    # Which of its variables the trace of an adapter is about is the adapter's own affair.
    assert facts(journal(MANY)[0])["start"] == [1, 2]


def test_what_the_controller_carried_out_is_told_by_its_codes() -> None:
    outcomes = {}
    for name, exchange in (("all", WRITE), ("some", MANY), ("none", MISSING), ("refused", REFUSED), ("stop", STOP)):
        request, response = journal(exchange)
        outcomes[name] = carried_out(request, response)
    assert outcomes == {"all": True, "some": True, "none": False, "refused": False, "stop": True}
    assert carried_out(journal(WRITE)[0], None) is None


# -- oracles ----------------------------------------------------------------------------------------------------


def test_a_read_is_fresh_when_answered_requests_cover_it() -> None:
    assert oracle.read_from_device(journal(READ), db=1, start=2, size=6) == []
    assert "it was not" in words(oracle.read_from_device(journal(READ), db=1, start=2, size=7))
    assert "it was not" in words(oracle.read_from_device(journal(READ), db=2, start=0, size=1))
    assert "it was not" in words(oracle.read_from_device(journal(unanswered(READ)), db=1, start=0, size=1))
    assert oracle.reached(journal(unanswered(READ)), db=1, start=0, size=8)


def test_one_write_is_the_write_that_was_asked_for() -> None:
    written = bytes.fromhex("42f6e979")
    assert oracle.exactly_one_write(journal(WRITE), db=10, start=4, written=written) == []
    wrong = (
        ("it saw 0 [not_written_once WR-001]", journal(READ), 4, written),
        ("it saw 2 [not_written_once WR-003]", journal(WRITE, WRITE), 4, written),
        ("ADR-001", journal(WRITE), 8, written),
        ("ENC-001", journal(WRITE), 4, written[::-1]),
        ("WR-001", journal(MANY), 1, b"\7"),
        ("it saw stop the CPU", journal(STOP), 1, b"\7"),
    )
    for expected, entries, start, content in wrong:
        assert expected in words(oracle.exactly_one_write(entries, db=10, start=start, written=content))


def test_a_bit_is_written_as_a_bit() -> None:
    assert oracle.exactly_one_bit_write(journal(WRITE_BIT), byte=3, bit=5, value=True) == []
    assert "not_one_bit WR-011" in words(oracle.exactly_one_bit_write(journal(WRITE_BYTE), byte=3, bit=5, value=True))
    assert "not_written_once WR-001" in words(
        oracle.exactly_one_bit_write(journal(WRITE_BIT), byte=3, bit=5, value=False)
    )
    assert "WR-003" in words(oracle.exactly_one_bit_write(journal(WRITE_BIT, WRITE_BIT), byte=3, bit=5, value=True))


@pytest.mark.parametrize("exchange", [WRITE, WRITE_BIT, MANY, STOP, SET_CLOCK])
def test_everything_that_may_change_the_controller_is_a_change(exchange: str) -> None:
    assert "wrote WR-004" in words(oracle.no_state_changing_request(journal(READ, STATE, exchange)))
    assert oracle.no_state_changing_request(journal(SETUP, READ, STATE, MISSING)) == []


def test_controls_and_refusals_are_told_apart() -> None:
    assert oracle.one_control(journal(STOP), "stop") == []
    assert "stop the CPU" in words(oracle.one_control(journal(STOP), "control"))
    assert oracle.refused_with(journal(MISSING), 0x0A) == []
    assert oracle.refused_with(journal(REFUSED), 0x8104) == []
    assert "its answers had none" in words(oracle.refused_with(journal(unanswered(MISSING)), 0x0A))
    assert "no_refusal ERR-002" in words(oracle.refused_with(journal(READ), 0x0A))


def test_points_are_bytes_in_the_order_of_their_offsets() -> None:
    assert points("DB10", 2, b"\0\7") == {"DB10.DBB2": 0, "DB10.DBB3": 7}
    assert points("M", 3, b"\1") == {"MB3": 1}
    assert oracle.held({"points": {"DB10.DBB2": 0, "DB10.DBB3": 7}}, "DB10", 2, 2) == b"\0\7"
    assert as_s7(journal(READ)[0])["service"] == "read"
