"""The DNP3 outstation: its answers byte by byte, two masters of other authors, a decoder of others, malformed input, faults."""

from __future__ import annotations

import asyncio
import json
import random
import shutil
import struct
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from dnp3.core.enums import ControlCode
from dnp3.master import DefaultSOEHandler, LinkResetPolicy, Master, MasterConfig, MasterTcpRunner
from dnp3_tools import RawDnp3, checksum, crob, link_frame
from mock_program import MockProgram, RefusedError

pytestmark = pytest.mark.asyncio(loop_scope="module")
MOCK = "dnp3"

OK = "8000"
"""Internal indications of a healthy outstation whose restart bit nobody has cleared."""


@pytest_asyncio.fixture(loop_scope="module")
async def raw(device: MockProgram) -> AsyncIterator[RawDnp3]:
    connection = RawDnp3()
    await connection.dial(device)
    yield connection
    await connection.close()


def compact(text: str) -> str:
    """Leave the blanks out of digits, but the one behind the indications."""
    iin, _, objects = text.partition(" ")
    return f"{iin} {objects.replace(' ', '')}"


# -- reading --------------------------------------------------------------------------------------------------

READS = {
    "a range of whole numbers": ("1e0000 0001", f"{OK} 1e01000001 0164000000 01ecffffff"),
    "a range of two variations": ("1e0000 0607", f"{OK} 1e01000606 0407000000 1e06000707 01000000000000f83f"),
    "a range of 16 bits": ("1e0001 01000100", f"{OK} 1e01000101 01ecffffff"),
    "16 bits, some beyond": ("1e0200 0404", f"{OK} 1e02000404 0178ec"),
    "without flags, those of one that is not online": (
        "1e0300 0506",
        f"{OK} 1e03000505 3c000000 1e01000606 0407000000",
    ),
    "a double as a float": ("1e0500 0707", f"{OK} 1e05000707 010000c03f"),
    "a double as a whole number": ("1e0100 0707", f"{OK} 1e01000707 0101000000"),
    "binary inputs": ("010000 0203", f"{OK} 0102000203 8101"),
    "binary inputs, packed": ("010100 0008", f"{OK} 0101000008 5501"),
    "outputs": ("0a0006", f"{OK} 0a02000007 0101010101010101"),
    "two counters": ("140006", f"{OK} 1401000001 0100000000 01e8030000"),
    "a counter of 16 bits without flags": ("140600 0101", f"{OK} 1406000101 e803"),
    "analog outputs": ("280000 0203", f"{OK} 2803000202 0100002041 2801000303 0105000000"),
    "a text": ("6e0000 0000", f"{OK} 6e05000000 7265616479"),
    "the first two": ("1e0007 02", f"{OK} 1e01000001 0164000000 01ecffffff"),
    "by index": ("1e0017 02 0301", f"{OK} 1e011702 030128000000 0101ecffffff"),
    "by index of 16 bits": ("1e0028 0100 0300", f"{OK} 1e01280100 030001 28000000"),
    "no events": ("3c0206 3c0306 3c0406", f"{OK} "),
    "several headers": ("1e0000 0101 0a0000 0202", f"{OK} 1e01000101 01ecffffff 0a02000202 01"),
    "past the end": ("1e0000 0208", "8004 "),
    "one that is missing": ("1e0017 01 08", "8004 "),
    "an index beyond": ("010001 00000001", "8004 "),
    "an unknown group": ("050006", "8002 "),
    "an unknown variation": ("1e0900 0000", "8002 "),
    "a known one beside an unknown one": ("1e0000 0101 050006", "8002 1e01000101 01ecffffff"),
    "a range backwards": ("1e0000 0302", "8004 "),
    "a qualifier that nobody has": ("1e0055 00", "8004 "),
    "a header that is cut off": ("1e0000 00", "8004 "),
    "a class by range": ("3c0200 0001", "8004 "),
    "more than a fragment holds": ("1e0006" * 60, "8004 "),
}


@pytest.mark.parametrize("name", READS)
async def test_a_read_is_answered(raw: RawDnp3, name: str) -> None:
    asked, expected = READS[name]
    assert await raw.ask("01" + asked) == compact(expected)


async def test_class_0_is_every_point_but_the_text(raw: RawDnp3) -> None:
    answer = bytes.fromhex((await raw.ask("01 3c0106")).split()[1])
    assert answer.startswith(bytes.fromhex("010200000f 8101"))
    assert b"ready" not in answer
    assert len(answer) == 5 + 16 + 5 + 8 + 5 + 10 + 5 + 35 + 5 + 9 + 5 + 15 + 5 + 5


