"""The PROFIBUS segment against an independent master, byte vectors, faults, and bytes that mean nothing."""

from __future__ import annotations

import asyncio
import json
import os
import random
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pytest
from mock_program import PATIENCE_S, MockProgram
from profibus_tools import Master, request
from pytest_otmcp.mocks.profibus.receiver import Receiver

pytestmark = pytest.mark.asyncio(loop_scope="module")
MOCK = "profibus"

LONG = "ff64"
"""Factors of a watchdog of 255 s."""
STATION_5 = {"ident": "809c", "cfg": "1121"}


@pytest.fixture
def master(device: MockProgram) -> Iterator[Master]:
    opened = Master(device)
    yield opened
    opened.close()


async def points(device: MockProgram, station: int, which: str) -> list[int]:
    found: dict[str, int] = (await device.control.image())["points"]
    return [value for name, value in found.items() if name.startswith(f"{station}.{which}.")]


async def state(device: MockProgram, station: int) -> tuple[str, int | None]:
    found = (await device.control.image())["stations"][str(station)]
    return found["state"], found["master"]


# Telegrams of public manuals and of the standard's own forms; requests that no master has prepared a slave for.
VECTORS = {
    "FDL status": ("100502495016", "100205000716"),
    "diagnosis of a slave that waits for parameters": ("6805056885824d3c3ece16", "680b0b688285083e3c020500ff809cab16"),
    "diagnosis of a slave of another master": ("6805056889824d3c3ed216", "680b0b688289083e3c0004000380b1c516"),
    "inputs": ("6805056885824d383eca16", "680707688285083e3802d55c16"),
    "outputs": ("6805056885824d393ecb16", "680707688285083e3900008616"),
    "configuration": ("6805056888824d3b3ed016", "680707688288083e3b1727c916"),
    "parameters": ("680c0c6885825d3d3e881e0100809c01a316", "e5"),
    "parameters for a slave of another master are not taken": (request(9, 61, "88ff640080b100").hex(), "e5"),
    "a configuration without parameters": (request(5, 62, "1121").hex(), "100205030a16"),
    "an exchange without parameters": ("6805056805027d1234ca16", "100205030a16"),
    "an exchange with a slave of another master": (request(9, None, "00").hex(), "100209030e16"),
    "an address cannot be changed": (request(5, 55, "07809c00").hex(), "100205030a16"),
    "an access point that it does not have": (request(5, 33, "00").hex(), "100205030a16"),
    "an access point of a master that is none": (request(5, 60, ssap=61).hex(), "100205030a16"),
    "a request of another function": (request(5, None, control=0x4E).hex(), "100205030a16"),
    "parameters in a telegram of fixed length": ("a285824d3d3e88ff6400809cd616", "e5"),
}


@pytest.mark.parametrize("name", VECTORS)
async def test_a_telegram_gets_the_answer_of_the_standard(master: Master, name: str) -> None:
    asked, answer = VECTORS[name]
    assert await master.ask(bytes.fromhex(asked)) == answer


async def test_a_master_parameterises_configures_and_exchanges(device: MockProgram, master: Master) -> None:
    assert await master.ask(request(5, 61, f"88{LONG}00809c01")) == "e5"
    assert await state(device, 5) == ("wait_cfg", 2)
    assert await master.ask(request(5, 60)) == "680b0b688285083e3c020c0002809cb516"
    assert await master.ask(request(5, 62, "1121")) == "e5"
    assert await state(device, 5) == ("data_exchange", 2)
    assert await master.ask(bytes.fromhex("6805056805027d1234ca16")) == "6805056802050802d5e616"
    assert await points(device, 5, "output") == [0x12, 0x34]
    assert await master.ask(request(5, 57)) == "680707688285083e391234cc16"


