"""The control channel and the journal, on the Modbus mock; every mock uses the same code.

The duties of each device are in ``test_device_contract``.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from typing import Any

import pytest
from mock_program import PATIENCE_S, Control, MockProgram
from pytest_otmcp.mocks.device import Device, Simulation
from pytest_otmcp.mocks.journal import Journal

pytestmark = pytest.mark.asyncio

READ_HR_0 = bytes.fromhex("0001 0000 0006 01 03 0000 0001")


async def exchange(modbus: MockProgram, request: bytes = READ_HR_0) -> None:
    reader, writer = await asyncio.open_connection(modbus.host, modbus.port)
    writer.write(request)
    await reader.readexactly(9)
    writer.close()


async def test_answers_carry_the_ids_of_pipelined_requests(modbus: MockProgram) -> None:
    results = await asyncio.gather(*(modbus.control.ask(op) for op in ("image", "ready", "reset") * 20))
    assert [set(result) for result in results] == [
        {"units", "points"},
        {"protocol", "port", "pid"},
        {"dead_connections"},
    ] * 20


async def test_requests_of_one_client_are_done_in_order(modbus: MockProgram) -> None:
    def put(value: int) -> Any:
        params = {"table": "holding_registers", "address": 50, "values": [value]}
        # The word "wait" in a request does not make it a wait.
        return modbus.control.ask("poke", params=params, note='"wait"')

    *_, image = await asyncio.gather(*(put(value) for value in range(50)), modbus.control.image())
    assert image["units"]["1"]["holding_registers"][50] == 49


async def test_several_clients_see_the_same_device(modbus: MockProgram) -> None:
    others = [await modbus.connect_control() for _ in range(5)]
    await modbus.control.ask("poke", params={"table": "coils", "address": 9, "values": [True]})
    for other in others:
        assert (await other.image())["units"]["1"]["coils"][9] is True


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("this is no JSON", "unknown op None"),
        ("[]", "unknown op None"),
        ("[" * 100_000, "unknown op None"),
        ('{"id": 1}', "unknown op None"),
        ('{"id": 1, "op": "reboot"}', "unknown op 'reboot'; known are ready, image"),
        ('{"id": 1, "op": ["image"]}', "unknown op ['image']"),
        ('{"id": 1, "op": "tick", "steps": "x"}', "steps: expected int, found 'x'"),
        ('{"id": 1, "op": "tick", "steps": true}', "steps: expected int, found True"),
        ('{"id": 1, "op": "journal"}', "since: expected int, found None"),
        ('{"id": 1, "op": "wait", "since": 0}', "timeout_s: expected float, found None"),
        ('{"id": 1, "op": "poke"}', "params: expected dict, found None"),
        ('{"id": 1, "op": "poke", "params": {}}', "the poke lacks 'table'"),
        ('{"id": 1, "op": "fault", "rules": [1]}', "every fault rule is an object"),
        ('{"id": 1, "op": "fault", "rules": [{}]}', "a fault rule needs an action"),
    ],
)
async def test_what_is_no_request_is_answered_with_a_sentence(modbus: MockProgram, line: str, words: str) -> None:
    reader, writer = await asyncio.open_unix_connection(modbus.ready_event["control"])
    writer.write(line.encode() + b"\n")
    answer = json.loads(await reader.readline())
    assert answer["ok"] is False
    assert words in answer["error"]
    writer.write(b'{"id": "still here", "op": "ready"}\n')
    assert json.loads(await reader.readline())["id"] == "still here"
    writer.close()


async def test_an_unpaused_plant_moves_by_itself(start_mock: Any) -> None:
    program = await start_mock("modbus", paused=False)
    before = await program.control.image()
    async with asyncio.timeout(PATIENCE_S):
        # The device does not report its ticks.
        while await program.control.image() == before:  # noqa: ASYNC110
            await asyncio.sleep(0.05)


async def test_a_wait_is_answered_by_what_has_already_happened(modbus: MockProgram) -> None:
    await exchange(modbus)
    found = await modbus.control.wait(kind="response", exception=None)
    assert [entry["function"] for entry in found] == [3]


async def test_a_wait_is_answered_as_soon_as_it_happens_and_holds_nobody_up(modbus: MockProgram) -> None:
    since = await modbus.control.next()
    waiting = asyncio.create_task(modbus.control.wait(since=since, count=3, kind="request", state_changing=False))
    await modbus.control.image()
    for _ in range(3):
        assert not waiting.done()
        await exchange(modbus)
    assert len(await waiting) == 3


async def test_a_wait_for_what_does_not_come_ends_with_its_time(modbus: MockProgram) -> None:
    await exchange(modbus)
    await modbus.control.wait(kind="DISCONNECTED")
    told = await modbus.control.ask("journal", since=0)
    assert [record["frame"] is None for record in told["records"]] == [True, False, False, True]
    for timeout_s in (0, 0.01):
        nothing = await modbus.control.ask("wait", since=told["next"], timeout_s=timeout_s)
        assert (nothing["records"], nothing["next"]) == ([], told["next"])


async def test_a_client_that_goes_away_while_waiting_leaves_nothing_behind(modbus: MockProgram) -> None:
    leaving = await Control.connect(modbus.ready_event["control"])
    leaving.writer.write(b'{"id": 1, "op": "wait", "since": 1000, "timeout_s": 60}\n')
    await leaving.ask("ready")
    await leaving.close()
    await exchange(modbus)
    assert await modbus.control.journal(kind="request")


async def test_released_entries_are_gone_for_good_and_not_counted_as_dropped() -> None:
    journal = Journal(capacity=10)
    assert [journal.event(connection=1, direction="in", kind="x") for _ in range(8)] == list(range(8))
    journal.forget(6)
    assert [record.number for record in journal.since(0)] == [6, 7]
    assert (journal.first, journal.next, journal.dropped) == (6, 8, 0)
    journal.forget(3)
    assert journal.first == 6
    journal.forget(1_000)
    assert (journal.since(0), journal.first, journal.next) == ([], 8, 8)
    assert journal.event(connection=1, direction="in", kind="y") == 8
    assert [record.number for record in journal.since(0)] == [8]
    assert journal.since(9) == []


async def test_a_journal_that_is_consumed_never_drops_anything() -> None:
    journal = Journal(capacity=10)
    for _ in range(100):
        mark = journal.next
        for _ in range(5):
            journal.event(connection=1, direction="in", kind="x")
        assert len(journal.since(mark)) == 5
        journal.forget(journal.next)
    assert (journal.first, journal.next, journal.dropped) == (500, 500, 0)


async def test_a_full_journal_drops_the_oldest_and_counts_them() -> None:
    journal = Journal(capacity=10)
    for _ in range(25):
        journal.event(connection=1, direction="in", kind="x")
    assert [record.number for record in journal.since(0)] == list(range(15, 25))
    assert [record.number for record in journal.since(22)] == [22, 23, 24]
    assert (journal.next, journal.dropped) == (25, 15)


class SlowDevice(Device):
    """A device whose ticks take two loop turns; it notices a tick that is cut short or overlaps another or a reset."""

    protocol = "slow"

    def __init__(self) -> None:
        super().__init__()
        self.begun = self.done = 0

    async def serve(self, endpoints: Mapping[str, Any]) -> None:
        raise NotImplementedError

    async def aclose(self) -> None:
        raise NotImplementedError

    def image(self) -> dict[str, Any]:
        raise NotImplementedError

    async def poke(self, params: Mapping[str, Any]) -> None:
        raise NotImplementedError

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        raise NotImplementedError

    async def reset(self) -> None:
        assert self.begun == self.done

    async def tick(self) -> None:
        assert self.begun == self.done
        self.begun += 1
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        self.done += 1


async def test_ticks_and_resets_take_turns_and_a_pause_cuts_none_in_half(monkeypatch: pytest.MonkeyPatch) -> None:
    device = SlowDevice()
    simulation = Simulation(device)
    loop = asyncio.get_running_loop()
    problems: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda loop, context: problems.append(context))
    # The clock leaps: every second is over at once.
    real = asyncio.sleep
    monkeypatch.setattr("pytest_otmcp.mocks.device.asyncio.sleep", lambda _: real(0))
    for turns in range(12):
        simulation.resume()
        for _ in range(turns):
            await real(0)
        await asyncio.gather(simulation.tick(2), simulation.reset(), simulation.pause(), simulation.tick(1))
        at_rest = device.done
        assert device.begun == at_rest
        for _ in range(5):
            await real(0)
        assert device.begun == at_rest
    assert problems == []