async def test_values_that_do_not_fit_are_brought_within_and_said_to_be(device: MockProgram, raw: RawDnp3) -> None:
    await device.control.poke(point="analog_input/1", value=-70000)
    assert await raw.ask("01 1e0200 0101") == f"{OK} 1e02000101210080"
    await device.control.poke(point="analog_input/7", value=1e300)
    assert await raw.ask("01 1e0500 0707") == f"{OK} 1e05000707210000807f"
    await device.control.poke(point="analog_input/7", value="NaN")
    assert await raw.ask("01 1e0600 0707") == f"{OK} 1e0600070701000000000000f87f"
    assert await raw.ask("01 1e0100 0707") == f"{OK} 1e010007072100000000"
    await device.control.poke(point="analog_input/1", value=1, flags=["ONLINE", "LOCAL_FORCED"])
    assert await raw.ask("01 1e0100 0101") == f"{OK} 1e010001011101000000"
    assert (await device.control.image())["flags"]["analog_input/1"] == ["ONLINE", "LOCAL_FORCED"]


# -- events ---------------------------------------------------------------------------------------------------


async def test_events_come_again_until_they_are_confirmed(device: MockProgram, raw: RawDnp3) -> None:
    for point, value in (("binary_input/3", True), ("binary_input/4", False), ("binary_input/5", True)):
        await device.control.poke(point=point, value=value)
    assert (await raw.ask("01 1e0000 0101"))[:4] == "8200"
    told = []
    for confirmed in (False, False, True):
        raw.send("01 3c0206")
        answer = await raw.fragment()
        # It is to be confirmed, and nothing of class 1 is left: g2v2, two of them with their indexes and flags.
        assert (answer[0] >> 5, answer[1], answer[2:9].hex()) == (0b111, 129, "8000" + "0202280200")
        assert (answer[9:12].hex(), answer[18:21].hex(), len(answer)) == ("030081", "040001", 27)
        told.append(answer[4:])
        if confirmed:
            # A confirmation of something else is none.
            raw.confirm((answer[0] + 1) & 0x0F)
            raw.confirm(answer[0] & 0x0F, unsolicited=True)
            assert (await device.control.image())["events"] == {"1": 2, "2": 0, "3": 0}
            raw.confirm(answer[0] & 0x0F)
    assert told[0] == told[1] == told[2]
    assert await raw.ask("01 3c0206") == f"{OK} "
    assert len(await device.control.journal(kind="confirm", request=False)) == 3


async def test_of_an_analog_input_the_newest_event_is_kept(device: MockProgram, raw: RawDnp3) -> None:
    for value in (7, 8):
        await device.control.poke(point="analog_input/0", value=value)
    assert (await raw.ask("01 200106")) == "8000 200128010000000108000000"
    assert (await raw.ask("01 200106")) == f"{OK} "


async def test_events_that_nobody_fetches_are_lost_in_the_end_and_that_is_said(
    device: MockProgram, raw: RawDnp3
) -> None:
    for number in range(101):
        await device.control.poke(point="binary_input/3", value=bool(number % 2))
    assert (await raw.ask("01 1e0000 0101"))[:4] == "8208"
    assert (await raw.ask("01 3c0207 60"))[:15] == "8208 0202286000"
    assert (await raw.ask("01 3c0206"))[5:15] == "0202280400"
    assert (await raw.ask("01 1e0000 0101"))[:4] == OK


async def test_unsolicited_responses_come_to_who_wants_them_and_once_until_they_are_confirmed(
    device: MockProgram, raw: RawDnp3
) -> None:
    assert await raw.ask("14 3c0206") == f"{OK} "
    await device.control.poke(point="binary_input/3", value=True)
    first = await raw.fragment()
    assert (first[0] >> 4, first[1], first[4:9].hex()) == (0b1111, 130, "0202280100")
    await device.control.poke(point="binary_input/3", value=False)
    await device.control.poke(point="analog_input/0", value=9)
    raw.confirm(first[0] & 0x0F, unsolicited=True)
    second = await raw.fragment()
    assert (second[0] & 0x0F, second[9:12].hex()) == ((first[0] + 1) & 0x0F, "030001")
    raw.confirm(second[0] & 0x0F, unsolicited=True)
    assert await raw.ask("15 3c0206") == "8400 "
    await device.control.poke(point="binary_input/3", value=True)
    assert (await raw.ask("01 1e0000 0101"))[:4] == "8600"
    [one, two] = await device.control.journal(kind="unsolicited")
    assert (one["answers"], two["objects"][0]["points"][0]["index"]) == (None, 3)
    assert await raw.ask("14 1e0006") == "8604 "


