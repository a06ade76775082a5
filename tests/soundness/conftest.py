"""Fixtures that run tasks of the shipped suite against defective adapters, over one plant for all of them."""

from __future__ import annotations

import asyncio
import random
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.session.isolation import Isolation
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness import judging
from pytest_otmcp.soundness.among_genuine import AmongGenuine, with_command
from pytest_otmcp.soundness.defect import DEFECTS
from pytest_otmcp.soundness.judging import IMPATIENT, measured
from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import Adapter, Subject, load_subject, named_subject, reference_subject
from pytest_otmcp.suite.catalogue import all_tasks, tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from pytest_otmcp.trial.task import Task
from tests.trials import as_read, recorded

from .sentences import untrue

__all__ = [
    "DEFECT",
    "HERE",
    "IMPATIENT",
    "SUBJECTS",
    "Judge",
    "Results",
    "failing",
    "foreign_subject",
    "judge",
    "judge_described",
    "judge_foreign",
    "lane",
    "loop",
    "lying",
    "passing",
    "perform",
    "plant",
    "requirements",
    "words",
]

HERE = Path(__file__).parent
SUBJECTS = HERE / "subjects"
DEFECT = ("-P", "-m", DEFECTS)
"""Words that start the adapter with the catalogue's defect whose id follows."""


@pytest.fixture(autouse=True)
def apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each test's adapters work in a folder of their own: equal items of several workers look for files of equal names there."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def loop() -> Iterator[LoopThread]:
    thread = LoopThread()
    yield thread
    thread.close()


@pytest.fixture(scope="session")
def isolation(pytestconfig: pytest.Config) -> Iterator[Isolation]:
    of_all = Isolation(pytestconfig.getoption("--isolation"))
    yield of_all
    of_all.close()


@pytest.fixture(scope="session")
def plant(loop: LoopThread, isolation: Isolation) -> Iterator[Plant]:
    shared = Plant(isolation=isolation)
    yield shared
    loop.run(shared.close())


@pytest.fixture
def walled(isolation: Isolation) -> bool:
    """Whether adapters have files and processes of their own."""
    return isolation.walls() is not None and isolation.account()["processes"] is None


Results = dict[str, dict[str, Any]]
Judge = Callable[..., Results]


async def perform(bench: Bench, tasks: list[Task], repetitions: int = 1) -> Results:
    """Run every task so many times, in this order. Fail unless the results can be recorded and follow from the record again, and every
    sentence of a finding about a reply is one that the record bears out."""
    try:
        results = {task.id: await measured(bench, task, repetitions) for task in tasks}
        record = recorded(bench, results.values())
    finally:
        await bench.close()
    assert await asyncio.to_thread(rejudge, as_read(record)) == []
    assert untrue(results.values()) == []
    return results


@pytest.fixture
def judge(loop: LoopThread, plant: Plant, warm_start: WarmStart) -> Judge:
    """``judge(protocol, program, mode, …)`` runs every task that needs the protocol with that adapter replaced.

    A ``command`` is started as it is, a program is started warm. With a number for ``shuffled`` the tasks run in another order.
    ``described`` changes what the subject file says of it. ``named``: it has a vocabulary of its own.
    """

    def run(
        protocol: str,
        *program: str,
        command: tuple[str, ...] | None = None,
        tasks: str | None = None,
        time_scale: float = 1.0,
        shuffled: int | None = None,
        repetitions: int = 1,
        described: Callable[[Adapter], Adapter] | None = None,
        named: bool = False,
    ) -> Results:
        if command is None:
            first = (str(HERE / program[0]),) if program[0].endswith(".py") else (program[0],)
            command = (*warm_start.words(protocol), *first, *program[1:])
        genuine = named_subject() if named else reference_subject()
        subject = with_command(warm_start.subject(genuine), protocol, command)
        if described is not None:
            changed = described(subject.adapters[protocol])
            subject = replace(subject, adapters={**subject.adapters, protocol: changed})
        chosen = [task for task in _known(tasks) if protocol in task.adapters]
        if shuffled is not None:
            random.Random(shuffled).shuffle(chosen)
        return loop.run(perform(AmongGenuine(subject, plant, protocol, time_scale), chosen, repetitions))

    return run