@pytest.mark.parametrize(
    ("telegrams", "diagnosis"),
    [
        ([request(5, 61, f"88{LONG}00809d00")], "420500ff809c"),
        ([request(5, 61, "88000000809c00")], "420500ff809c"),
        ([request(5, 61, "88ff64")], "420500ff809c"),
        ([request(5, 61, f"a8{LONG}00809c00")], "120500ff809c"),
        ([request(5, 61, f"88{LONG}00809c00"), request(5, 62, "1122")], "060500ff809c"),
        ([request(5, 61, f"88{LONG}00809c00"), request(5, 62, "1121"), request(5, None, "010203")], "060500ff809c"),
        ([request(5, 61, f"88{LONG}00809c00"), request(5, 61, f"48{LONG}00809c00")], "020500ff809c"),
        ([request(5, 61, f"80{LONG}00809c00")], "02040002809c"),
        ([request(5, 61, f"08{LONG}00809c00")], "020500ff809c"),
    ],
    ids=[
        "another ident number",
        "a watchdog of no time",
        "too few parameters",
        "sync is not supported",
        "another configuration",
        "outputs of another length",
        "unlocked again",
        "without a watchdog",
        "neither locked nor unlocked",
    ],
)
async def test_the_diagnosis_says_what_is_wrong(master: Master, telegrams: list[bytes], diagnosis: str) -> None:
    for telegram in telegrams:
        await master.ask(telegram)
    assert diagnosis in await master.ask(request(5, 60))


async def test_a_slave_answers_no_other_master_until_it_is_free(device: MockProgram, master: Master) -> None:
    await master.exchange(5, "0102", **STATION_5)
    assert await master.ask(request(5, None, "0506", source=4)) == "100405030c16"
    assert await master.ask(request(5, 62, "1121", source=4)) == "100405030c16"
    assert await master.ask(request(5, 61, f"88{LONG}00809c00", source=4)) == "e5"
    assert await state(device, 5) == ("data_exchange", 2)
    assert await points(device, 5, "output") == [1, 2]
    changing = await device.control.journal(state_changing=True)
    assert [(entry["service"], entry["master"]) for entry in changing] == [
        ("data_exchange", 2),
        ("data_exchange", 4),
        ("chk_cfg", 4),
        ("set_prm", 4),
    ]


async def test_outputs_that_are_not_repeated_fall_at_the_watchdog(device: MockProgram, master: Master) -> None:
    # A second.
    await master.exchange(5, "1234", **STATION_5, watchdog="6401")
    (fallen,) = await device.control.wait(kind="watchdog")
    assert (fallen["station"], fallen["outputs"], fallen["origin"]) == (5, "1234", "plant")
    assert await points(device, 5, "output") == [0, 0]
    assert await state(device, 5) == ("wait_prm", None)
    assert await master.ask(request(5, None, "1234")) == "100205030a16"


async def test_outputs_are_held_while_their_master_repeats_them(device: MockProgram, master: Master) -> None:
    await master.exchange(5, "1234", **STATION_5, watchdog="6401")
    loop = asyncio.get_running_loop()
    end = loop.time() + 1.5
    while loop.time() < end:
        assert await master.ask(request(5, None, "1234")) == "6805056802050802d5e616"
    assert await device.control.journal(kind="watchdog") == []
    assert await points(device, 5, "output") == [0x12, 0x34]


async def test_an_exchange_that_says_nothing_new_is_not_in_the_journal(device: MockProgram, master: Master) -> None:
    await master.exchange(5, "1234", **STATION_5)
    for _ in range(3):
        await master.ask(request(5, None, "1234"))
    await device.control.ask("poke", params={"station": 5, "inputs": "0001"})
    for _ in range(3):
        assert "080001" in await master.ask(request(5, None, "1234"))
    told = [entry for entry in await device.control.journal(direction="in") if entry["service"] == "data_exchange"]
    assert [(entry["kind"], entry["request"], entry["state_changing"]) for entry in told] == [
        ("request", True, True),
        ("cycle", False, False),
    ]


async def test_a_global_control_clears_the_outputs_of_the_masters_own_slaves(
    device: MockProgram, master: Master
) -> None:
    await master.exchange(5, "1234", **STATION_5)
    await device.control.ask("poke", params={"station": 9, "outputs": "07"})
    master.send(request(127, 58, "0200", source=4, control=0x46))
    assert await master.ask(request(5, 57)) == "680707688285083e391234cc16"
    master.send(request(127, 58, "0200", control=0x46))
    assert await master.ask(request(5, 57)) == "680707688285083e3900008616"
    assert await points(device, 9, "output") == [7]
    told = await device.control.journal(service="global_control")
    assert [entry["state_changing"] for entry in told] == [True, False]


async def test_a_master_that_clears_a_slave_which_was_restarted_leaves_it_in_order(
    device: MockProgram, master: Master
) -> None:
    await master.exchange(5, "1234", **STATION_5)
    await device.control.ask("reset")
    master.send(request(5, 58, "0200", control=0x46))
    master.send(request(8, 58, "0200", control=0x46))
    told = await device.control.journal(service="global_control")
    assert [(entry["station"], entry["state_changing"]) for entry in told] == [(5, False), (8, True)]