# -- operating ------------------------------------------------------------------------------------------------

STATUSES: dict[str, tuple[str, int, dict[str, Any]]] = {
    "a latch": (crob(2, 3), 0, {"binary_output/2": True}),
    "a latch off": (crob(2, 4), 0, {}),
    "a latch, no time": (crob(2, 3, count=0), 0, {}),
    "a latch with a pulse": (crob(2, 1), 4, {}),
    "a latch with a close": (crob(2, 0x41), 4, {}),
    "a pulse": (crob(6, 1), 0, {"binary_output/6/pulses": 1}),
    "two pulses": (crob(6, 1, count=2), 0, {"binary_output/6/pulses": 2}),
    "a pulse with a latch": (crob(6, 3), 4, {}),
    "a close": (crob(7, 0x41), 0, {"binary_output/7": True}),
    "a trip": (crob(7, 0x81), 0, {}),
    "a trip as a latch": (crob(7, 3), 4, {}),
    "one that is local": (crob(5, 3), 7, {}),
    "one that is missing": (crob(99, 3), 4, {}),
    "a status in the request": (crob(2, 3, status=9), 3, {}),
    "a float": ("29031701 00 00004541 00", 0, {"analog_output/0": 12.3125}),
    "a double": ("29041701 01 0000000000002440 00", 0, {"analog_output/1": 10.0}),
    "a short": ("29021701 01 f6ff 00", 0, {"analog_output/1": -10.0}),
    "a whole number": ("29011701 03 90eefeff 00", 0, {"analog_output/3": -70000}),
    "a float to a whole number": ("29031701 03 00004541 00", 4, {}),
    "a double that no float holds": ("29041701 01 9c7500883ce4377e 00", 12, {}),
    "a float beyond the limit": ("29031701 02 0000ca42 00", 12, {}),
    "the limit": ("29031701 02 0000c842 00", 0, {"analog_output/2": 100.0}),
    "no number": ("29031701 00 0000c07f 00", 12, {}),
    "a missing analog output": ("29031701 04 00000000 00", 4, {}),
}


@pytest.mark.parametrize("name", STATUSES)
@pytest.mark.parametrize("direct", [True, False])
async def test_each_point_of_an_operation_has_its_status(
    device: MockProgram, raw: RawDnp3, name: str, direct: bool
) -> None:
    objects, status, changed = STATUSES[name]
    expected = f"{OK} " + objects.replace(" ", "")[:-2] + f"{status:02x}"
    before = await device.control.points()
    if direct:
        assert await raw.ask("05" + objects) == expected
    else:
        assert await raw.ask("03" + objects) == expected
        assert await device.control.points() == before
        answer = await raw.ask("04" + objects)
        assert answer == (expected if not status else expected[:-2] + "02")
    assert await device.control.points() == {**before, **changed}


LATCH = crob(2, 3)


@pytest.mark.parametrize(
    ("between", "operated", "status"),
    [
        ("", crob(2, 4), 2),
        ("", crob(3, 3), 2),
        ("01 1e0000 0000", LATCH, 2),
    ],
)
async def test_only_what_was_selected_just_before_is_operated(
    device: MockProgram, raw: RawDnp3, between: str, operated: str, status: int
) -> None:
    assert (await raw.ask("03" + LATCH)).endswith("00")
    if between:
        await raw.ask(between)
    assert (await raw.ask("04" + operated))[-2:] == f"{status:02x}"
    assert not (await device.control.points())["binary_output/2"]


async def test_the_sequence_number_of_an_operation_follows_that_of_its_selection(
    device: MockProgram, raw: RawDnp3
) -> None:
    await raw.ask("03" + LATCH, sequence=15)
    assert (await raw.ask("04" + LATCH, sequence=1)).endswith("02")
    await raw.ask("03" + LATCH, sequence=15)
    assert (await raw.ask("04" + LATCH, sequence=0)).endswith("00")
    assert (await device.control.points())["binary_output/2"]


async def test_a_selection_is_over_after_its_time_and_belongs_to_its_connection(
    device: MockProgram, raw: RawDnp3
) -> None:
    await device.control.poke(select_timeout_s=0)
    await raw.ask("03" + LATCH)
    assert (await raw.ask("04" + LATCH)).endswith("01")
    await device.control.poke(select_timeout_s=5)
    await raw.ask("03" + LATCH, sequence=3)
    other = RawDnp3()
    await other.dial(device)
    assert (await other.ask("04" + LATCH, sequence=4)).endswith("02")
    await other.close()
    assert not (await device.control.points())["binary_output/2"]


