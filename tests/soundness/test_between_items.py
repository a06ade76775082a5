"""An adapter's actions while nobody calls it are seen as well, and the leftovers of one item spoil no other item."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from tests.trials import as_read, recorded

from .conftest import SUBJECTS, Judge, Results, foreign_subject, lying, passing


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


def test_an_item_that_cannot_be_finished_leaves_its_device_running(judge_foreign: Judge) -> None:
    text = (SUBJECTS / "modbus-json.toml").read_text(encoding="utf-8")
    binding = text[text.index("[adapter.modbus.bind.write_holding]") :]
    results = judge_foreign("modbus-json", described=(binding, ""), tasks="S10 R-modbus")
    assert results["S10"]["status"] == "NOT_TESTABLE"
    assert passing(results) == {"R-modbus"}
