"""Functions for tests that run tasks on a bench and make a record of the results."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from pytest_otmcp.record.reader import StoredRun
from pytest_otmcp.record.schema import Run, check
from pytest_otmcp.suite.catalogue import suite_digest
from pytest_otmcp.trial.bench import Bench

from .stored_runs import run_of

__all__ = ["as_read", "recorded"]


def recorded(bench: Bench, items: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the record of these items as if it was read from a file; their bench must not have been closed."""
    record = run_of(
        items,
        adapters=bench.adapters(),
        devices=bench.devices(),
        suite_digest=suite_digest(),
        time_scale=bench.options.time_scale,
        soak=bench.options.soak,
    )
    restored: dict[str, Any] = json.loads(json.dumps(record, allow_nan=False))
    if bench.options.devices:
        restored["settings"]["devices"] = dict(bench.options.devices)
    return restored


def as_read(record: Mapping[str, Any]) -> StoredRun:
    """Check a record in memory as if it was read from a file, and return it."""
    return StoredRun.of(check(record, Run, "the record"))
