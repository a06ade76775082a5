"""One defective adapter, judged: the one way in which both the self-check and the kit's tests do it."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

from ..core.verdict import Status
from ..plant.devices import Plant
from ..record.schema import Sample
from ..subject import named_subject, reference_subject
from ..suite.catalogue import all_tasks
from ..trial.bench import Bench
from ..trial.live_driver import LiveDriver
from ..trial.task import Task
from ..trial.trial import Trial
from .among_genuine import AmongGenuine, sooner, with_command
from .defect import DEFECTS, Defect
from .seen import Seen
from .warm_start import WarmStart

__all__ = ["IMPATIENT", "Item", "failing", "judge", "measured", "noted", "tasks_of", "words"]

IMPATIENT = 0.4
"""Time scale for adapters that hang: deadlines of 2 s, still long enough for calls that end at the adapter's own deadline of 1.4 s."""

_SOONER = 0.5
"""Factor on the seconds that the adapters wait: half of those of a certificate, which a machine that stops for two seconds must not use up."""

_PASSED = (Status.PASS, Status.NOT_APPLICABLE)
_MOST_WORDS = 10

Item = Mapping[str, Any]
"""An item as ``run.json`` has it, with its samples."""


def tasks_of(defect: Defect) -> list[Task]:
    """Return the tasks of a run over this defect, in the suite's order."""
    return [task for task in all_tasks().values() if defect.protocol in task.adapters and defect.is_run(task)]


async def judge(plant: Plant, warm: WarmStart, defect: Defect) -> Seen:
    """Run the tasks over the adapter with this defect, once each.

    Args:
        plant: the devices; their adapters have ended.
        warm: starts the adapters.

    Raises:
        KitError: a mock device could not be started.
    """
    program = ("-P", "-m", DEFECTS, defect.id)
    command = (sys.executable, *program) if defect.cold else (*warm.words(defect.protocol), *program)
    genuine = sooner(named_subject() if defect.named else reference_subject(), _SOONER, whole_calls=defect.waits)
    subject = with_command(warm.subject(genuine), defect.protocol, command)
    bench = AmongGenuine(subject, plant, defect.protocol, IMPATIENT if defect.waits else 1.0)
    try:
        items = [await measured(bench, task) for task in tasks_of(defect)]
    finally:
        await bench.close()
    return Seen(
        items=frozenset(failing(items)),
        requirements=frozenset(noted(items)),
        faults=tuple(f"{item['id']}: {item['reason']}" for item in items if item["status"] == Status.KIT_ERROR),
        words=tuple(words(defect, items))[:_MOST_WORDS],
    )


def words(defect: Defect, items: Sequence[Item]) -> list[str]:
    """Return each finding with its item, and why items did not pass without one; what the defect does not declare comes first."""
    told = [
        (name in defect.items and _cited(finding) in (*defect.requirements, None), f"{name}: {finding['message']}")
        for name, finding in _findings(items)
    ]
    silent = failing(items) - {name for name, _ in _findings(items)}
    told += [(item["id"] in defect.items, f"{item['id']}: {item['reason']}") for item in items if item["id"] in silent]
    return [text for _, text in sorted(told, key=itemgetter(0))]


async def measured(bench: Bench, task: Task, repetitions: int = 1) -> dict[str, Any]:
    """Run a task and return the item with its samples."""
    samples: list[Sample] = []
    item = await Trial(LiveDriver(bench, task, seed=0), task, repetitions, keep=samples.append).run()
    return {**item, "samples": samples}


def failing(items: Iterable[Item]) -> set[str]:
    """Return the ids of all items but those that passed and those that do not apply."""
    return {item["id"] for item in items if item["status"] not in _PASSED}


def noted(items: Iterable[Item]) -> set[str]:
    """Return the requirements that the findings cite, and the codes of findings that cite none.

    A finding that follows from another one does not count.
    """
    return {cited for _, finding in _findings(items) if (cited := _cited(finding))}


def _cited(finding: Mapping[str, Any]) -> str | None:
    return finding["requirement"] or finding["code"] if finding["cause"] is None else None


def _findings(items: Iterable[Item]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for item in items:
        for part in (item, *item["samples"]):
            for finding in part["findings"]:
                yield item["id"], finding
