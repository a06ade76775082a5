"""The examples of docs/examples: each loads, says what to install, and still gives its row of docs/field-report.md."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

import pytest

from pytest_otmcp.core.matrix import BENCHMARK
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.schema import Item
from pytest_otmcp.record.warnings import failing, findings_of
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.subject import load_subject
from pytest_otmcp.suite.catalogue import suite_digest, tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench

from .conftest import Install
from .examples import EXAMPLES, NAMES, requirement_files, sources
from .records import recorded, stored


@pytest.mark.parametrize("name", NAMES)
def test_every_example_loads(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in sources(name):
        monkeypatch.setenv(variable, "anywhere")
    subject = load_subject(EXAMPLES / name / "otmcp.toml")
    assert subject.adapters


@pytest.mark.parametrize("name", NAMES)
def test_every_example_says_exactly_what_to_install(name: str) -> None:
    files, package = requirement_files(name), EXAMPLES / name / "package.json"
    if package.exists():
        assert all(map(re.compile(r"[\d.]+").fullmatch, json.loads(package.read_text())["dependencies"].values()))
    assert files or package.exists() or sources(name)
    for line in [line for file in files for line in file.read_text(encoding="utf-8").splitlines()]:
        assert re.fullmatch(r"[\w.-]+(\[\w+\])?(==[\w.]+| @ git\+https://[\w./-]+@[0-9a-f]{7,})", line), line


def test_the_table_of_the_examples_has_every_example() -> None:
    readme = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\| \[([\w-]+)\]\(\1/otmcp\.toml\)", readme, re.MULTILINE)) == NAMES


@pytest.fixture(scope="module")
def loop() -> Iterator[LoopThread]:
    thread = LoopThread()
    yield thread
    thread.close()


@pytest.fixture(scope="module")
def plant(loop: LoopThread) -> Iterator[Plant]:
    shared = Plant()
    yield shared
    loop.run(shared.close())


def on_cable(name: str) -> bool:
    """Tell whether an adapter speaks a protocol that takes a cable."""
    described = tomllib.loads((EXAMPLES / name / "otmcp.toml").read_text(encoding="utf-8"))
    return any(protocols()[key].cable for key in described["adapter"])


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        # A minute or more each. PySOEM waits 20 ms for a frame, which beside five more workers is too little now and then.
        pytest.param(name, marks=pytest.mark.weekly if number % 6 != 2 or on_cable(name) else ())
        for number, name in enumerate(recorded())
    ],
)
def test_an_adapter_of_the_wild_still_gives_its_row(
    name: str, installed: Install, loop: LoopThread, plant: Plant
) -> None:
    results, drift = loop.run(judged(installed(name), plant))
    assert drift == []
    # A record of both suites has checks as well, which take many minutes for an adapter that fails them.
    record = stored(name)
    told = {item["id"]: item for item in record["items"] if item["suite"] in BENCHMARK}
    assert results.keys() == told.keys()
    for identifier, item in told.items():
        found = results[identifier]
        if item["status"] == "NOT_APPLICABLE" and record["kit"]["suite_digest"] != suite_digest():
            # An item that the suite of that day did not ask this adapter for: the record says nothing of it.
            continue
        if found["status"] != item["status"]:
            assert sometimes(item), f"{identifier} is {found['status']}: {words({identifier: found})}"
        known = faults(item)
        # Of an item that was given up the record does not have the end, which one repetition reaches.
        assert faults(found) <= known or (None, "gave_up") in known, words({identifier: found})


def sometimes(item: Mapping[str, Any]) -> bool:
    """Tell whether an item of a record failed in some of its repetitions only, and for nothing else."""
    passed = [sample["ok"] for sample in item["samples"]]
    return any(passed) and not all(passed) and not failing(item["findings"])


FORMERLY = dict.fromkeys(
    [("REC-002", "answers_when_gone"), (None, "not_proven_again")],
    (None, "not_proven"),
)
"""What the kits that made the records called what is told apart since."""


def faults(item: Mapping[str, Any]) -> set[tuple[str | None, str]]:
    """Return requirement and code of each finding about a MUST, as the records have them."""
    found = [(finding["requirement"], finding["code"]) for finding in failing(findings_of(cast(Item, item)))]
    return {FORMERLY.get(one, one) for one in found}


async def judged(subject_file: Path, plant: Plant) -> tuple[dict[str, Any], list[str]]:
    """Run every task of the benchmark once; return the results, and how the subject file contradicts the adapter."""
    subject = load_subject(subject_file)
    bench = Bench(subject, BenchOptions(), plant)
    try:
        await bench.prepare(subject.adapters)
        drift = bench.drift()
        return {
            identifier: await measured(bench, task) for identifier, task in tasks_by_id(subject.adapters).items()
        }, drift
    finally:
        await bench.close()


def words(results: dict[str, Any]) -> str:
    """Return every finding's message after its item's id, one a line."""
    return "\n".join(
        f"{identifier}: {finding['message']}"
        for identifier, result in results.items()
        for findings in (result["findings"], *(sample["findings"] for sample in result["samples"]))
        for finding in findings
    )