async def test_the_same_request_again_is_answered_again_and_not_done_again(device: MockProgram, raw: RawDnp3) -> None:
    pulse = crob(6, 1)
    first = await raw.ask("05" + pulse, sequence=4)
    assert await raw.ask("05" + pulse, sequence=4) == first
    assert (await device.control.points())["binary_output/6/pulses"] == 1
    await raw.ask("05" + pulse, sequence=5)
    assert (await device.control.points())["binary_output/6/pulses"] == 2
    asked = await device.control.journal(kind="request")
    assert [entry.get("repeated", False) for entry in asked] == [False, True, False]


async def test_several_points_are_operated_and_too_many_are_not(device: MockProgram, raw: RawDnp3) -> None:
    block = crob(2, 3)[8:]
    several = "0c0117 09" + "".join(f"{index:02x}" + block[6:] for index in (0, 1, 2, 3, 4, 5, 99, 0, 1))
    answer = bytes.fromhex((await raw.ask("05" + several)).split()[1])
    assert [answer[4 + 12 * number + 11] for number in range(9)] == [0, 0, 0, 0, 0, 7, 4, 0, 8]
    held = await device.control.points()
    assert [held[f"binary_output/{index}"] for index in range(6)] == [True] * 5 + [False]


@pytest.mark.parametrize(
    ("request_", "iin"),
    [
        ("05 0c0106", "8004"),
        ("05", "8004"),
        ("05 0c0107 01 03010000000000000000 00", "8004"),
        ("05 0c012801000200030164000000c8000000", "8004"),
        ("05 0c0117 00", "8004"),
        ("05 1e0117 01 00 0100000000", "8002"),
        ("05 0c0217 01 00", "8002"),
        ("02 0a0100 0000 01", "8002"),
        ("02 500100 0707 01", "8004"),
        ("02 500100 0607 00", "8004"),
        ("02 6e0300 0101 616263", "8004"),
        ("02", "8004"),
        ("07 140006", "8001"),
        ("19", "8001"),
    ],
)
async def test_what_cannot_be_done_is_refused_and_changes_nothing(
    device: MockProgram, raw: RawDnp3, request_: str, iin: str
) -> None:
    before = await device.control.image()
    assert await raw.ask(request_) == f"{iin} "
    assert await device.control.image() == before


async def test_local_control_refuses_every_operation_and_says_so(device: MockProgram, raw: RawDnp3) -> None:
    await device.control.poke(local=True)
    assert await raw.ask("05" + LATCH) == "a000 " + LATCH[:-2] + "07"
    await device.control.poke(local=False, trouble=True, needs_time=True)
    assert (await raw.ask("05" + LATCH))[:4] == "d000"


async def test_an_operation_without_a_response_has_none(device: MockProgram, raw: RawDnp3) -> None:
    raw.send("06" + LATCH)
    assert await raw.ask("01 0a0000 0202") == f"{OK} 0a0200020281"
    [asked] = await device.control.journal(state_changing=True)
    assert asked["function"] == 6


# -- writing, time, restart -----------------------------------------------------------------------------------


async def test_the_restart_bit_is_cleared_until_the_next_restart(device: MockProgram, raw: RawDnp3) -> None:
    assert await raw.ask("02 500100 0707 00") == "0000 "
    assert await raw.ask("0d") == "8000 340207010000"
    await raw.ask("02 500100 0707 00")
    asked = await device.control.journal(kind="request")
    assert [entry["state_changing"] for entry in asked] == [False, True, False]


async def test_the_time_is_told_and_taken(device: MockProgram, raw: RawDnp3) -> None:
    await device.control.poke(needs_time=True)
    assert await raw.ask("17") == "9000 340207010000"
    assert (await raw.ask("01 320107 01"))[:13] == "9000 32010701"
    assert await raw.ask("18") == "9000 "
    assert await raw.ask("02 320307 01 000102030405") == "8000 "
    assert await device.control.journal(state_changing=True) == []