async def test_a_diagnosis_is_announced_until_the_owner_has_fetched_it(device: MockProgram, master: Master) -> None:
    await master.exchange(5, "1234", **STATION_5)
    await device.control.ask("poke", params={"station": 5, "diagnosis": "0399"})
    assert await master.ask(request(5, None, "1234")) == "6805056802050a02d5e816"
    assert await master.ask(request(5, 60)) == "680d0d688285083e3c080c0002809c03995716"
    assert await master.ask(request(5, None, "1234")) == "6805056802050802d5e616"


async def test_a_telegram_that_repeats_the_frame_count_bit_is_answered_again_and_not_executed(
    device: MockProgram, master: Master
) -> None:
    await master.exchange(5, "0102", **STATION_5)
    first, again = request(5, None, "0304", control=0x6D), request(5, None, "0506", control=0x7D)
    answer = await master.ask(first)
    assert await master.ask(again) == answer
    assert await points(device, 5, "output") == [3, 4]
    await master.ask(request(5, None, "0506", control=0x5D))
    assert await points(device, 5, "output") == [5, 6]
    sent = await device.control.journal(service="data_exchange", request=True)
    assert [(entry.get("repeated", False), entry["state_changing"]) for entry in sent] == [
        (False, True),
        (False, True),
        (True, False),
        (False, True),
    ]


async def test_a_station_that_is_not_there_is_silent_and_the_journal_has_the_request(
    device: MockProgram, master: Master
) -> None:
    master.send(request(77, None, control=0x49))
    await device.control.ask("poke", params={"station": 8, "present": False})
    master.send(request(8, None, control=0x49))
    # The answer to a later request is the first that comes.
    assert await master.ask(request(5, None, control=0x49)) == "100205000716"
    assert [entry["station"] for entry in await device.control.journal(service="fdl_status", request=True)] == [
        77,
        8,
        5,
    ]


async def test_tokens_and_answers_of_others_ask_for_nothing(device: MockProgram, master: Master) -> None:
    for telegram in ("dc0302", "e5", "100205000716"):
        master.send(bytes.fromhex(telegram))
    await master.ask(request(5, None, control=0x49))
    told = await device.control.journal(direction="in")
    assert [(entry["kind"], entry["request"]) for entry in told] == [
        ("token", False),
        ("message", False),
        ("message", False),
        ("request", True),
    ]


READ = request(5, 56)
ANSWER = "680707688285083e3802d55c16"


@pytest.mark.parametrize(
    ("action", "answer"),
    [
        ({"error": 1}, "100205010816"),
        ({"error": 3}, "100205030a16"),
        ({"answer_station": 6}, "680707688286083e3802d55d16"),
        ({"answer_master": 7}, "680707688785083e3802d56116"),
        ({"answer_data": "0102"}, "680707688285083e3801028816"),
        ({"answer_data": "010203"}, "680808688285083e380102038b16"),
        ({"delay_s": 0.01}, ANSWER),
        ({"drip_s": 0.001}, ANSWER),
    ],
)
async def test_a_rule_falsifies_an_answer(
    device: MockProgram, master: Master, action: dict[str, Any], answer: str
) -> None:
    await device.control.ask("fault", rules=[{"service": "rd_inp", "station": 5, "times": 1, "action": action}])
    assert await master.ask(READ) == answer
    assert await master.ask(READ) == ANSWER
    assert await device.control.ask("fault", rules=[]) == {"hits": [1]}


@pytest.mark.parametrize(
    ("action", "held", "answers"),
    [
        ({"ack_only": True}, [0, 0], 1),
        ({"drop": True}, [1, 2], 0),
        ({"lose": True}, [0, 0], 0),
        ({"duplicate": True}, [1, 2], 2),
        ({"error": 2}, [0, 0], 1),
    ],
)
async def test_a_rule_decides_what_a_write_does(
    device: MockProgram, master: Master, action: dict[str, Any], held: list[int], answers: int
) -> None:
    await master.exchange(5, "0000", **STATION_5)
    await device.control.ask("fault", rules=[{"changes": True, "action": action}])
    master.send(request(5, None, "0102"))
    master.send(request(5, None, control=0x49))
    got = [(await master.telegram()).hex()]
    while got[-1] != "100205000716":
        got.append((await master.telegram()).hex())
    assert len(got) - 1 == answers
    assert await points(device, 5, "output") == held
    (asked,) = await device.control.journal(state_changing=True)
    assert asked["fault"] == action


