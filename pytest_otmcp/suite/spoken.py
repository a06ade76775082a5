"""The items about the protocols that a subject speaks, and how they ended: what every report counts, and of how many. Pure.

An item that needs an adapter which the subject does not have says nothing about it, and is counted nowhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

from ..core.matrix import BENCHMARK
from ..core.verdict import Status
from ..record.schema import Item, Run
from ..trial.applicability import NO_ADAPTER
from .catalogue import all_tasks, tasks_by_id

__all__ = ["Spoken", "of_spoken", "spoken", "tell"]


@dataclass(slots=True, kw_only=True)
class Spoken:
    """Numbers of items of a family.

    Attributes:
        of: those that there are in the suites of the run.
        passed: those that passed.
        failed: those that apply, ended and did not pass.
        unclaimed: those that do not apply.
    """

    of: int = 0
    passed: int = 0
    failed: int = 0
    unclaimed: int = 0


def spoken(run: Run) -> dict[str, Spoken]:
    """Return the numbers of items by family, for the families of which the subject has every adapter."""
    found: dict[str, Spoken] = {}
    ran, adapters = {item["id"]: item for item in run["items"]}, run["subject"]["adapters"]
    for item in ran.values():
        if not _foreign(item, adapters):
            count = found.setdefault(item["family"], Spoken())
            count.of += 1
            count.passed += item["status"] == Status.PASS
            count.unclaimed += item["status"] == Status.NOT_APPLICABLE
            count.failed += item["status"] not in (Status.PASS, Status.NOT_APPLICABLE, Status.INTERRUPTED)
    for name, task in tasks_by_id(
        adapters, run["settings"].get("suites", BENCHMARK), run["settings"].get("devices", ())
    ).items():
        if name not in ran and adapters.keys() >= {*task.protocols}:
            found.setdefault(task.family, Spoken()).of += 1
    return found


def of_spoken(run: Run) -> Run:
    """Return a run without the items of protocols that the subject does not speak."""
    adapters = run["subject"]["adapters"]
    return cast("Run", {**run, "items": [item for item in run["items"] if not _foreign(item, adapters)]})


def _foreign(item: Item, adapters: Mapping[str, object]) -> bool:
    if item["status"] != Status.NOT_APPLICABLE:
        return False
    task = all_tasks().get(item["id"])
    # A run in which nothing applied started no adapter, and has facts of none.
    lacks = task is not None and bool(adapters) and not adapters.keys() >= {*task.protocols}
    return lacks or (item["reason"] or "").startswith(NO_ADAPTER)


def tell(counts: Mapping[str, Spoken]) -> str:
    """Say in one clause how many items passed, of how many, and what became of the others that ran."""
    passed, failed, unclaimed, of = (
        sum(getattr(count, name) for count in counts.values()) for name in ("passed", "failed", "unclaimed", "of")
    )
    name = f"{next(iter(counts))} " if len(counts) == 1 else ""
    told = [f"{passed} of {of} {name}{'item' if of == 1 else 'items'} passed"]
    told += [f"{failed} did not"] if failed else []
    told += [f"{unclaimed} {'does' if unclaimed == 1 else 'do'} not apply"] if unclaimed else []
    return ", ".join(told)
