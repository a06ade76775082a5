"""Results that the process that executed an item sends to the controller: plain data of a size that does not grow with the
repetitions."""

from __future__ import annotations

import statistics
from array import array
from collections import Counter
from typing import TypedDict

from ..core.walls import Wall
from ..record.consistency import tool_calls
from ..record.schema import AdapterFacts, Counted, Device, Finding, ItemBody, Sample
from ..record.warnings import Warned, WarningTally, failing

__all__ = ["FailedSample", "ItemResult", "Measured", "Tally", "WorkerFacts"]

_FAILED_KEPT = 2


class FailedSample(TypedDict):
    """A repetition that failed, for the failure message of the item."""

    repetition: int
    findings: list[Finding]


class Measured(TypedDict):
    """Summary of the samples of an item; ``failed`` has the first ones that failed."""

    samples: int
    passed: int
    median_ms: float | None
    tool_calls: dict[Counted, int]
    failed: list[FailedSample]
    warnings: list[Warned]


class ItemResult(TypedDict):
    """An item, the summary of its samples, the file that holds them, and its digest."""

    item: ItemBody
    measured: Measured
    spool: str
    digest: str


class WorkerFacts(TypedDict):
    """Facts about a process that executes items: its adapters, its devices, the seconds by what they were spent on, and the walls around
    its adapters, which are empty where it has none.
    """

    adapters: dict[str, AdapterFacts]
    devices: dict[str, Device]
    spent: dict[str, float]
    walls: dict[Wall, str | None]


class Tally:
    """Running count of the samples of one item.

    Args:
        item: its id.
        suite: of the item.
    """

    def __init__(self, item: str, suite: str) -> None:
        self._item = item
        self._suite = suite
        self._durations = array("d")
        self._passed = 0
        self._calls: Counter[Counted] = Counter()
        self._failed: list[FailedSample] = []
        self._warnings = WarningTally()

    def add(self, sample: Sample) -> None:
        """Count a sample."""
        self._durations.append(sample["duration_ms"])
        self._passed += sample["ok"]
        self._calls += tool_calls(self._suite, sample["calls"])
        self._warnings.add(self._item, sample["findings"])
        if not sample["ok"] and len(self._failed) < _FAILED_KEPT:
            self._failed.append({"repetition": sample["repetition"], "findings": failing(sample["findings"])})

    def measured(self, item: ItemBody) -> Measured:
        """Return the summary of the samples; tool calls around them are counted, too."""
        calls = self._calls.copy()
        for part in item["around"]:
            calls += tool_calls(self._suite, part["calls"])
        self._warnings.add(self._item, item["findings"])
        return {
            "samples": len(self._durations),
            "passed": self._passed,
            "median_ms": statistics.median(self._durations) if self._durations else None,
            "tool_calls": dict(calls),
            "failed": self._failed,
            "warnings": self._warnings.kinds,
        }