async def test_a_text_is_written_as_long_as_it_is(device: MockProgram, raw: RawDnp3) -> None:
    text = "\u05e9" * 100
    raw.send("02 6ec800 0000" + text.encode().hex())
    assert (await raw.fragment())[2:].hex() == "8000"
    assert (await device.control.points())["octet_string/0"] == text
    assert (await raw.ask("01 6e0006"))[:15] == f"{OK} 6ec8000000"
    # A point of its own, by index.
    assert await raw.ask("02 6e0217 01 00 6f6b") == f"{OK} "
    assert (await device.control.points())["octet_string/0"] == "ok"


# -- link layer and transport ---------------------------------------------------------------------------------


async def test_the_check_sum_is_the_known_one() -> None:
    # CRC-16/DNP of the catalogue of parametrised CRC algorithms.
    assert checksum(b"123456789").hex() == "82ea"


async def test_the_link_is_reset_tested_and_tells_its_status(device: MockProgram, raw: RawDnp3) -> None:
    for asked, answer in ((0xC0, 0x00), (0xD2, 0x00), (0xC9, 0x0B), (0xCE, 0x0F)):
        raw.writer.write(link_frame(b"", control=asked))
        assert await raw.frame() == (answer, b"")
    entries = await device.control.journal(kind="link_request")
    assert [(entry["link_function"], entry["request"]) for entry in entries] == [
        (0, False),
        (2, False),
        (9, True),
        (14, False),
    ]


async def test_user_data_that_wants_an_acknowledgement_gets_one(raw: RawDnp3) -> None:
    raw.send("01 1e0000 0101", control=0xF3)
    assert await raw.frame() == (0x00, b"")
    assert (await raw.fragment())[4:].hex() == "1e0100010101ecffffff"


async def test_another_outstation_is_not_there(device: MockProgram, raw: RawDnp3) -> None:
    raw.send("05" + LATCH, destination=11)
    raw.writer.write(link_frame(b"", control=0xC9, destination=11))
    assert await raw.ask("01 0a0000 0202") == f"{OK} 0a0200020201"
    asked = await device.control.journal(destination=11)
    assert [(entry["kind"], entry["request"]) for entry in asked] == [("request", True), ("link_request", True)]


async def test_what_is_for_every_outstation_is_done_and_said_with_the_next_answer(
    device: MockProgram, raw: RawDnp3
) -> None:
    raw.send("05" + LATCH, destination=0xFFFF)
    assert await raw.ask("01 0a0000 0202") == "8100 0a0200020281"
    assert (await raw.ask("01 0a0000 0202"))[:4] == OK


async def test_a_request_comes_in_any_segments_and_from_any_master(device: MockProgram, raw: RawDnp3) -> None:
    long = bytes.fromhex("c001") + bytes.fromhex("1e00000101") * 60
    raw.send_fragment(long)
    assert (await raw.fragment())[4:].hex() == "1e0100010101ecffffff" * 60
    whole = link_frame(b"\xc5" + bytes.fromhex("c2011e00000101"), source=77)
    for part in (whole[:3], whole[3:11], whole[11:]):
        raw.writer.write(part)
        await raw.writer.drain()
    assert (await raw.fragment())[4:].hex() == "1e0100010101ecffffff"
    assert [entry["source"] for entry in await device.control.journal(kind="request")] == [1, 77]


@pytest.mark.parametrize(
    "sent",
    [
        b"\x05\x65",
        bytes.fromhex("056404"),
        link_frame(b"\xc0\xc0\x01")[:-1] + b"\0",
        link_frame(b"")[:-1] + b"\0",
        link_frame(b"\xc0\xc0\x01\x3c\x01\x06", control=0x44),
        link_frame(b""),
        link_frame(b"\x81\xc0\x01"),
        link_frame(b"\xc0\xc0"),
        link_frame(b"\xc0\x80\x01\x3c\x01\x06"),
        link_frame(b"\xc0\xc0\x81\0\0"),
    ],
)
async def test_what_is_no_frame_ends_the_connection(device: MockProgram, sent: bytes) -> None:
    connection = RawDnp3()
    await connection.dial(device)
    connection.writer.write(sent)
    assert await connection.ended()
    await connection.close()
    assert [entry["bytes"] for entry in await device.control.journal(kind="malformed")] == [sent.hex()]


# -- masters of other authors --------------------------------------------------------------------