async def test_what_is_no_answer_is_in_the_journal_as_it_was_sent(device: MockProgram, master: Master) -> None:
    rules: list[dict[str, Any]] = [{"garbage": True}, {"truncate": 3}, {"mangle": {"flip": [[0, 1]]}}]
    await device.control.ask("fault", rules=[{"times": 1, "action": action} for action in rules])
    got = []
    for length in (8, 3, 13):
        master.send(READ)
        got.append((await master.take(length)).hex())
    entries = await device.control.journal(direction="out")
    assert [(entry["kind"], entry["answers"], entry["bytes"]) for entry in entries] == [
        ("garbage", None, got[0]),
        ("mangled", None, got[1]),
        ("mangled", None, got[2]),
    ]


async def test_a_black_hole_loses_and_a_stalled_line_delays(device: MockProgram, master: Master) -> None:
    await device.control.ask("poke", params={"network": "black_hole"})
    master.send(READ)
    await device.control.wait(kind="lost", count=1)
    await device.control.ask("poke", params={"network": "stalled"})
    master.send(request(8, None, control=0x49))
    await device.control.ask("journal", since=0)
    assert master.nothing_came()
    await device.control.ask("poke", params={"network": "open"})
    assert (await master.telegram()).hex() == "100208000a16"
    assert [entry["station"] for entry in await device.control.journal(request=True)] == [8]


async def test_what_a_stopped_segment_did_not_hear_is_never_executed(device: MockProgram, master: Master) -> None:
    await master.exchange(5, "0102", **STATION_5)
    device.say("stop")
    assert (await device.event())["event"] == "stopped"
    master.send(request(5, 61, f"88{LONG}00809c00"))
    device.say("start")
    await device.ready()
    assert "020500ff809c" in await master.ask(request(5, 60))
    assert await points(device, 5, "output") == [0, 0]
    assert [entry["service"] for entry in await device.control.journal(request=True)] == ["slave_diag"]


async def test_a_telegram_may_come_in_pieces() -> None:
    telegrams: list[bytes] = []
    malformed: list[str] = []
    receiver = Receiver(telegrams.append, lambda raw, reason: malformed.append(reason))
    for byte in READ * 2:
        receiver.feed(bytes([byte]))
    assert (telegrams, malformed) == ([READ, READ], [])


async def test_a_telegram_that_does_not_end_is_given_up(device: MockProgram, master: Master) -> None:
    master.send(READ[:-1])
    (entry,) = await device.control.wait(kind="malformed")
    assert entry["reason"] == "the rest of the telegram did not come"
    assert await master.ask(READ) == ANSWER


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (READ[:-2] + bytes([READ[-2] ^ 1]) + READ[-1:], "the checksum is CB, not CA"),
        (READ[:-1] + b"\x17", "the end delimiter is 17"),
        (b"\x68\x05\x06\x68", "no header of a telegram with data: 68 05 06 68"),
        (b"\x55", "no telegram begins with 55"),
        (bytes.fromhex("68040468 850249 d4 a4 16"), "an address extension that is no service access point"),
    ],
)
async def test_a_telegram_that_is_none_is_not_answered(
    device: MockProgram, master: Master, raw: bytes, reason: str
) -> None:
    master.send(raw)
    (entry,) = await device.control.wait(kind="malformed")
    assert (entry["reason"], entry["bytes"]) == (reason, raw.hex())
    assert await master.ask(READ) == ANSWER


async def test_bytes_that_mean_nothing_are_survived_and_change_nothing(device: MockProgram, master: Master) -> None:
    rng = random.Random(20261123)
    start = (await device.control.image())["points"]
    seeds = [bytes.fromhex(asked) for asked, _ in VECTORS.values()]
    for _ in range(300):
        data = bytearray(rng.choice(seeds))
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        if rng.random() < 0.5 and len(data) > 6:
            data[-2] = sum(data[4:-2]) & 0xFF
        master.send(bytes(data))
        if rng.random() < 0.05:
            await device.control.next()
    # No telegram is longer than these zeros, and none begins with one: an unfinished one is over.
    mark = await device.control.next()
    master.send(bytes(260))
    await device.control.wait(mark, kind="malformed")
    master.drop()
    assert await master.ask(READ) == ANSWER
    assert (await device.control.image())["points"] == start


