"""Runs tasks of the shipped suite against defective adapters, over one plant for all of them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.bench import Bench, BenchOptions, Plant
from pytest_otmcp.loop import LoopThread
from pytest_otmcp.shipped import tasks_by_id
from pytest_otmcp.subject import Adapter, Subject, reference_subject
from pytest_otmcp.trial import Trial

HERE = Path(__file__).parent
TIME_SCALE = 0.3
"""Deadlines of 1.5 s: long enough for an honest adapter on a busy machine, short enough to wait for a hanging one."""


@pytest.fixture(scope="session")
def loop() -> Iterator[LoopThread]:
    thread = LoopThread()
    yield thread
    thread.close()


@pytest.fixture(scope="session")
def plant(loop: LoopThread) -> Iterator[Plant]:
    shared = Plant()
    yield shared
    loop.run(shared.close())


Results = dict[str, dict[str, Any]]


@pytest.fixture
def judge(loop: LoopThread, plant: Plant) -> Callable[..., Results]:
    """``judge(protocol, program, mode, …)``: every task that needs the protocol, once, with that adapter replaced."""

    def run(
        protocol: str,
        *program: str,
        command: tuple[str, ...] | None = None,
        tasks: str | None = None,
        time_scale: float = TIME_SCALE,
    ) -> Results:
        reference = reference_subject()
        genuine = reference.adapters[protocol]
        if command is None:
            command = (sys.executable, str(HERE / program[0]), *program[1:])
        variants = {
            name: replace(variant, command=command, cwd=None) for name, variant in genuine.variants.items()
        }
        adapters: dict[str, Adapter] = {**reference.adapters, protocol: replace(genuine, variants=variants)}
        subject = Subject(name="defective", version="0", adapters=adapters, source=HERE)
        chosen = [
            task
            for identifier, task in tasks_by_id().items()
            if protocol in task.adapters and (tasks is None or identifier in tasks.split())
        ]

        async def all_of_them() -> Results:
            bench = Bench(subject, BenchOptions(time_scale=time_scale), plant)
            try:
                return {task.id: await Trial(bench, task, 1).run() for task in chosen}
            finally:
                await bench.close()

        return loop.run(all_of_them())

    return run


def failing(results: Results) -> set[str]:
    """Ids of the items that did not pass."""
    return {identifier for identifier, result in results.items() if result["status"] != "PASS"}


def words(results: Results) -> str:
    """Every finding's message."""
    return "\n".join(
        finding["message"]
        for result in results.values()
        for findings in (result["findings"], *(sample["findings"] for sample in result["samples"]))
        for finding in findings
    )
