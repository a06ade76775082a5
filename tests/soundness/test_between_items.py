"""An adapter's actions while nobody calls it are seen as well, and the leftovers of one item spoil no other item."""

from __future__ import annotations

import asyncio
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.subject import Adapter, load_subject, reference_subject
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks
from tests.trials import as_read, recorded

from .conftest import DEFECT, Judge, Results, failing, foreign_subject, lying, requirements, words

FIRST_MQTT = Path(__file__).parents[2] / "docs" / "first-adapter" / "first" / "mqtt.toml"
"""Its library takes a subscription, and says nothing of the broker."""


@pytest.mark.parametrize("following", ["M2", "M4"])
def test_a_command_that_comes_between_two_items_is_found(
    loop: LoopThread, plant: Plant, tmp_path: Path, following: str
) -> None:
    trigger = tmp_path / "now"
    os.mkfifo(trigger)
    subject = lying(foreign_subject("modbus-json"), "makes-up-between-items", FOREIGN_TRIGGER=str(trigger))
    bench, tasks = Bench(subject, BenchOptions(), plant), tasks_by_id()

    async def two_items() -> tuple[Results, dict[str, Any]]:
        try:
            outage = await measured(bench, tasks["S10"])
            # No item runs now: the kit does not look at the device.
            under_test = await bench.adapter("modbus")
            await asyncio.to_thread(trigger.write_bytes, b"")
            write = {"kind": "request", "function": 6}
            assert await under_test.device.wait(under_test.cursor.next, write, timeout_s=60.0)
            results = {"S10": outage, following: await measured(bench, tasks[following])}
            return results, recorded(bench, results.values())
        finally:
            await bench.close()

    results, record = loop.run(two_items())
    assert results["S10"]["status"] == "PASS"
    (finding,) = results[following]["findings"]
    sentence = "before this item, when nobody called the adapter: the device should have seen no state-changing request, it saw 1"
    assert sentence in finding["message"]
    assert results[following]["samples"][0]["ok"]

    assert rejudge(as_read(record)) == []
    found = record["items"][1]["devices"]["modbus"]
    found["before"].pop()
    assert "the journal of modbus should have the entries" in "\n".join(rejudge(as_read(record)))
    found["before"].clear()
    assert "the journal of modbus should have the entries" in "\n".join(rejudge(as_read(record)))


def test_an_item_that_cannot_be_finished_leaves_its_device_running(loop: LoopThread, plant: Plant) -> None:
    tasks = Tasks()

    @tasks.task(
        "Stops", "stress", "Stop the device, and write by what has no tool.", needs="modbus.ping", capability=None
    )
    async def stops(run: Repetition, modbus: Rig) -> None:
        await modbus.prove()
        await modbus.stop_device()
        await modbus.call("write_holding", address=1, value=7)

    subject = foreign_subject("modbus-json")
    bound = subject.adapters["modbus"].operations
    (write,) = bound["write_holding"]
    operations = {**bound, "write_holding": (replace(write, when={"address": 2}),)}
    adapter = replace(subject.adapters["modbus"], operations=operations)
    bench = Bench(replace(subject, adapters={"modbus": adapter}), BenchOptions(), plant)

    async def both() -> tuple[str, str]:
        try:
            stopped = await measured(bench, stops)
            return stopped["status"], (await measured(bench, tasks_by_id()["M2"]))["status"]
        finally:
            await bench.close()

    assert loop.run(both()) == ("NOT_TESTABLE", "PASS")


def test_a_finding_of_an_item_that_turns_out_not_to_apply_stands(judge: Judge) -> None:
    """The adapter's session begins, with a finding, before the item sees that it has nothing to ask."""

    def tells_its_state(adapter: Adapter) -> Adapter:
        return replace(adapter, unclaimed=dict.fromkeys(adapter.operations.keys() - {"info"}, "has no such tool"))

    items = "INJ-001.mqtt INJ-002.mqtt"
    results = judge("mqtt", *DEFECT, "MU-130t", tasks=items, described=tells_its_state)
    assert failing(results) == set(items.split()), words(results)
    assert requirements(results) == {"SPB-013"}, words(results)


@pytest.mark.long
def test_a_connection_that_an_item_has_left_dead_is_no_part_of_the_next(loop: LoopThread, plant: Plant) -> None:
    tasks = Tasks()

    @tasks.task("Dies", "stress", "Let the connection die without an end.", needs="mqtt.subscribe", capability=None)
    async def dies(run: Repetition, mqtt: Rig) -> None:
        await mqtt.call("subscribe", filter="otmcp/before", qos=0)
        await mqtt.device.poke(network="black_hole")
        # The library hands it to a connection that never says that it has ended.
        run.succeeds(await mqtt.call("subscribe", filter="otmcp/lost", qos=0))
        await mqtt.wait_for(kind="lost", timeout_s=10.0)
        await mqtt.device.poke(network="open")

    subject = load_subject(FIRST_MQTT)
    bench = Bench(subject, BenchOptions(), plant)

    async def two_items() -> tuple[Any, Any]:
        try:
            left = await measured(bench, dies)
            return left, await measured(bench, tasks_by_id()["Q2"])
        finally:
            await bench.close()

    left, following = loop.run(two_items())
    assert left["status"] == "PASS", words({"Dies": left})
    assert following["status"] == "PASS", words({"Q2": following})


@pytest.mark.long
def test_a_record_bears_out_that_a_session_began_anew_for_its_dead_connection(loop: LoopThread, plant: Plant) -> None:
    bench, tasks = Bench(reference_subject(), BenchOptions(), plant), tasks_by_id(suites=SUITES)

    async def three_items() -> dict[str, Any]:
        try:
            results = [await measured(bench, tasks[name]) for name in ("REC-003.opcua", "REC-005.opcua", "O1")]
            return recorded(bench, results)
        finally:
            await bench.close()

    record = loop.run(three_items())
    assert [item["status"] for item in record["items"]] == ["PASS"] * 3
    assert rejudge(as_read(record)) == []
