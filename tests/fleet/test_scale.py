"""The measurement of a large fleet, with a small one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("snakemake", reason="Snakemake is not installed")

CHECKOUT = Path(__file__).parents[2]


@pytest.mark.long
def test_a_fleet_is_planned_and_merged_and_what_that_took_is_printed() -> None:
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks.fleet_scale", "20"],
        cwd=CHECKOUT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "| 20 rows |" in run.stdout
    assert all(f"`otmcp {command}`" in run.stdout for command in ("fleet plan", "merge")), run.stdout
