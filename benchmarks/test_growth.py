"""The cost of a repetition after many others, and the memory of a long run: ``pytest benchmarks/test_growth.py``.

Each item runs alone, with few repetitions and with many, in a pytest of its own. No time is asserted. The memory is,
and so is that every repetition passes whatever their number: neither depends on the machine's load. All items take hours,
most of them for the fresh sessions of the recovery suite: choose with ``-k "M2 or Q4"``.
"""

from __future__ import annotations

import itertools
import os
import statistics
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from pytest_otmcp.record.reader import open_record
from pytest_otmcp.suite.catalogue import tasks_by_id

FEW, MANY = 30, 1000
MOST_MEMORY_MB = 300
SOME = 100
"""The number of repetitions at the beginning and at the end of a run whose times are compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """The measurements of one run of one item.

    Attributes:
        repetitions: the number of repetitions that were made.
        passed: the number of those that passed.
        first_ms, last_ms: time of the first and of the last repetitions, from the end of one to the end of the next:
            the lower quartile, because the load of other programs on the machine comes and goes.
        memory_mb: the largest memory of pytest or of a process that it waited for.
    """

    repetitions: int
    passed: int
    first_ms: float
    last_ms: float
    memory_mb: float


def run(item: str, reps: int, directory: Path) -> Measured:
    """Run an item alone and measure the run."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", "--pyargs", "pytest_otmcp.conformance"]
    command += [f"--otmcp-reps={reps}", f"--otmcp-report-dir={directory}", "-k", f"[{item}]"]
    with subprocess.Popen(command, cwd=directory, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, _, usage = os.wait4(process.pid, 0)
        process.returncode = 0
    with open_record(directory / "run.json", allow_incomplete=True) as record:
        (stored,) = record.items()
        passed, ends = 0, []
        for sample in stored.samples():
            passed += sample["ok"]
            ends.append(sample["observations"][-1]["seen_ns"])
    took = [(later - earlier) / 1e6 for earlier, later in itertools.pairwise(ends)]
    return Measured(
        repetitions=len(ends),
        passed=passed,
        first_ms=statistics.quantiles(took[:SOME])[0],
        last_ms=statistics.quantiles(took[-SOME:])[0],
        memory_mb=usage.ru_maxrss / (1024 if sys.platform != "darwin" else 1024 * 1024),
    )


@pytest.mark.parametrize("item", list(tasks_by_id()))
def test_growth(item: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = []
    for reps in (FEW, MANY):
        directory = tmp_path / str(reps)
        directory.mkdir()
        runs.append(run(item, reps, directory))
    few, many = runs
    assert all(measured.passed == measured.repetitions > 1 for measured in runs)
    assert many.memory_mb < MOST_MEMORY_MB
    with capsys.disabled():
        print(
            f"\n{item}: {few.last_ms:.1f} ms with {few.repetitions} repetitions; with {many.repetitions} {many.first_ms:.1f} ms at "
            f"first and {many.last_ms:.1f} ms at last; {few.memory_mb:.0f} and {many.memory_mb:.0f} MB"
        )
