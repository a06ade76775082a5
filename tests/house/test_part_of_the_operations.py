"""An adapter with a part of the operations: every capability that it claims has an item behind it, or the report says that none was asked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from pytest_otmcp.core.capability import Capability
from pytest_otmcp.core.verdict import Status
from pytest_otmcp.protocols.own import OWN
from pytest_otmcp.protocols.protocol import ANY_READ, GUARD, RECOVERY
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.report.capabilities import Earned, Grade, earned
from pytest_otmcp.subject import Adapter, reference_subject
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.applicability import applicability
from tests.unit.samples import adapter, item, run


def parts(key: str) -> Iterator[tuple[str, ...]]:
    """Yield sets of operations: one that reads, one that writes, each pair of them, and everything that reads, or writes."""
    operations = protocols()[key].operations
    reads = [name for name, operation in operations.items() if not operation.writes]
    writes = [name for name, operation in operations.items() if operation.writes]
    yield from ((name,) for name in operations)
    yield from ((read, write) for read in reads for write in writes)
    yield tuple(reads)
    yield tuple(writes)
    yield tuple(operations)


def having(key: str, part: tuple[str, ...], *also: str) -> Adapter:
    """Return the reference adapter of a protocol as one that has these operations alone.

    Args:
        also: facets beside the operations that it does not claim.
    """
    genuine = reference_subject().adapters[key]
    left_out = dict.fromkeys((*(name for name in protocols()[key].operations if name not in part), *also), "has none")
    return replace(
        genuine,
        operations={name: binding for name, binding in genuine.operations.items() if name in part},
        unclaimed={**genuine.unclaimed, **left_out},
    )


def applying(key: str, described: Adapter) -> dict[str, str | None]:
    """Return why each item of the protocol does not apply to an adapter, or None."""
    found = {}
    for task in tasks_by_id([key]).values():
        if task.protocols == (key,):
            obstacle = applicability(task, {key: described})
            assert obstacle is None or obstacle[0] is Status.NOT_APPLICABLE, obstacle
            found[task.id] = None if obstacle is None else obstacle[1]
    return found


def graded(key: str, described: Adapter) -> dict[str, Earned]:
    """Return the grades of an adapter that passes every item that applies to it."""
    tasks = tasks_by_id([key])
    entries: list[dict[str, Any]] = []
    for name, obstacle in applying(key, described).items():
        entry = item(name, tasks[name].suite, tasks[name].family, tasks[name].title, [1.0])
        told = {
            "status": "PASS" if obstacle is None else "NOT_APPLICABLE",
            "capabilities": list(tasks[name].capabilities),
        }
        entries.append({**entry, **told})
    record = run(entries)
    facts = adapter(1, unclaimed=dict(described.unclaimed), offered=sorted(described.offered))
    record["subject"]["adapters"] = {key: facts}
    return {heading.name: by_family[protocols()[key].name] for heading, by_family in earned(record)}


def outages(key: str) -> set[str]:
    tasks = tasks_by_id([key]).values()
    return {task.id for task in tasks if task.protocols == (key,) and Capability.OUTAGES in task.capabilities}


@pytest.mark.parametrize("key", OWN)
def test_who_asks_its_device_for_anything_is_taken_through_an_outage(key: str) -> None:
    asking = set(protocols()[key].alternatives(ANY_READ, ()))
    for part in parts(key):
        for also in ((), (RECOVERY,)):
            obstacles = applying(key, having(key, part, *also))
            away = {name for name in outages(key) if obstacles[name] is None}
            expected = {name for name in outages(key) if name.startswith("R-")} if also else outages(key)
            assert away == (expected if asking & set(part) else set()), (part, also)


@pytest.mark.parametrize("key", [pytest.param(key, marks=() if key == "modbus" else pytest.mark.long) for key in OWN])
def test_what_is_claimed_is_earned_by_an_item_or_called_not_asked(key: str) -> None:
    for part in parts(key):
        kinds = {protocols()[key].operations[name].writes for name in part}
        claimed = {"Reading": False in kinds, "Writing": True in kinds, "Write protection": True in kinds}
        grades = graded(key, having(key, part))
        for name, grade in grades.items():
            if claimed.get(name, True):
                assert grade.grade in (Grade.EARNED, Grade.NOT_ASKED), (part, name, grade)
                assert (grade.grade is Grade.EARNED) == bool(grade.because), (part, name, grade)
            else:
                assert grade.grade is Grade.NOT_CLAIMED, (part, name, grade)
        if grades["Writing"].grade is Grade.EARNED:
            assert grades["Surviving outages"].grade is Grade.EARNED, part
    assert (
        graded(key, having(key, tuple(protocols()[key].operations), GUARD))["Write protection"].grade
        is Grade.NOT_CLAIMED
    )


def test_who_can_be_asked_nothing_is_not_said_to_write() -> None:
    assert graded("mqtt", having("mqtt", ("publish",)))["Writing"].grade is Grade.NOT_ASKED
    assert graded("modbus", having("modbus", ("write_holding",)))["Writing"].grade is Grade.NOT_ASKED