@pytest.fixture
def judge_described(loop: LoopThread, plant: Plant, warm_start: WarmStart) -> Judge:
    """``judge_described(subject)`` runs the tasks of the protocols that the subject speaks, once each."""

    def run(subject: Subject, tasks: str | None = None, time_scale: float = 1.0) -> Results:
        chosen = [task for task in _known(tasks) if set(task.adapters) & set(subject.adapters)]
        bench = Bench(warm_start.subject(subject), BenchOptions(time_scale=time_scale), plant)
        return loop.run(perform(bench, chosen))

    return run


@pytest.fixture
def judge_foreign(judge_described: Judge) -> Judge:
    """``judge_foreign(name, …, lie=…)`` does the same for subjects of ``subjects/``, each with a protocol of its own.

    ``described`` is a pair: a text to replace in the subject file, and its replacement.
    """

    def run(
        *names: str,
        lie: str | None = None,
        tasks: str | None = None,
        described: tuple[str, str] | None = None,
        time_scale: float = 1.0,
    ) -> Results:
        adapters: dict[str, Adapter] = {}
        for name in names:
            adapters |= foreign_subject(name, described).adapters
        subject = Subject(name="foreign", version="0", adapters=adapters, source=SUBJECTS)
        if lie is not None:
            subject = lying(subject, lie)
        return judge_described(subject, tasks, time_scale)

    return run


def foreign_subject(name: str, described: tuple[str, str] | None = None) -> Subject:
    """Load a subject of ``subjects/``, with its file as it is or with a text in it replaced."""
    if described is None:
        return load_subject(SUBJECTS / f"{name}.toml")
    text = (SUBJECTS / f"{name}.toml").read_text(encoding="utf-8")
    assert described[0] in text
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory, "otmcp.toml")
        moved = (
            text.replace(*described).replace("{dir}", str(SUBJECTS)).replace('bindings = "', f'bindings = "{SUBJECTS}/')
        )
        path.write_text(moved, encoding="utf-8")
        return load_subject(path)


def _known(tasks: str | None) -> list[Task]:
    """Return the tasks with these ids; without any, those of the benchmark."""
    if tasks is None:
        # Without adapters, these would be the tasks of the protocols that every run has.
        return list(tasks_by_id(protocols()).values())
    return [task for task in all_tasks().values() if task.id in tasks.split()]


def lying(subject: Subject, lie: str, **env: str) -> Subject:
    """Return the subject with this lie, and these variables, in its environment."""
    return replace(
        subject,
        adapters={
            protocol: replace(
                adapter,
                variants={
                    name: replace(variant, env={**variant.env, "FOREIGN_LIE": lie, **env})
                    for name, variant in adapter.variants.items()
                },
            )
            for protocol, adapter in subject.adapters.items()
        },
    )


def lane(number: int, quick: bool) -> list[pytest.MarkDecorator]:
    """Return the markers of one of many cases of a kind: the fast lane runs the quick ones, the long lane every second of the others."""
    return [] if quick else [pytest.mark.long] if number % 2 else [pytest.mark.long, pytest.mark.weekly]


def failing(results: Results) -> set[str]:
    """Return the ids of all items but those that passed and those that do not apply."""
    return judging.failing(results.values())


def passing(results: Results) -> set[str]:
    """Return the ids of the items that passed."""
    return {identifier for identifier, result in results.items() if result["status"] == "PASS"}


def words(results: Results) -> str:
    """Return every finding's message after its item's id, one a line."""
    return "\n".join(
        f"{identifier}: {finding['message']}"
        for identifier, result in results.items()
        for findings in (result["findings"], *(sample["findings"] for sample in result["samples"]))
        for finding in findings
    )


def requirements(results: Results) -> set[str]:
    """Return the requirements that the findings cite, and the codes of findings that cite none."""
    return judging.noted(results.values())
