"""Rows of a matrix without a run: the verdicts are those of records of real runs."""

from __future__ import annotations

from functools import cache
from typing import Any

from pytest_otmcp.fleet.lines import Line, line
from pytest_otmcp.fleet.outcome import Result, judged
from pytest_otmcp.record.condensed import condensed
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.report.verdict_file import verdict
from tests.golden.files import path_of

__all__ = ["HONEST", "LYING", "row", "told"]

HONEST, LYING = "reference-modbus", "defect-MU-14dnp"


@cache
def told(golden: str) -> dict[str, Any]:
    """Return the verdict of a golden record, as if one kit had judged them all, and in the whole suite."""
    with open_record(path_of(golden), compressed=True) as run:
        found = verdict(condensed(run))
    same = {"name": "pytest-otmcp", "version": "0.1.0", "digest": "sha256:ab", "suite_digest": "sha256:cd"}
    return {**found, "kit": same, "verdict": "CONFORMANT" if golden == HONEST else "NOT CONFORMANT", "narrowed": []}


def row(name: str, version: str, golden: str = HONEST, **more: Any) -> Line:
    """Return the row of an adapter that went as a golden record did."""
    verdict = told(golden)
    named: dict[str, Any] = {"key": f"{name}-{version}", "record": f"{name}-{version}", "outcome": judged(verdict)}
    return line(
        Result(id=name, version=version, verdict=verdict, seconds=1.0, **named | more), f"runs/{name}-{version}"
    )
