"""The kit's decoder of DNP3 on frames, and the oracles on what it makes of them."""

from __future__ import annotations

import random
from typing import Any

import pytest

from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.dnp3 import oracle
from pytest_otmcp.protocols.dnp3.decoder import Dnp3Conversation
from pytest_otmcp.protocols.dnp3.entries import carried_out, changes, describe, title
from pytest_otmcp.wire.dnp3.link import link_length
from pytest_otmcp.wire.framing import Framer, MalformedError


def with_sums(header: str, data: str = "") -> bytes:
    """Return a link frame from its header without the length, in hexadecimal digits, and its user data."""
    body = bytes.fromhex(data)
    head = b"\x05\x64" + bytes([5 + len(body)]) + bytes.fromhex(header)
    blocks = [head, *(body[start : start + 16] for start in range(0, len(body), 16))]
    return b"".join(block + _sum(block) for block in blocks)


def _sum(block: bytes) -> bytes:
    value = 0
    for octet in block:
        for place in range(8):
            value = value >> 1 ^ (0xA6BC if (value ^ octet >> place) & 1 else 0)
    return (value ^ 0xFFFF).to_bytes(2, "little")


def sent(fragment: str, *, to: int = 10, segment: int = 0xC0) -> bytes:
    return with_sums(f"c4{to.to_bytes(2, 'little').hex()}0100", f"{segment:02x}" + fragment)


def answered(fragment: str) -> bytes:
    return with_sums("4401000a00", "c0" + fragment)


LATCH = "0c01 28 0100 0200 03 01 64000000 64000000 00"
SETPOINT = "2903 17 01 00 00004841 00"


def entries(*frames: tuple[Direction, bytes]) -> list[Any]:
    """Return the journal that the decoder makes of frames."""
    conversation = Dnp3Conversation()
    found: list[Any] = []
    known: dict[Any, int] = {}
    for direction, frame in frames:
        for message in conversation.decode(direction, frame):
            seq = len(found)
            known[message] = seq
            contract = {"seq": seq, "t_ns": seq, "connection": 1, "direction": direction, "origin": "client"}
            said = {"kind": message.kind, "request": message.request, "state_changing": message.state_changing}
            answers = None if message.answers is None else known[message.answers]
            found.append({**contract, **said, "answers": answers, **message.fields})
    return found


def altered(entry: Any, **members: object) -> Any:
    return {**entry, **members}


def test_a_read_and_its_response_are_one_exchange() -> None:
    asked, answer = entries(
        ("in", sent("c101 1e0000 0102")), ("out", answered("c181 8000 1e0100 0102 01ecffffff 012c010000"))
    )
    assert (asked["kind"], asked["request"], asked["state_changing"]) == ("request", True, False)
    assert asked["objects"] == [{"group": 30, "variation": 0, "qualifier": 0, "start": 1, "stop": 2}]
    assert (answer["kind"], answer["answers"], answer["iin"], answer["confirm"]) == ("response", 0, 0x80, False)
    assert answer["objects"][0]["points"] == [
        {"index": 1, "flags": 1, "value": -20},
        {"index": 2, "flags": 1, "value": 300},
    ]
    assert (title(asked), describe(asked)) == ("request: read", "read g30v0 1-2")
    assert oracle.read_from_device([asked, answer], "analog_input", 1, 2) == []
    assert oracle.read_from_device([asked], "analog_input", 1, 2)
    assert oracle.read_from_device([asked, answer], "analog_input", 1, 3)
    assert oracle.read_from_device([asked, answer], "binary_input", 1, 2)
    assert oracle.reached([asked], "analog_input", 2)


def test_ranges_indexes_counts_and_class_0_cover_points() -> None:
    for objects, kind, start, count, covered in (
        ("1e0028 0200 0300 0400", "analog_input", 3, 2, True),
        ("1e0028 0200 0300 0500", "analog_input", 3, 2, False),
        ("0a0007 03", "binary_output", 0, 3, True),
        ("0a0007 03", "binary_output", 1, 3, False),
        ("140006", "counter", 0, 2, True),
        ("3c0106", "analog_output", 0, 4, True),
        ("3c0206", "analog_output", 0, 4, False),
        ("1e0000 0001 1e0000 0203", "analog_input", 0, 4, True),
    ):
        (asked,) = entries(("in", sent("c001" + objects)))
        assert oracle.reached([asked], kind, start, count) == covered, objects


@pytest.mark.parametrize(
    ("objects", "names"),
    [
        ("1e00 00 02 09", True),
        ("1e02 17 02 02 03", False),
        ("1e00 06", False),
        ("3c01 06", False),
        ("0100 00 02 09", False),
    ],
)
def test_a_read_of_a_class_or_of_all_points_names_none(objects: str, names: bool) -> None:
    (asked,) = entries(("in", sent(f"c1 01 {objects}")))
    assert oracle.named([asked], "analog_input", 2, 8) is names


