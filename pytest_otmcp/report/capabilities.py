"""The capabilities that an adapter has earned, for each protocol, and the items that decided them. Pure.

A capability is earned when every item behind it passed, and no finding of any item is about one of its requirements. A capability with an
item that is missing, or whose failure does not speak against it, is undecided: a narrowed run can only earn less. Writing is earned by an
adapter alone that was taken through an outage: there its writes have failed, and said so. The items say which capabilities they are about, checks by the row that they judge; the
suite says which items there should be. What a subject claims is said by its adapters' facts, never by what happened to apply.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from ..core.capability import Capability
from ..core.matrix import BENCHMARK, REQUIREMENTS
from ..core.verdict import Status
from ..protocols.protocol import GUARD, Operation
from ..protocols.registry import protocols
from ..record.schema import Finding
from ..record.warnings import failing, findings_of, passed_beside
from ..suite.catalogue import all_tasks, tasks_by_id
from ..suite.requirements import requirements
from ..trial.task import Task
from . import Item, Run, adapters
from .families import families, spoken_families

__all__ = ["Earned", "Grade", "Heading", "earned"]


class Grade(StrEnum):
    """Grade of one capability of one protocol in a run."""

    EARNED = "earned"
    NOT_EARNED = "not earned"
    UNDECIDED = "undecided"
    NOT_CLAIMED = "not claimed"
    NOT_ASKED = "not asked"
    NOT_TESTED = "not tested"


@dataclass(frozen=True, slots=True, kw_only=True)
class Heading:
    """A capability as tables print it.

    Attributes:
        name: a word or two.
        meaning: what an earned capability means.
        facet: the facet that the subject has to claim for it, where the items also apply without that claim.
    """

    name: str
    meaning: str
    facet: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Earned:
    """One capability of one protocol.

    Attributes:
        grade: ``not claimed`` where the subject has nothing of the kind; ``not asked`` where it has, and no item applies that tests it.
        because: ids of the items that decided it: those that failed or are missing, or else all that passed.
        without: ids of items behind it that need a facet which the subject does not claim.
    """

    grade: Grade
    because: tuple[str, ...] = ()
    without: tuple[str, ...] = ()


_HEADINGS: Mapping[str, Heading] = {
    Capability.READING: Heading(
        name="Reading", meaning="values, messages and structure arrive as the device holds them"
    ),
    Capability.WRITING: Heading(
        name="Writing", meaning="what is reported as written reached the device, once and unchanged"
    ),
    Capability.WRITE_PROTECTION: Heading(
        name="Write protection", meaning="with writes disabled, no write reaches the device", facet=GUARD
    ),
    Capability.REFUSING: Heading(
        name="Refusing bad requests",
        meaning="what is wrong is refused with the right error, and changes nothing",
    ),
    Capability.LOAD: Heading(name="Load", meaning="parallel calls and long series get their own answers"),
    Capability.OUTAGES: Heading(
        name="Surviving outages",
        meaning="an endpoint that goes away is reported, and used again when it is back",
    ),
}
_FURTHER = Heading(name="Further requirements", meaning="the other items of the suite passed")

_FORM = ("ENV", "KEY", "INJ")
"""Areas of requirements about the form of what an adapter says, and about what it must not tell."""

_WRITTEN = {"wrote", "unasked_write", "written_twice", "not_written_once", "device_differs", "driven"}
"""Codes of findings about a device to which something was written, or that holds something else than it did."""

_READING, _WRITING = {False}, {True}
_ANY = _READING | _WRITING
_OPERATIONS = {Capability.READING: _READING, Capability.WRITING: _WRITING, Capability.WRITE_PROTECTION: _WRITING}
"""Whether a capability is about operations that write; the others are about every operation."""

_Ids = dict[str, list[str]]
"""Family to ids of items, in the order of the suite."""


def earned(run: Run) -> list[tuple[Heading, dict[str, Earned]]]:
    """Return each capability with its grade in every family of the run.

    Items about no capability that is known here form a capability of their own, so that none of their failures is overlooked.
    """
    wanted, further = _wanted(run)
    lost = _lost(run)
    items = {item["id"]: item for item in run["items"]}
    rows = [
        (
            heading,
            wanted[name],
            lost[name],
            _elsewhere(run, name),
            _not_claimed(run, heading.facet),
            _claiming(run, name),
        )
        for name, heading in _HEADINGS.items()
    ]
    if further:
        rows.append((_FURTHER, further, {}, set(), set(), {*families(run), *spoken_families(run)}))
    away = wanted[Capability.OUTAGES]
    return [
        (
            heading,
            {
                family: Earned(grade=Grade.NOT_CLAIMED)
                if family in unclaimed
                else _also_away(
                    heading,
                    _of_values(
                        heading,
                        _grade(ids.get(family, ()), items, losing.get(family, ()), elsewhere, family in claiming),
                    ),
                    away.get(family, ()),
                    items,
                )
                for family in dict.fromkeys([*families(run), *spoken_families(run)])
            },
        )
        for heading, ids, losing, elsewhere, unclaimed, claiming in rows
    ]


def _wanted(run: Run) -> tuple[dict[str, _Ids], _Ids]:
    """Return the ids of the items behind each capability, by family, and of the items behind none."""
    behind: dict[str, tuple[str, Collection[str]]] = {
        task.id: (task.family, _of_task(task))
        for task in tasks_by_id(
            run["subject"]["adapters"], run["settings"].get("suites", BENCHMARK), run["settings"].get("devices", ())
        ).values()
    }
    behind |= {item["id"]: (item["family"], _capabilities(item)) for item in run["items"]}
    wanted: dict[str, _Ids] = {name: {} for name in _HEADINGS}
    further: _Ids = {}
    for identifier, (family, capabilities) in behind.items():
        for ids in [wanted[name] for name in capabilities if name in wanted] or [further]:
            ids.setdefault(family, []).append(identifier)
    return wanted, further


def _lost(run: Run) -> dict[str, _Ids]:
    """Return the ids of the items with a finding about a requirement of each capability, by family.

    An item about refusing 70000 may find that it was written as 4464: then writing is not earned, whichever items are
    about writing.
    """
    lost: dict[str, _Ids] = {name: {} for name in _HEADINGS}
    for item in run["items"]:
        if item["status"] != Status.FAIL:
            continue
        broken = {finding["requirement"] for finding in failing(findings_of(item))}
        rows = [row for name in broken if name is not None and (row := requirements().get(name)) is not None]
        for name in {capability for row in rows for capability in row.capabilities}:
            lost[name].setdefault(item["family"], []).append(item["id"])
    return lost


def _elsewhere(run: Run, capability: str) -> set[str]:
    """Return the ids of the items whose failure does not speak against a capability.

    That an answer has another form says nothing of what was read or written. With writes disabled, whatever is wrong is no matter of write
    protection, as long as nothing was written.
    """

    def speaks(finding: Finding) -> bool:
        requirement = str(finding["requirement"])
        row = requirements().get(requirement)
        if row is None or capability in row.capabilities:
            return True
        if capability == Capability.WRITE_PROTECTION:
            return finding["code"] in _WRITTEN
        return requirement.partition("-")[0] not in _FORM

    return {
        item["id"]
        for item in run["items"]
        if item["status"] == Status.FAIL and (findings := failing(findings_of(item))) and not any(map(speaks, findings))
    }


def _capabilities(item: Item) -> Collection[str]:
    if item["capabilities"]:
        return [str(name) for name in item["capabilities"]]
    # A record of an earlier kit does not name the capabilities; the task of that id does.
    task = all_tasks().get(item["id"])
    return () if task is None else _of_task(task)


def _of_task(task: Task) -> Collection[str]:
    """Return the capabilities of a task; a check is about those of its row."""
    if task.suite != REQUIREMENTS:
        return task.capabilities
    return {name for row in task.requirements for name in requirements()[row].capabilities}


def _not_claimed(run: Run, facet: str | None) -> set[str]:
    """Return the families whose adapter does not claim ``facet``."""
    return {
        protocols()[key].name
        for key, facts in adapters(run).items()
        if key in protocols() and facet in facts.get("unclaimed", {})
    }


def _claiming(run: Run, capability: str) -> set[str]:
    """Return the families whose adapter has an operation that a capability is about."""
    kinds = _OPERATIONS.get(Capability(capability), _ANY)
    return {
        protocol.name
        for key, facts in adapters(run).items()
        if (protocol := protocols().get(key)) is not None
        and any(
            operation.writes in kinds and _has(facts, name, operation)
            for name, operation in protocol.operations.items()
        )
    }


def _has(facts: Mapping[str, Any], name: str, operation: Operation) -> bool:
    if name in facts.get("unclaimed", {}):
        return False
    return not operation.voluntary or name in facts.get("offered", ())


def _of_values(heading: Heading, found: Earned) -> Earned:
    """Return the grade of a capability, which for reading is about values: that the device can be reached is none."""
    if heading is not _HEADINGS[Capability.READING] or found.grade is not Grade.EARNED:
        return found
    if not all(map(_is_about_status, found.because)):
        return found
    return Earned(grade=Grade.NOT_ASKED, without=(*found.because, *found.without))


def _is_about_status(identifier: str) -> bool:
    task = all_tasks().get(identifier)
    needs = [] if task is None else [facet.partition(".") for facet in task.needs]
    known = [protocols()[protocol].operations.get(name) for protocol, _, name in needs if protocol in protocols()]
    return bool(known) and all(operation is not None and operation.status for operation in known)


def _also_away(heading: Heading, found: Earned, outages: Sequence[str], items: Mapping[str, Item]) -> Earned:
    """Return the grade of a capability, which for writing has to be shown while the device is away as well.

    Args:
        outages: ids of the items that take the adapter through an outage.
    """
    if heading is not _HEADINGS[Capability.WRITING] or found.grade is not Grade.EARNED or not outages:
        return found
    statuses = {name: items[name]["status"] if name in items else None for name in outages}
    if any(status in (Status.PASS, Status.FAIL) for status in statuses.values()):
        return found
    open_ = tuple(name for name, status in statuses.items() if status != Status.NOT_APPLICABLE)
    without = (*found.without, *(name for name in outages if name not in open_))
    return replace(found, grade=Grade.UNDECIDED if open_ else Grade.NOT_ASKED, because=open_, without=without)


def _grade(
    wanted: Sequence[str], items: Mapping[str, Item], losing: Sequence[str], elsewhere: Collection[str], claimed: bool
) -> Earned:
    # What was seen of a session beside the steps is counted once, at its own row.
    statuses = {
        name: None if name not in items else Status.PASS if passed_beside(items[name]) else items[name]["status"]
        for name in wanted
    }

    def select(*found: Status | None) -> tuple[str, ...]:
        return tuple(name for name, status in statuses.items() if status in found)

    unclaimed = select(Status.NOT_APPLICABLE)
    beside = tuple(name for name in select(Status.FAIL) if name in elsewhere)
    if failed := tuple(name for name in select(Status.FAIL, Status.NOT_TESTABLE) if name not in beside):
        return Earned(grade=Grade.NOT_EARNED, because=tuple(dict.fromkeys((*failed, *losing))), without=unclaimed)
    if losing and (claimed or len(unclaimed) < len(wanted)):
        return Earned(grade=Grade.NOT_EARNED, because=tuple(losing), without=unclaimed)
    if not wanted:
        return Earned(grade=Grade.NOT_TESTED)
    if undecided := (*beside, *select(Status.KIT_ERROR, Status.INTERRUPTED, None)):
        return Earned(grade=Grade.UNDECIDED, because=undecided, without=unclaimed)
    if passed := select(Status.PASS):
        return Earned(grade=Grade.EARNED, because=passed, without=unclaimed)
    return Earned(grade=Grade.NOT_ASKED if claimed else Grade.NOT_CLAIMED, without=unclaimed)
