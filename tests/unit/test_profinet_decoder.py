"""The kit's codec and decoder of PROFINET on recorded frames, and the oracles on what they make of them."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.profinet import oracle
from pytest_otmcp.protocols.profinet.decoder import ProfinetConversation
from pytest_otmcp.protocols.profinet.entries import carried_out, describe, points, title
from pytest_otmcp.wire.profinet.blocks import CyclicData, Module, Record, Relation, blocks_of
from pytest_otmcp.wire.profinet.dcp import Dcp, is_station_name
from pytest_otmcp.wire.profinet.frames import Datagram, Frame
from pytest_otmcp.wire.profinet.rpc import Rpc
from pytest_otmcp.wire.profinet.rt import RtFrame
from pytest_otmcp.wire.profinet.services import status_of

CONTROLLER, DEVICE = "2e51550b7236", "42e6d8a4f98c"
IDENTIFY = f"010ecf000000{CONTROLLER}8892 fefe 05 00 00000001 0001 0004 ffff0000"
IDENTIFIED = (
    f"{CONTROLLER}{DEVICE}8892 feff 05 01 00000001 0000 002c 0202000c 0000 6b69742d646576696365"
    "02030006 0000 0abc 0001 0102000e 0001 0a4d0002 ffffff00 00000000"
)
SET_NAME = f"{DEVICE}{CONTROLLER}8892 fefd 04 00 00000002 0000 000e 02020009 0001 6b69742d74776f00"
NAMED = f"{CONTROLLER}{DEVICE}8892 fefd 04 01 00000002 0000 0008 05040003 020200 00"
REFUSED_NAME = NAMED.replace("020200 00", "020203 00")
_PACKET = "4500{length}0000400040110000 0a4d0001 0a4d0002 c3508894 {data} 0000"
_HEAD = "04{kind}2000 00000000 dea000006c9711d18271000100010abc dea000016c9711d1827100a02442df7d {activity} 00000000 00000001 00000000 {op} ffff ffff {body} 0000 0000"
ACTIVITY = "b372f47ba6a2655280b7f2fa6e076a77"
PLACE = "0000 {relation} 00000000 {slot} 0001 0000 {index} {length} "
RELATION = "4c6c2c76bd4a7c309600a453fd000102"


def packed(direction: str, data: str) -> str:
    """Return the frame that a call, or its answer, is in."""
    raw = bytes.fromhex(data)
    head = _PACKET.format(length=f"{28 + len(raw):04x}", data=f"{8 + len(raw):04x}")
    there, back = (DEVICE, CONTROLLER) if direction == "in" else (CONTROLLER, DEVICE)
    return f"{there}{back}0800{head}{data}"


def called(kind: int, operation: int, blocks: str, first: int = 4100) -> str:
    """Return a call, or an answer to one."""
    size = len(bytes.fromhex(blocks))
    body = f"{first:08x} {size:08x} {size if kind else first:08x} 00000000 {size:08x} {blocks}"
    head = _HEAD.format(kind=f"{kind:02x}", activity=ACTIVITY, op=f"{operation:04x}", body=f"{size + 20:04x}")
    return packed("out" if kind == 2 else "in", head + body)


def place(slot: int, index: int, length: int) -> str:
    return PLACE.format(relation=RELATION, slot=f"{slot:04x}", index=f"{index:04x}", length=f"{length:08x}")


READ = called(0, 5, "0009003c0100" + place(3, 0x8028, 4096) + "00" * 24)
INPUTS = "0015000a 0100 0180 0180 0002 02d5"
READ_DONE = called(2, 5, "8009003c0100" + place(3, 0x8028, 14) + "00" * 24 + INPUTS, 0)
READ_REFUSED = called(2, 5, "8009003c0100" + place(3, 0x8028, 0) + "00" * 24, 0xDE80B200)
WRITE = called(0, 3, "0008003c0100" + place(3, 3, 2) + "00" * 24 + "1234")
CONNECT = called(
    0,
    0,
    f"01010040 0100 0001 {RELATION} 0001 {CONTROLLER} 00000000000000000000000000000000 00000011 0064 8892 000a 636f6e74726f6c6c6572"
    "0102003e 0100 0001 0001 8892 00000001 0028 c001 0020 0020 0001 0000 ffffffff 0064 0064 c000 000000000000 0001 00000000"
    "0001 000100010000 0001 000200010009"
    "0102003e 0100 0002 0002 8892 00000001 0028 ffff 0020 0020 0001 0000 ffffffff 0064 0064 c000 000000000000 0001 00000000"
    "0001 000200010000 0001 000100010009"
    "01040020 0100 0001 00000000 0001 00000010 0000 0001 0001 00000001 0001 0001 0008 01 01"
    "01040020 0100 0001 00000000 0002 00000020 0000 0001 0001 00000001 0002 0002 0008 01 01",
)
CONNECTED = called(
    2,
    0,
    f"8101001e 0100 0001 {RELATION} 0001 {DEVICE} 8892 81020008 0100 0001 0001 c001 81020008 0100 0002 0002 c101",
    0,
)
OUTPUTS = f"{DEVICE}{CONTROLLER}8892 c101 0102030405060708 80 80" + "00" * 30 + "0400 35 00"
OTHERS = OUTPUTS.replace("0102", "0202", 1)
BAD = OUTPUTS.replace("08 80 80", "08 00 80")
SENT = f"{CONTROLLER}{DEVICE}8892 c001 1112131415161718 80 80" + "00" * 30 + "0400 35 00"


def entry(seq: int, direction: Direction, frame: str, answers: int | None = None, **more: Any) -> Any:
    return told(ProfinetConversation(), seq, direction, frame, answers, **more)


def told(
    conversation: ProfinetConversation,
    seq: int,
    direction: Direction,
    frame: str,
    answers: int | None = None,
    **more: Any,
) -> Any:
    (message,) = conversation.decode(direction, bytes.fromhex(frame))
    contract = {"seq": seq, "t_ns": seq, "connection": 1, "direction": direction, "origin": "client"}
    said = {"kind": message.kind, "request": message.request, "state_changing": message.state_changing}
    return {**contract, **said, "answers": answers, **message.fields, **more}


def related() -> ProfinetConversation:
    """Return a conversation in which a relation with cyclic data was made."""
    conversation = ProfinetConversation()
    conversation.decode("in", bytes.fromhex(CONNECT))
    conversation.decode("out", bytes.fromhex(CONNECTED))
    return conversation


def requirements(found: list[Finding]) -> list[str]:
    return [finding.requirement for finding in found]


@pytest.mark.parametrize(
    "frame", [IDENTIFY, SET_NAME, NAMED, READ, READ_DONE, READ_REFUSED, WRITE, CONNECT, CONNECTED, OUTPUTS]
)
def test_what_is_read_is_written_again_as_it_was(frame: str) -> None:
    raw = bytes.fromhex(frame)
    ethernet = Frame.parse(raw)
    if ethernet.ethertype == 0x0800:
        datagram = Datagram.parse(ethernet.payload)
        call = Rpc.parse(datagram.data)
        again = call.encoded()
        assert again[80:] == datagram.data[80:]
        assert (
            Datagram.parse(Datagram(source=("1.2.3.4", 5), destination=("6.7.8.9", 10), data=again).encoded()).data
            == again
        )
    else:
        parsed: Any = (RtFrame if ethernet.payload[0] == 0xC1 else Dcp).parse(ethernet.payload)
        assert Frame(
            destination=ethernet.destination,
            source=ethernet.source,
            ethertype=ethernet.ethertype,
            payload=parsed.encoded(),
        ).encoded() == raw.ljust(60, b"\0")


def test_the_blocks_of_a_relation_are_written_again_as_they_were() -> None:
    blocks, _ = blocks_of(Rpc.parse(Datagram.parse(Frame.parse(bytes.fromhex(CONNECT)).payload).data).blocks)
    relation, inputs, outputs, *modules = blocks
    assert Relation.parse(relation.body).encoded() == relation.encoded()
    assert [CyclicData.parse(one.body).encoded() for one in (inputs, outputs)] == [inputs.encoded(), outputs.encoded()]
    assert [Module.parse_all(one.body)[0].encoded() for one in modules] == [one.encoded() for one in modules]
    (header, *_), content = blocks_of(Rpc.parse(Datagram.parse(Frame.parse(bytes.fromhex(WRITE)).payload).data).blocks)
    assert (Record.parse(header).encoded(), content) == (header.encoded(), b"\x12\x34")


def test_every_station_answers_an_identify() -> None:
    conversation = ProfinetConversation()
    (asked,) = conversation.decode("in", bytes.fromhex(IDENTIFY))
    for _ in range(2):
        (answer,) = conversation.decode("out", bytes.fromhex(IDENTIFIED))
        assert answer.answers is asked
    assert (answer.fields["service"], answer.fields["mac"]) == ("identify", "42:e6:d8:a4:f9:8c")
    assert title(entry(0, "in", IDENTIFY)) == "request: DCP Identify"


def test_a_name_is_set_and_refused() -> None:
    asked = entry(0, "in", SET_NAME)
    assert (asked["service"], asked["name"], asked["state_changing"]) == ("set", "kit-two", True)
    assert describe(asked) == "DCP Set kit-two"
    assert carried_out(asked, entry(1, "out", NAMED)) is True
    assert entry(1, "out", REFUSED_NAME)["status"] == "dcp-3"
    assert oracle.named_once([asked], asked["mac"], "kit-two") == []
    assert requirements(oracle.named_once([asked], asked["mac"], "kit-one")) == ["WR-001"]
    assert requirements(oracle.named_once([asked], "other", "kit-two")) == ["WR-002"]


def test_a_read_and_its_answer_are_one_exchange() -> None:
    conversation = ProfinetConversation()
    (asked,) = conversation.decode("in", bytes.fromhex(READ))
    (answer,) = conversation.decode("out", bytes.fromhex(READ_DONE))
    assert answer.answers is asked
    assert (asked.fields["slot"], asked.fields["index"]) == (3, 0x8028)
    assert bytes.fromhex(str(answer.fields["data"])) == bytes.fromhex(INPUTS)
    asked_entry, refused = entry(0, "in", READ), entry(1, "out", READ_REFUSED, answers=0)
    assert (refused["status"], describe(asked_entry)) == ("b2", "Read 3/1/8028")
    assert oracle.refused_with([asked_entry, refused], "b2") == []
    assert requirements(oracle.refused_with([asked_entry], "b2")) == ["ERR-002"]
    assert carried_out(asked_entry, refused) is False


def test_inputs_are_read_by_a_record_or_a_cyclic_frame() -> None:
    asked, answer = entry(0, "in", READ), entry(1, "out", READ_DONE, answers=0)
    assert oracle.inputs_were_read([asked, answer], (3, 1)) == []
    assert requirements(oracle.inputs_were_read([asked], (3, 1))) == ["RD-004"]
    sent = told(related(), 2, "out", SENT)
    assert (sent["kind"], sent["subslots"]) == ("inputs", {"1.1": "1112131415161718"})
    assert oracle.inputs_were_read([sent], (1, 1)) == []
    assert requirements(oracle.inputs_were_read([sent], (3, 1))) == ["RD-004"]
    assert oracle.reached([asked], (3, 1))
    assert not oracle.reached([asked], (1, 1))


def test_outputs_that_are_repeated_or_bad_change_nothing() -> None:
    conversation = related()
    frames = (BAD, OUTPUTS, OUTPUTS, OTHERS)
    found = [told(conversation, seq, "in", frame) for seq, frame in enumerate(frames)]
    assert [(one["kind"], one["state_changing"]) for one in found] == [
        ("cycle", False),
        ("request", True),
        ("cycle", False),
        ("request", True),
    ]
    assert describe(found[1]) == "cyclic outputs 2.1=0102030405060708"
    assert carried_out(found[1], None) is True


@pytest.mark.parametrize(
    ("slot", "content", "found"),
    [
        (2, "0102030405060708", []),
        (4, "0102030405060708", ["ADR-001"]),
        (2, "0807060504030201", ["ENC-001"]),
        (2, "0102030405060709", ["WR-001"]),
    ],
)
def test_other_outputs_than_were_asked_for_are_found(slot: int, content: str, found: list[str]) -> None:
    seen = [told(related(), 0, "in", OUTPUTS)]
    assert requirements(oracle.outputs_written_once(seen, (slot, 1), bytes.fromhex(content))) == found


@pytest.mark.parametrize(
    ("slot", "index", "content", "found"),
    [(3, 3, "1234", []), (1, 3, "1234", ["ADR-001"]), (3, 4, "1234", ["ADR-001"]), (3, 3, "3412", ["ENC-001"])],
)
def test_another_record_than_was_asked_for_is_found(slot: int, index: int, content: str, found: list[str]) -> None:
    seen = [entry(0, "in", WRITE)]
    assert requirements(oracle.record_written_once(seen, (slot, 1), index, bytes.fromhex(content))) == found


def test_no_write_two_writes_and_one_of_another_kind_are_found() -> None:
    wanted = {"place": (3, 1), "index": 3, "content": b"\x12\x34"}
    assert requirements(oracle.record_written_once([entry(0, "in", READ)], **wanted)) == ["WR-001"]
    twice = [entry(0, "in", WRITE), entry(1, "in", WRITE)]
    assert requirements(oracle.record_written_once(twice, **wanted)) == ["WR-003"]
    assert requirements(oracle.record_written_once([entry(0, "in", SET_NAME)], **wanted)) == ["WR-002"]
    assert requirements(oracle.outputs_written_once(twice[:1], (2, 1), bytes(8))) == ["WR-002"]


@pytest.mark.parametrize("frame", [CONNECT, WRITE, SET_NAME, OUTPUTS])
def test_what_drives_a_device_is_no_read(frame: str) -> None:
    session, driving = oracle.Drives(), entry(0, "in", frame)
    session.feed(driving)
    for found in (oracle.nothing_driven([driving]), oracle.nothing_driven_by(session)):
        assert [(finding.code, finding.requirement) for finding in found] == [("driven", "WR-004")]
    assert oracle.nothing_driven([entry(0, "in", READ), entry(1, "in", IDENTIFY)]) == []


def test_a_device_without_controller_and_outputs_that_stay_are_found() -> None:
    image = {
        "stations": {"kit-two": {"mac": "m"}},
        "controller": "",
        "modules": {"2": "00000020"},
        "points": points(2, "output", b"\0\1"),
    }
    assert [finding.code for finding in oracle.has_controller(image)] == ["no_controller"]
    assert requirements(oracle.cleared(image, requirement="MCP-009")) == ["MCP-009"]
    assert requirements(oracle.has_name(image, "m", "kit-one")) == ["WR-001"]
    assert oracle.has_name(image, "m", "kit-two") == []
    assert (oracle.mac_of(image, "kit-two"), oracle.module_in(image, 2)) == ("m", "00000020")


def test_stations_that_were_not_asked_are_found() -> None:
    asked, answer = entry(0, "in", IDENTIFY), entry(1, "out", IDENTIFIED, answers=0, service="identify")
    assert oracle.station_answered([asked, answer], answer["mac"]) == []
    assert requirements(oracle.station_answered([asked], answer["mac"])) == ["RD-004"]
    assert requirements(oracle.signalled([asked, answer], answer["mac"])) == ["RD-004"]


@pytest.mark.parametrize(
    "frame",
    [
        "",
        "00" * 13,
        IDENTIFY[:-4],
        SET_NAME[:-8],
        READ[:-8],
        READ.replace("0800", "0806", 1),
        OUTPUTS[:-40],
        "00" * 12 + "86dd",
    ],
)
def test_what_is_no_frame_of_these_is_malformed(frame: str) -> None:
    assert entry(0, "in", frame)["kind"] == "malformed"


@pytest.mark.parametrize(
    ("status", "key"), [(0, None), (0xDE80B200, "b2"), (0xDB814004, "cmrpc-04"), (0xDB810209, "cm-02")]
)
def test_a_status_has_a_key(status: int, key: str | None) -> None:
    assert status_of(status) == key


@pytest.mark.parametrize("name", ["a", "press-4", "plc.line-1", "x" * 63])
def test_a_station_may_have_a_name(name: str) -> None:
    assert is_station_name(name)


@pytest.mark.parametrize("name", ["Kit", "a_b", "-a", "a-", "a..b", "x" * 64, "10.0.0.1", "port-001-00001"])
def test_a_station_may_not_have_a_name(name: str) -> None:
    assert not is_station_name(name)