@pytest.mark.parametrize(
    ("objects", "points"),
    [
        ("010100 0008 5501", [{"index": index, "value": index % 2 == 0} for index in range(9)]),
        ("010200 0303 85", [{"index": 3, "flags": 5, "value": True}]),
        ("020228 0100 0300 81 010000000000", [{"index": 3, "flags": 1, "value": True, "time_ms": 1}]),
        ("200317 01 02 01 feffffff 0a0000000000", [{"index": 2, "flags": 1, "value": -2, "time_ms": 10}]),
        ("140200 0000 01 ffff", [{"index": 0, "flags": 1, "value": 65535}]),
        ("140600 0000 ffff", [{"index": 0, "value": 65535}]),
        ("1e0400 0000 ffff", [{"index": 0, "value": -1}]),
        ("1e0600 0707 01 000000000000f87f", [{"index": 7, "flags": 1, "value": "NaN"}]),
        ("1e0500 0707 21 000080ff", [{"index": 7, "flags": 33, "value": "-Infinity"}]),
        ("280300 0000 01 00004842", [{"index": 0, "flags": 1, "value": 50.0}]),
        ("6e0300 0000 414243", [{"index": 0, "octets": "414243"}]),
        ("340207 01 0500", [{"value": 5}]),
        ("320107 01 010000000000", [{"time_ms": 1}]),
    ],
)
def test_objects_are_read(objects: str, points: list[Any]) -> None:
    (answer,) = entries(("out", answered("c181 0000" + objects)))
    assert answer["objects"][0]["points"] == points


def test_the_segments_of_a_fragment_are_put_together_and_frames_that_are_not_in_order_are_malformed() -> None:
    first, rest = sent("c001 1e0000", segment=0x41), sent("0102", segment=0x82)
    assert [entry["kind"] for entry in entries(("in", first), ("in", rest))] == ["request"]
    assert [entry["kind"] for entry in entries(("in", rest))] == ["malformed"]
    assert [entry["kind"] for entry in entries(("in", first), ("in", first), ("in", rest))] == ["request"]


def test_link_status_is_a_request_and_an_acknowledgement_is_none() -> None:
    frames: list[tuple[Direction, bytes]] = [
        ("in", with_sums("c90a000100")),
        ("out", with_sums("0b01000a00")),
        ("in", with_sums("c00a000100")),
        ("out", with_sums("0001000a00")),
    ]
    status, answer, reset, acknowledged = entries(*frames)
    assert (status["kind"], status["request"], describe(status)) == ("link_request", True, "link status")
    assert answer["answers"] == 0
    assert (reset["request"], acknowledged["answers"]) == (False, 2)
    assert oracle.some_exchange([status, answer]) == []


@pytest.mark.parametrize(
    "frame",
    [
        sent("c0013c0106")[:-1] + b"\0",
        with_sums("c40a000100")[:-1] + b"\0",
        with_sums("440a000100", "c0c0013c0106"),
        sent("c0"),
        sent("80013c0106"),
        sent("c0818000"),
        with_sums("c40a000100"),
    ],
)
def test_what_is_no_message_of_a_master_is_malformed(frame: bytes) -> None:
    (found,) = entries(("in", frame))
    assert (found["kind"], found["bytes"]) == ("malformed", frame.hex())


def test_frames_are_cut_from_a_stream_and_noise_is_refused() -> None:
    framer = Framer(link_length)
    whole = sent("c0013c0106") + with_sums("c90a000100")
    assert [frame for byte in whole for frame in framer.feed(bytes([byte]))] == [whole[:18], whole[18:]]
    for noise in (b"\x05\x65", b"\x06", b"\x05\x64\x04"):
        with pytest.raises(MalformedError):
            link_length(noise)
    chance = random.Random(20261123)
    for _ in range(2000):
        data = bytearray(sent("c0" + chance.choice(("013c0106", "03" + LATCH, "021e0100"))))
        for _ in range(chance.randrange(4)):
            data[chance.randrange(10, len(data))] = chance.randrange(256)
        for direction in ("in", "out"):
            Dnp3Conversation().decode(direction, bytes(data))
        body = chance.randbytes(chance.randrange(1, 40)).hex()
        for message in Dnp3Conversation().decode("in", sent("c0" + body)):
            assert message.kind in ("request", "confirm", "malformed")


@pytest.mark.parametrize(
    ("fragment", "changing"),
    [
        ("c00250010007 0700", False),
        ("c00250010007 0701", True),
        ("c00250010006 0700", True),
        ("c002320107 01 000000000000", False),
        ("c0026e0200 0000 6f6b", True),
        ("c002", True),
        ("c0143c0206", False),
        ("c0153c0206", False),
        ("c017", False),
        ("c018", False),
        ("c00d", True),
        ("c0163c0206", True),
        ("c007140006", True),
        ("c003" + LATCH, True),
        ("c06f", True),
    ],
)
def test_what_keeps_the_session_changes_nothing(fragment: str, changing: bool) -> None:
    (asked,) = entries(("in", sent(fragment)))
    assert (asked["request"], asked["state_changing"]) == (True, changing)
    assert bool(oracle.no_state_changing_request([asked])) == changing


