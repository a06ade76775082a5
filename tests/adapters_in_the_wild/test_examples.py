"""The examples of docs/examples: each loads, and four real adapters of different shape get the verdicts that a person
found to be true by reading the device's journal (docs/examples/README.md says how).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.subject import load_subject
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from tests.trials import measured

from .conftest import EXAMPLES, Install

NAMES = sorted(path.parent.name for path in EXAMPLES.glob("*/otmcp.toml"))

MODBUS = "M2 M3 FM1 FM2 S1 S4 S7 S10 R-modbus"
OPCUA = "O1 O2 FO1 S3 S9 S12 R-opcua"

VERIFIED = {
    # name: (items that pass, items that fail with words of the finding); all other items are not applicable.
    "kukapay-modbus-mcp": (MODBUS, {}),
    "modbus-connector-mcp": (f"{MODBUS} M4", {}),
    "plctap": (f"{MODBUS} M1 M4 {OPCUA}", {}),
    "mcmqtt": (
        "",
        {
            "Q1": "should have answered at least",
            "Q2": "the reply says []",
            "Q3": "it came with QoS 1",
            "FQ1": "it claims success",
            "FQ2": "line(s) on stdout that are no MCP message",
            "S2": "the reply says []",
            "S5": "it came with QoS 1",
            "S8": "should have answered at least",
            "S11": "it claims success",
            "R-mqtt": "it claims success",
        },
    ),
}


@pytest.mark.parametrize("name", NAMES)
def test_every_example_loads(name: str) -> None:
    subject = load_subject(EXAMPLES / name / "otmcp.toml")
    assert subject.adapters


@pytest.mark.parametrize("name", NAMES)
def test_every_example_says_exactly_what_to_install(name: str) -> None:
    files = sorted((EXAMPLES / name).glob("requirements*.txt"))
    assert files
    for line in [line for file in files for line in file.read_text(encoding="utf-8").splitlines()]:
        assert re.fullmatch(r"[\w.-]+(\[\w+\])?==[\w.]+", line), line


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


@pytest.mark.long
@pytest.mark.parametrize("name", VERIFIED)
def test_an_adapter_of_the_wild_gets_the_verified_verdicts(
    name: str, installed: Install, loop: LoopThread, plant: Plant
) -> None:
    passing, failing = VERIFIED[name]
    results, drift = loop.run(judged(installed(name), plant))
    assert drift == []
    statuses = {identifier: result["status"] for identifier, result in results.items()}
    expected = dict.fromkeys(results, "NOT_APPLICABLE") | dict.fromkeys(passing.split(), "PASS")
    assert statuses == expected | dict.fromkeys(failing, "FAIL"), words(results)
    for identifier, reason in failing.items():
        assert reason in words({identifier: results[identifier]})


async def judged(subject_file: Path, plant: Plant) -> tuple[dict[str, Any], list[str]]:
    """Run every task of the suite once; return the results, and how the subject file contradicts the adapter."""
    subject = load_subject(subject_file)
    bench = Bench(subject, BenchOptions(), plant)
    try:
        await bench.prepare(subject.adapters)
        drift = bench.drift()
        return {identifier: await measured(bench, task) for identifier, task in tasks_by_id().items()}, drift
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
