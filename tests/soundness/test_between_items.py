"""What an adapter does when nobody calls it is seen as well, and what one item leaves behind spoils no other."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from pytest_otmcp.trial.live_driver import LiveDriver
from pytest_otmcp.trial.trial import Trial

from .conftest import SUBJECTS, Judge, Results, as_record, foreign_subject, lying, passing


@pytest.mark.parametrize("following", ["M2", "M4"])
def test_a_command_that_comes_between_two_items_is_found(
    loop: LoopThread, plant: Plant, tmp_path: Path, following: str
) -> None:
    trigger = tmp_path / "now"
    os.mkfifo(trigger)
    subject = lying(foreign_subject("modbus-json"), "makes-up-between-items", FOREIGN_TRIGGER=str(trigger))
    bench, tasks = Bench(subject, BenchOptions(), plant), tasks_by_id()

    async def two_items() -> Results:
        try:
            outage = await Trial(LiveDriver(bench, tasks["S10"], seed=0), tasks["S10"], 1).run()
            # Nobody looks at the device now.
            station = await bench.station("modbus")
            await asyncio.to_thread(trigger.write_bytes, b"")
            write = {"kind": "request", "function": 6}
            assert await station.device.wait(station.mark, write, timeout_s=60.0)
            return {
                "S10": outage,
                following: await Trial(LiveDriver(bench, tasks[following], seed=0), tasks[following], 1).run(),
            }
        finally:
            await bench.close()

    results = loop.run(two_items())
    assert results["S10"]["status"] == "PASS"
    (finding,) = results[following]["findings"]
    sentence = "before this item, when nobody called the adapter: the device should have seen no state-changing request, it saw 1"
    assert sentence in finding["message"]
    assert results[following]["samples"][0]["ok"]

    record = as_record(bench, bench.facts(), results)
    assert rejudge(record) == []
    place, *_ = record["items"][1]["history"]["stations"]
    place["before"].pop()
    assert "before should end with entry" in "\n".join(rejudge(record))
    place["before"].clear()
    assert sentence in "\n".join(rejudge(record))


def test_an_item_that_cannot_be_finished_leaves_its_device_running(judge_foreign: Judge) -> None:
    text = (SUBJECTS / "modbus-json.toml").read_text(encoding="utf-8")
    binding = text[text.index("[adapter.modbus.bind.write_holding]") :]
    results = judge_foreign("modbus-json", described=(binding, ""), tasks="S10 R-modbus")
    assert results["S10"]["status"] == "NOT_TESTABLE"
    assert passing(results) == {"R-modbus"}
