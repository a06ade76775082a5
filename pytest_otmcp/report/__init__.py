"""The reports of a run record: terminal summary, pages, LaTeX tables, figures. This package does not judge.

This module computes the numbers that several reports print, so that no two reports disagree.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from itertools import count
from typing import cast

from ..core.matrix import BENCHMARK, FIELD, REQUIREMENTS, repetitions
from ..core.statistics import lower_bound
from ..protocols.external import DEVICE, external_devices
from ..record.schema import AdapterFacts, Call, Item, ItemBody, Run
from ..record.warnings import failing
from ..suite.catalogue import tasks_by_id

__all__ = [
    "Item",
    "Run",
    "adapters",
    "applies",
    "command",
    "control_failed",
    "deadlines",
    "durations",
    "least",
    "not_reached",
    "phases",
    "recovered",
    "tally",
    "task_calls",
    "timing_valid",
    "whole",
]


def applies(item: Item) -> bool:
    """Tell whether the subject claims the facets that the item needs."""
    return bool(item["status"] != "NOT_APPLICABLE")


def whole(run: Run) -> bool:
    """Tell whether every item of the suite that there is for the subject has a result."""
    return tasks_by_id(
        run["subject"]["adapters"], run["settings"].get("suites", BENCHMARK), run["settings"].get("devices", ())
    ).keys() <= {item["id"] for item in run["items"]}


def deadlines(run: Run) -> str:
    """Say within which time an adapter has to answer a call, as the subject file declares it; one time when all have the same."""
    told = {protocol: f"{facts['deadline_s']:g} s" for protocol, facts in adapters(run).items()}
    if len(set(told.values())) == 1:
        return next(iter(told.values()))
    names = {protocol["key"]: protocol["name"] for protocol in run["kit"]["protocols"]}
    return ", ".join(f"{names.get(protocol, protocol)} {time}" for protocol, time in told.items())


def tally(items: Iterable[Item]) -> tuple[int, int]:
    """Count the repetitions that passed and those planned, for the items that apply; one that did not run did not pass."""
    counted = [item for item in items if applies(item)]
    good = sum(sample["ok"] for item in counted for sample in item["samples"])
    return good, sum(item["planned"] for item in counted)


def least(item: Item) -> float | None:
    """Return the rate at which the item passes at least, with 95 % confidence; None when it says nothing about the subject, for a
    check of a requirement or an item of a real device, which is met or not, or when something around the repetitions failed: then the repetitions are not what the item is about."""
    if item["suite"] in (REQUIREMENTS, FIELD) or not item["samples"] or failing(item["findings"]):
        return None
    return lower_bound(*tally([item]))


def control_failed(item: ItemBody, passed: int) -> bool:
    """Tell whether every planned repetition passed and the item failed all the same, by something around the repetitions."""
    return item["status"] == "FAIL" and passed == item["planned"]


def timing_valid(run: Run) -> bool:
    """Tell whether the run's latencies are the subject's: in a parallel run they also measure the items beside it."""
    return run["footer"].get("timing_valid", True)


def durations(run: Run, items: Iterable[Item]) -> list[float]:
    """Return the milliseconds of every repetition of the items; nothing when the run's latencies are withheld."""
    return [sample["duration_ms"] for item in items for sample in item["samples"]] if timing_valid(run) else []


def phases(run: Run, item: Item, name: str) -> list[float]:
    """Return the milliseconds of a phase of recovery, where it happened; nothing when the run's latencies are withheld."""
    if not timing_valid(run):
        return []
    found = [cast(dict[str, float | None], sample["phases"])[name] for sample in item["samples"] if sample["phases"]]
    return [value for value in found if value is not None]


def recovered(items: Iterable[Item], way: str) -> tuple[int, int]:
    """Count the outages after which ``way`` (``same_session`` or ``fresh_session``) succeeded, and those that were reached."""
    reached = [sample["phases"] for item in items if applies(item) for sample in item["samples"] if sample["phases"]]
    return sum(cast(dict[str, bool], found)[f"{way}_ok"] for found in reached), len(reached)


def not_reached(item: Item) -> int:
    """Count the outages of an item that were planned and did not come about, because the adapter did not work before."""
    return item["planned"] - sum(sample["phases"] is not None for sample in item["samples"])


def adapters(run: Run) -> dict[str, AdapterFacts]:
    """Return the subject's adapters that had a session, by protocol."""
    return {key: facts for key, facts in run["subject"]["adapters"].items() if facts["tools"] is not None}


def task_calls(items: Iterable[Item]) -> list[Call]:
    """Return the calls that the tasks of these items are about; without set-up and the calls before a recovery."""
    return [call for item in items for sample in item["samples"] for call in sample["calls"] if call["role"] == "task"]


def command(run: Run, item: Item | None = None, repetition: int = 0) -> str:
    """Return the shell command that makes a run like this one, or only one item of it up to one of its repetitions.

    It works from any directory. Values depend only on seed and repetition, so they are the same again.
    """
    settings = run["settings"]
    options = ["--pyargs", "pytest_otmcp.conformance"]
    if item is None:
        options.append(f"--otmcp-reps={settings['reps']}")
        named = [suite for suite in settings.get("suites", BENCHMARK) if suite != FIELD]
        if named not in ([], [*BENCHMARK]):
            options.append(f"--otmcp-suite={','.join(named)}")
    elif item["suite"] == REQUIREMENTS:
        options.append(f"--otmcp-only={item['id']}")
    else:
        # A suite's repetitions are a share of N: N must be large enough for this repetition to be among them.
        reps = next(reps for reps in count(1) if repetitions(reps).get(item["suite"], 1) > repetition)
        options += [f"--otmcp-reps={reps}", "-k", f"[{item['id']}]"]
    usual = {"seed": 0, "era": "auto", "time_scale": 1.0}
    usual |= {device.option: "embedded" for device in external_devices().values() if device.option != DEVICE}
    for name, value in usual.items():
        chosen = cast(dict[str, object], settings).get(name, value)
        if chosen != value:
            options.append(f"--otmcp-{name.replace('_', '-')}={chosen}")
    if further := settings.get("protocols"):
        options.append(f"--otmcp-protocols={','.join(further)}")
    if settings.get("soak"):
        options.append("--otmcp-soak")
    options += [f"--otmcp-{DEVICE}={key}={device['url']}" for key, device in settings.get("devices", {}).items()]
    if settings.get("subject"):
        options.append(f"--otmcp-subject={settings['subject']}")
    return shlex.join(["pytest", *options])