def test_a_selection_and_its_operation_are_one_change() -> None:
    frames: list[tuple[Direction, bytes]] = [
        ("in", sent("c303" + LATCH)),
        ("out", answered("c3810000" + LATCH)),
        ("in", sent("c404" + LATCH)),
        ("out", answered("c4810000" + LATCH)),
    ]
    select, echo, operate, done = entries(*frames)
    assert changes([select, echo, operate, done]) == [operate]
    assert changes([select, echo]) == [select]
    assert oracle.exactly_one_operation([select, echo, operate, done], "binary", 2, True) == []
    assert oracle.selected_first([select, echo, operate, done]) == []
    assert oracle.selected_first([operate])
    assert (carried_out(select, echo), carried_out(operate, None), carried_out(operate, done)) == (False, None, True)
    assert carried_out(operate, entries(("out", answered("c4810000" + LATCH[:-2] + "07")))[0]) is False
    assert carried_out(operate, entries(("out", answered("c4810004")))[0]) is False
    for kind, index, value, requirement in (
        ("binary", 3, True, "ADR-001"),
        ("binary", 2, False, "WR-001"),
        ("analog", 2, 1.0, "ADR-001"),
    ):
        (finding,) = oracle.exactly_one_operation([select, echo, operate, done], kind, index, value)
        assert finding.requirement == requirement
    (finding,) = oracle.exactly_one_operation([select], "binary", 2, True)
    assert finding.requirement == "WR-001"


def test_an_operation_with_another_sequence_number_or_other_objects_was_not_selected() -> None:
    for frames in (
        [sent("c303" + LATCH), sent("c504" + LATCH)],
        [sent("c303" + LATCH), sent("c404" + SETPOINT)],
        [sent("c303" + LATCH), sent("c401 3c0106"), sent("c404" + LATCH)],
        [sent("c305" + LATCH)],
    ):
        (finding,) = oracle.selected_first(entries(*(("in", frame) for frame in frames)))
        assert finding.code == "not_selected"


def test_a_request_that_is_sent_again_byte_by_byte_is_one_change() -> None:
    direct, read = sent("c405" + SETPOINT), sent("c5013c0106")
    again = entries(("in", direct), ("in", direct))
    assert changes(again) == again[:1]
    assert oracle.exactly_one_operation(again, "analog", 0, 12.5) == []
    later = entries(("in", direct), ("in", read), ("in", direct))
    assert changes(later) == [later[0], later[2]]
    (finding,) = oracle.exactly_one_operation(
        entries(("in", direct), ("in", sent("c505" + SETPOINT))), "analog", 0, 12.5
    )
    assert finding.requirement == "WR-003"


def test_events_have_to_be_confirmed_with_their_sequence_number() -> None:
    events = "020228 0100 0300 81 010000000000"
    response, unasked = answered("e7818000" + events), answered("f2828000" + events)
    told = entries(("in", sent("c7013c0206")), ("out", response), ("in", sent("c700")), ("out", unasked))
    (finding,) = oracle.confirmed(told)
    assert (finding.code, "unsolicited" in finding.message) == ("not_confirmed", True)
    assert oracle.confirmed([*told, *entries(("in", sent("d200")))]) == []
    assert len(oracle.confirmed([*told[:2], *entries(("in", sent("c600")))])) == 1
    assert len(oracle.confirmed([*told[:2], *entries(("in", sent("d700")))])) == 1
    assert (told[2]["kind"], told[2]["request"]) == ("confirm", False)
    assert oracle.polled(told, 1) == []
    assert oracle.polled(told, 2)


def test_refusals_are_told_by_indication_and_status() -> None:
    refused = entries(("out", answered("c0818004")))
    assert oracle.refused_with_iin(refused, 0x0400) == []
    [finding] = oracle.refused_with_iin(refused, 0x0200)
    assert (finding.code, "0200, its answers had 0480" in finding.message) == ("no_refusal", True)
    echo = entries(("out", answered("c0818000" + LATCH[:-2] + "0c")))
    assert oracle.refused_with_status(echo, 12) == []
    [finding] = oracle.refused_with_status(echo, 7)
    assert (finding.code, "status 7, its answers had 12" in finding.message) == ("no_refusal", True)


def test_what_goes_to_another_outstation_is_described_so() -> None:
    (asked,) = entries(("in", sent("c305" + SETPOINT, to=11)))
    assert describe(asked) == "direct operate g41v3 0=12.5 to outstation 11"
    assert carried_out(asked, None) is None
    (unanswered,) = entries(("in", sent("c306" + LATCH)))
    assert (describe(unanswered), carried_out(unanswered, None)) == (
        "direct operate without response g12v1 2=latch on",
        True,
    )