async def test_opendnp3_polls_selects_and_operates(device: MockProgram) -> None:
    pytest.importorskip("opendnp3")
    master = await asyncio.create_subprocess_exec(
        *(sys.executable, str(Path(__file__).with_name("opendnp3_master.py")), str(device.port)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    said, stderr = await asyncio.wait_for(master.communicate(), 60)
    assert (master.returncode, stderr) == (0, b"")
    told = json.loads(said)
    assert told["results"] == {
        "latch": [[2, "SUCCESS", "SUCCESS"]],
        "missing": [[300, "SELECT_FAIL", "NOT_SUPPORTED"]],
        "local": [[5, "SELECT_FAIL", "LOCAL"]],
        "pulse": [[6, "SUCCESS", "SUCCESS"]],
        "float": [[0, "SUCCESS", "SUCCESS"]],
        "limited": [[2, "SUCCESS", "OUT_OF_RANGE"]],
        "whole": [[3, "SUCCESS", "SUCCESS"]],
    }
    names = {
        "binary_input": "Binary",
        "binary_output": "BinaryOutputStatus",
        "counter": "Counter",
        "analog_input": "Analog",
        "analog_output": "AnalogOutputStatus",
    }
    held = await device.control.points()
    seen = {
        name: told["values"][f"{names[kind]}/{index}"]
        for name in held
        for kind, index, *rest in [name.split("/")]
        if kind in names and not rest
    }
    assert seen == {name: held[name] for name in seen}
    assert len(seen) == 38
    assert (held["analog_output/3"], held["binary_output/6/pulses"]) == (-70000, 1)
    # What it does at the start is housekeeping; what changes the plant are its commands.
    changing = [entry["function"] for entry in await device.control.journal(state_changing=True)]
    assert changing == [3, 4, 3, 3, 5, 3, 4, 5, 3, 4]
    assert {20, 21, 2} <= {entry["function"] for entry in await device.control.journal(kind="request")}
    assert await device.control.journal(kind="malformed") == []


async def test_dnp3py_polls_confirms_and_operates(device: MockProgram) -> None:
    handler = DefaultSOEHandler()
    master = Master(config=MasterConfig(address=3, outstation_address=10), handler=handler)
    async with MasterTcpRunner(master, device.host, device.port, link_reset=LinkResetPolicy.ON_OPEN) as runner:
        await runner.integrity_poll()
        held = await device.control.points()
        assert {index: one.value for index, one in handler.binary_inputs.items()} == {
            index: held[f"binary_input/{index}"] for index in range(16)
        }
        assert {index: one.value for index, one in handler.analog_inputs.items()} == {
            index: held[f"analog_input/{index}"] for index in range(8)
        }
        assert {index: one.value for index, one in handler.counters.items()} == {0: 0, 1: 1000}
        await device.control.poke(point="binary_input/3", value=True)
        (first,) = await runner.class_poll()
        assert first.con
        assert handler.binary_inputs[3].value is True
        (second,) = await runner.class_poll()
        assert not second.con
        builder = master.command_builder()
        builder.add_crob(2, ControlCode.LATCH_ON)
        await runner.request(master.build_select(builder.build_select()))
        assert not (await device.control.points())["binary_output/2"]
        await runner.request(master.build_operate(builder.build_operate()))
    assert (await device.control.points())["binary_output/2"] is True
    assert await device.control.journal(kind="malformed") == []


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
async def test_tshark_finds_nothing_wrong_with_what_the_outstation_sends(
    device: MockProgram, raw: RawDnp3, tmp_path: Path
) -> None:
    await device.control.poke(point="binary_input/3", value=True)
    sent = ["01 3c0206 3c0106", "03" + LATCH, "04" + LATCH, "05" + crob(99, 3), "01 1e0000 0209", "02 500100 0707 00"]
    packets = []
    for request in sent:
        raw.send(request)
        frames = [await raw.frame()]
        while not frames[-1][1][0] & 0x80:
            frames.append(await raw.frame())
        packets += [link_frame(data, control=control, destination=1, source=10) for control, data in frames]
    capture = tmp_path / "sent.pcap"
    capture.write_bytes(
        struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101) + b"".join(map(_captured, _numbered(packets)))
    )
    tshark = await asyncio.create_subprocess_exec(
        *("tshark", "-r", str(capture), "-T", "json"), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    told = (await asyncio.wait_for(tshark.communicate(), 60))[0].decode()
    found = json.loads(told)
    assert [packet["_source"]["layers"]["frame"]["frame.protocols"].split(":")[-1] for packet in found] == [
        "dnp3"
    ] * len(packets)
    assert "malformed" not in told.lower()
    assert told.count('"dnp3.al.obj"') >= 9
    assert "Not Supported" in told or '"dnp3.al.ctrlstatus": "4"' in told


def _numbered(packets: list[bytes]) -> list[tuple[int, bytes]]:
    """Return payloads with the TCP sequence number that each begins with."""
    found, sequence = [], 1
    for payload in packets:
        found.append((sequence, payload))
        sequence += len(payload)
    return found


def _captured(packet: tuple[int, bytes]) -> bytes:
    """Return a record of a capture file: raw IP, TCP from port 20000, no check sums."""
    sequence, payload = packet
    tcp = struct.pack(">HHIIBBHHH", 20000, 40000, sequence, 1, 0x50, 0x18, 1024, 0, 0) + payload
    ip = struct.pack(">BBHHHBBHII", 0x45, 0, 20 + len(tcp), 1, 0, 64, 6, 0, 0x7F000001, 0x7F000001)
    return struct.pack("<IIII", 0, sequence, len(ip + tcp), len(ip + tcp)) + ip + tcp


# -- malformed input ------------------------------------------------------------------------------------------


async def test_noise_never_stops_the_outstation_and_moves_nothing(device: MockProgram, raw: RawDnp3) -> None:
    chance = random.Random(20261123)
    before = await device.control.points()
    seeds = [bytes.fromhex("c0" + text) for text in ("011e00000007", "013c0206", "0214", "17", "032903", "011e0228")]
    for number in range(200):
        connection = RawDnp3()
        await connection.dial(device)
        if number % 4 == 0:
            connection.writer.write(chance.randbytes(chance.randrange(1, 600)))
        else:
            fragment = bytearray(chance.choice(seeds) + chance.randbytes(chance.randrange(12)))
            for _ in range(chance.randrange(1, 4)):
                # The function stays one that moves nothing by itself.
                fragment[chance.randrange(2, len(fragment) + 1) - 1 if len(fragment) > 2 else 0] = chance.randrange(256)
            fragment[1] = chance.choice((1, 1, 2, 3, 20, 21, 23, 7, 25, 100))
            data = bytes([0xC0 | number & 0x3F]) + bytes(fragment)
            connection.writer.write(link_frame(data, control=0xC4 if number % 4 == 1 else chance.randrange(256)))
        await connection.close()
    await device.control.wait(kind="DISCONNECTED", count=200)
    assert (await raw.ask("01 1e0000 0101")).endswith("ecffffff")
    after = await device.control.points()
    assert {name: after[name] for name in before if "octet" not in name} == {
        name: before[name] for name in before if "octet" not in name
    }


# -- faults ---------------------------------------------------------------------------------------------------

READ = "01 1e0000 0101"
OBJECTS = "1e01000101 01ecffffff"
FALSE_ANSWERS: dict[str, tuple[dict[str, Any], str]] = {
    "refused": ({"iin": 0x0400}, "c381 8004"),
    "an indication": ({"with_iin": 0x0040}, f"c381 c000 {OBJECTS}"),
    "a sequence number": ({"sequence": 1}, f"c481 8000 {OBJECTS}"),
    "another index": ({"answer_index": 1}, "c381 8000 1e01000202 01ecffffff"),
    "other objects": ({"answer_objects": "1e0100010101"}, "c381 8000 1e0100010101"),
    "no objects": ({"answer_objects": ""}, "c381 8000"),
}


@pytest.mark.parametrize("name", FALSE_ANSWERS)
async def test_an_answer_is_falsified_and_the_journal_has_what_was_sent(
    device: MockProgram, raw: RawDnp3, name: str
) -> None:
    action, expected = FALSE_ANSWERS[name]
    await device.control.fault(action, function=1, group=30, index=1, times=1)
    raw.send("01 1e0000 0000", sequence=2)
    assert (await raw.fragment()).hex() == "c28180001e0100000001" + "64000000"
    raw.send(READ, sequence=3)
    assert (await raw.fragment()).hex() == expected.replace(" ", "")
    [_, asked] = await device.control.journal(kind="request")
    [_, answer] = await device.control.journal(kind="response")
    assert (asked["fault"], answer["answers"]) == (action, asked["seq"])
    assert answer["apdu"] == expected.replace(" ", "")
    raw.send(READ, sequence=3)
    assert (await raw.fragment()).hex() == f"c3818000{OBJECTS}".replace(" ", "")


async def test_an_operation_has_another_status_or_is_acknowledged_and_not_done(
    device: MockProgram, raw: RawDnp3
) -> None:
    await device.control.fault({"status": 6}, function=4)
    await raw.ask("03" + LATCH)
    assert (await raw.ask("04" + LATCH)).endswith("06")
    await device.control.fault({"ack_only": True})
    assert (await raw.ask("05" + LATCH)).endswith("00")
    assert await raw.ask("02 6e0217 01 00 6f6b") == f"{OK} "
    held = await device.control.points()
    assert (held["binary_output/2"], held["octet_string/0"]) == (False, "ready")


async def test_an_unsolicited_response_comes_before_the_answer(device: MockProgram, raw: RawDnp3) -> None:
    await device.control.fault({"unsolicited": True}, times=2)
    for events in (0, 1):
        if events:
            await device.control.poke(point="binary_input/3", value=True)
        raw.send(READ)
        first = await raw.fragment()
        assert (first[1], bool(first[4:])) == (130, bool(events))
        assert (await raw.fragment())[1] == 129
    await device.control.poke(unsolicited=[1, 2])
    assert (await raw.fragment())[9:12].hex() == "030081"


async def test_an_event_that_is_told_unasked_is_not_told_by_the_answer_to_a_poll_as_well(
    device: MockProgram, raw: RawDnp3
) -> None:
    await device.control.poke(point="binary_input/3", value=True)
    await device.control.fault({"unsolicited": True}, times=1)
    raw.send("01 3c0206")
    told, answer = await raw.fragment(), await raw.fragment()
    assert (told[1], told[9:12].hex()) == (130, "030081")
    assert (answer[1], answer[4:]) == (129, b"")
    # Without a confirmation it is told again by a later poll.
    async with asyncio.timeout(10):
        while not (events := (await raw.ask("01 3c0206"))[5:]):
            pass
    assert events[:2] == "02"


async def test_an_answer_is_dropped_delayed_cut_or_replaced(device: MockProgram, raw: RawDnp3) -> None:
    actions: list[dict[str, Any]] = [{"drop": True}, {"delay_s": 0.6}, {"truncate": 9}, {"garbage": True}]
    await device.control.ask("fault", rules=[{"times": 1, "action": action} for action in actions])
    for sequence in range(1, 6):
        raw.send(READ, sequence=sequence)
    assert (await raw.take(9))[:3].hex() == "056414"
    assert await raw.take(8) == b"\xde\xad\xbe\xef\xff\xff\x00\x01"
    assert (await raw.fragment())[0] == 0xC5
    assert (await raw.fragment())[0] == 0xC2


async def test_a_frame_has_another_length_or_sender(device: MockProgram, raw: RawDnp3) -> None:
    await device.control.ask("fault", rules=[{"times": 1, "action": {"length": 2, "answer_source": 11}}])
    raw.send(READ)
    # 05 64, a length that is two too long, control, destination 1, source 11.
    assert (await raw.take(8)).hex() == "0564164401000b00"


async def test_the_status_of_the_link_is_late_or_lost(device: MockProgram, raw: RawDnp3) -> None:
    await device.control.ask("fault", rules=[{"times": 1, "action": {"drop": True}}, {"action": {"delay_s": 0.05}}])
    for _ in range(2):
        raw.writer.write(link_frame(b"", control=0xC9))
    assert await raw.frame() == (0x0B, b"")
    asked = await device.control.journal(kind="link_request")
    [answer] = await device.control.journal(kind="link_answer")
    assert answer["answers"] == asked[1]["seq"]


@pytest.mark.parametrize("action", [{"close": True}, {"reset": True}])
async def test_the_connection_ends_instead_of_an_answer(
    device: MockProgram, raw: RawDnp3, action: dict[str, Any]
) -> None:
    await device.control.fault(action, times=1)
    raw.send("05" + LATCH)
    assert await raw.ended()
    assert (await device.control.points())["binary_output/2"]


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"point": "analog_input/8", "value": 1}, "no point 'analog_input/8'"),
        ({"point": "analog_input/1", "value": 1.5}, "holds values of the kind int32, not 1.5"),
        ({"point": "analog_input/1", "value": 2**31}, "not 2147483648"),
        ({"point": "binary_input/1", "value": 1}, "of the kind bool"),
        ({"point": "analog_output/0", "value": 1e39}, "of the kind float"),
        ({"point": "octet_string/0", "value": ""}, "of the kind octets"),
        ({"point": "analog_input/1", "flags": ["FINE"]}, "a list of ONLINE"),
        ({"unsolicited": [4]}, "classes from 1 to 3"),
        ({"local": 1}, "true or false"),
    ],
)
async def test_a_poke_that_is_not_understood_is_refused(
    device: MockProgram, params: dict[str, Any], words: str
) -> None:
    with pytest.raises(RefusedError, match=words):
        await device.control.ask("poke", params=params)