async def test_a_client_is_the_process_that_has_the_terminal_open(device: MockProgram, master: Master) -> None:
    await master.ask(READ)
    whole = await device.control.ask("journal", since=0)
    (number,) = {entry["connection"] for entry in whole["records"]}
    assert whole["peers"][str(number)]["process"]["pid"] == os.getpid()


# -- another author's master ----------------------------------------------------------------------------------


def _has_pyprofibus() -> bool:
    try:
        return bool(version("pyprofibus"))
    except PackageNotFoundError:
        return False


HERE = Path(__file__).parent / "pyprofibus_plant"


@pytest.mark.skipif(not _has_pyprofibus(), reason="pyprofibus is not installed; it is in the extra dev")
async def test_pyprofibus_parameterises_exchanges_and_is_told_of_a_watchdog(
    device: MockProgram, tmp_path: Path
) -> None:
    configuration = tmp_path / "master.conf"
    configuration.write_text(
        f"[PROFIBUS]\ndebug=0\n[PHY]\ntype=serial\ndev={device.ready_event['endpoints']['profibus']['path']}\nbaud=19200\n"
        f"[DP]\nmaster_class=1\nmaster_addr=2\n[SLAVE_0]\nname=five\naddr=5\ngsd={HERE / 'station5.gsd'}\n"
        "sync_mode=0\nfreeze_mode=0\ngroup_mask=1\nwatchdog_ms=1000\nmodule_0=2 bytes in\nmodule_1=2 bytes out\n"
        "input_size=2\noutput_size=2\ndiag_period=0\n"
    )
    pins = {f"slave.5.{way}.u16.0.active": 1 for way in ("mosi", "miso")} | {"slave.5.mosi.u16.0": 0x1234}
    program = Path(sys.executable).parent / "pyprofibus-linuxcnc-hal"
    environment = os.environ | {"PYTHONPATH": str(HERE), "PROFIBUS_PINS": json.dumps(pins), "PYTHONUNBUFFERED": "1"}
    process = await asyncio.create_subprocess_exec(
        sys.executable, program, "--watchdog", "off", configuration, env=environment, stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    try:
        async with asyncio.timeout(PATIENCE_S):
            while (line := await process.stdout.readline()) != b'{"slave.5.miso.u16.0": 725}\n':
                assert line, "it has ended"
            assert await points(device, 5, "output") == [0x12, 0x34]
            await device.control.ask("poke", params={"station": 5, "inputs": "0007"})
            while (line := await process.stdout.readline()) != b'{"slave.5.miso.u16.0": 7}\n':
                assert line, "it has ended"
    finally:
        process.kill()
        await process.wait()
    (fallen,) = await device.control.wait(kind="watchdog", station=5)
    assert fallen["outputs"] == "1234"
    services = [entry.get("service") for entry in await device.control.journal(request=True)]
    assert {"fdl_status", "slave_diag", "set_prm", "chk_cfg", "data_exchange"} <= set(services)
    assert await device.control.journal(kind="malformed") == []


# What the master of profirust 0.6.0 sends at the address 2, with the highest address 3, and the answers to it, as recorded on this line: tokens to
# itself, FDL status of the addresses between it and itself, a slave in every state. The watchdog is one of 601 s.
PROFIRUST_STARTS = """
dc0202
dc0202
6805056885826c3c3eed16 680b0b688285083e3c020500ff809cab16
100002494b16
dc0202
68070768ff82443a3e00003d16
6805056888826c3c3ef016 680b0b688288083e3c020500ff80a5b716
100102494c16
dc0202
680d0d6885825c3d3e88ecff0b809c00007816 e5
680d0d6888825c3d3e88ecff0b80a500008416 e5
dc0202
6807076885827c3e3e11213116 e5
6807076888827c3e3e17274016 e5
dc0202
6805056885825c3c3edd16 680b0b688285083e3c000c0002809cb316
6805056888825c3c3ee016 680b0b688288083e3c000c000280a5bf16
dc0202
6805056805027d00008416 6805056802050802d5e616
a208027d00000000000000008716 680b0b6802080800000000000000001216
dc0202
6805056805025d1234aa16 6805056802050802d5e616
a208025d01020304050607088b16 680b0b6802080800000000000000001216
"""
PROFIRUST_READS = """
dc0202
6805056805027d1234ca16 6805056802050800071616
a208027d0102030405060708ab16 680b0b6802080800000000000000001216
"""
PROFIRUST_IS_TOLD = """
dc0202
6805056805025d1234aa16 6805056802050a00071816
a208025d01020304050607088b16 680b0b6802080800000000000000001216
dc0202
6805056885827c3c3efd16 680d0d688285083e3c080c0002809c03995716
a208027d0102030405060708ab16 680b0b6802080800000000000000001216
dc0202
6805056805025d1234aa16 6805056802050800071616
"""


async def played(master: Master, recorded: str) -> None:
    """Send what is recorded, and compare the answers; who is not to answer would do so before the next that is."""
    for line in recorded.split("\n"):
        asked, *answers = line.split() or [""]
        master.send(bytes.fromhex(asked))
        for answer in answers:
            assert (asked, (await master.telegram()).hex()) == (asked, answer)


async def test_profirust_brings_two_slaves_to_data_exchange_and_fetches_a_diagnosis(
    device: MockProgram, master: Master
) -> None:
    await played(master, PROFIRUST_STARTS)
    for station, held in ((5, [0x12, 0x34]), (8, [1, 2, 3, 4, 5, 6, 7, 8])):
        assert await state(device, station) == ("data_exchange", 2)
        assert await points(device, station, "output") == held
    await device.control.ask("poke", params={"station": 5, "inputs": "0007"})
    await played(master, PROFIRUST_READS)
    await device.control.ask("poke", params={"station": 5, "diagnosis": "0399"})
    await played(master, PROFIRUST_IS_TOLD)
    asked = await device.control.journal(direction="in")
    assert [(entry["kind"], entry["service"], entry["station"]) for entry in asked if entry["kind"] != "token"] == [
        ("request", "slave_diag", 5),
        ("request", "fdl_status", 0),
        ("request", "global_control", 127),
        ("request", "slave_diag", 8),
        ("request", "fdl_status", 1),
        *[("request", service, at) for service in ("set_prm", "chk_cfg", "slave_diag") for at in (5, 8)],
        ("cycle", "data_exchange", 5),
        ("cycle", "data_exchange", 8),
        ("request", "data_exchange", 5),
        ("request", "data_exchange", 8),
        # From here on the outputs are repeated: what is told are inputs that are new, and a diagnosis that is announced.
        ("cycle", "data_exchange", 5),
        ("cycle", "data_exchange", 5),
        ("request", "slave_diag", 5),
        ("cycle", "data_exchange", 5),
    ]
    changing = [entry for entry in asked if entry["state_changing"]]
    assert [(entry["station"], entry["data"]) for entry in changing] == [(5, "1234"), (8, "0102030405060708")]
    tokens = [entry["telegram"] for entry in asked if entry["kind"] == "token"]
    assert tokens == ["dc0202"] * (PROFIRUST_STARTS + PROFIRUST_READS + PROFIRUST_IS_TOLD).count("dc0202")


async def test_profirust_that_repeats_the_frame_count_bit_for_a_diagnosis_gets_the_lost_answer_as_it_was(
    device: MockProgram, master: Master
) -> None:
    await played(master, PROFIRUST_STARTS)
    await device.control.ask("fault", rules=[{"station": 8, "times": 2, "action": {"drop": True}}])
    exchange, diagnosis = "a208027d0102030405060708ab16", "6805056888827c3c3e0016"
    answer = "680b0b6802080800000000000000001216"
    # Its two attempts are lost, and it takes the slave for gone. It asks whether it is back without beginning a new sequence: inputs
    # that came with the access points of a diagnosis would be one, of another device.
    await played(master, f"{exchange}\n{exchange}\n{diagnosis} {answer}\n{diagnosis} {answer}")
    sent = await device.control.journal(direction="in", station=8)
    assert [(entry["kind"], entry["service"], entry.get("repeated", False)) for entry in sent[-4:]] == [
        ("cycle", "data_exchange", False),
        ("cycle", "data_exchange", True),
        ("request", "slave_diag", True),
        ("request", "slave_diag", True),
    ]
    # An FDL status is of no sequence, and ends this one.
    assert await master.ask(request(8, None, control=0x49)) == "100208000a16"
    assert "000c000280a5" in await master.ask(bytes.fromhex(diagnosis))
