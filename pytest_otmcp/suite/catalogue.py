"""The shipped suite and kit as data: the tasks, without a collection by pytest, and digests that identify both."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from importlib import import_module
from types import ModuleType

from ..core.digest import files_digest
from ..core.matrix import BENCHMARK, FIELD, REQUIREMENTS
from ..protocols.protocol import OtProtocol
from ..protocols.registry import protocols
from ..record.schema import Protocol
from ..trial.task import Task
from .package import SUITE
from .requirements import cited

__all__ = [
    "KIT",
    "SHARED_ITEMS",
    "SUITE",
    "all_tasks",
    "field_tasks",
    "identity",
    "kit_digest",
    "known_tasks",
    "suite_digest",
    "task_modules",
    "tasks_by_id",
]

KIT = "pytest-otmcp"
"""Name of the kit in records."""

SHARED_ITEMS = f"{SUITE}.tasks.further"
"""The module whose steps any protocol's tasks may have."""

_FIELD_ITEMS = f"{SUITE}.field"

_PACKAGE = __package__.partition(".")[0]

_MOCKS = f"{_PACKAGE}.mocks"
_ADAPTERS = f"{_PACKAGE}.reference_adapters"
_BUILT = (f"{_PACKAGE}.docs", f"{_PACKAGE}.record.run.schema.json", f"{_PACKAGE}.subject.subject.schema.json")
"""What is in every wheel and not in every checkout. None of it judges."""


def _declarations() -> tuple[ModuleType, ModuleType]:
    return import_module(f"{SUITE}.tasks"), import_module(f"{SUITE}.requirements")


def task_modules() -> tuple[str, ...]:
    """Return the dotted names of the modules that declare the tasks of the suite."""
    return (*(name for declaring in _declarations() for name in declaring.modules()), _FIELD_ITEMS)


def all_tasks() -> dict[str, Task]:
    """Return every task by id in the suite's order, also the tasks that run only for a subject with their protocol.

    Raises:
        ValueError: a task cites a requirement that the catalogue does not have; one sentence.
    """
    benchmark, requirements = _declarations()
    tasks = {task.id: task for task in (*benchmark.tasks(), *requirements.checks())}
    for task in tasks.values():
        cited(task.id, task.requirements)
    return tasks


def field_tasks() -> dict[str, Task]:
    """Return the tasks of real devices by id: they are part of no level, and of no run without such a device."""
    return {task.id: task for task in import_module(_FIELD_ITEMS).TASKS}


def known_tasks() -> dict[str, Task]:
    """Return every task that an item of a record may have, by id."""
    return {**all_tasks(), **field_tasks()}


def tasks_by_id(
    adapters: Collection[str] = (), suites: Collection[str] = BENCHMARK, devices: Collection[str] = ()
) -> dict[str, Task]:
    """Return the tasks that a run must have, by id, in the suite's order.

    The benchmark's suites belong together: who asks for one of them has a run of the benchmark that is not whole. The requirement
    suite is part of a run that asks for it, alone or beside the benchmark.

    Args:
        adapters: protocols for which the subject has an adapter. Tasks on the kit's own protocols are always required,
            tasks on other protocols only when the subject has an adapter for them.
        suites: suites that the run has asked for.
        devices: protocols for which the run has a real device; the others have no items of such.
    """
    wanted = {*(BENCHMARK if {*BENCHMARK} & {*suites} else ()), *({REQUIREMENTS, FIELD} & {*suites})}
    return {
        name: task
        for name, task in known_tasks().items()
        if task.suite in wanted
        and all(protocols()[key].always or key in adapters for key in task.protocols)
        and (task.suite != FIELD or all(key in devices for key in task.protocols))
    }


@cache
def suite_digest() -> str:
    """Return ``sha256:…`` over the conformance modules on this process's import path, which identifies the suite."""
    return files_digest(SUITE)


@cache
def kit_digest() -> str:
    """Return ``sha256:…`` over all code that judges: kit, suite and mock devices.

    The digest is the same from a wheel and from a checkout. The reference adapters do not count: they are subjects like
    any other.
    """
    # In a wheel the other rooms lie inside of the kit's folder, in a checkout beside it; so each is read separately.
    return files_digest(_PACKAGE, SUITE, _MOCKS, excluded=(SUITE, _MOCKS, _ADAPTERS, *_BUILT))


def identity(protocol: OtProtocol) -> Protocol:
    """Return what a record says about a protocol of its run: which package judged, where that is not the kit."""
    origin = protocol.origin
    return {
        "key": protocol.key,
        "name": protocol.name,
        "distribution": None if origin is None else origin.distribution,
        "version": None if origin is None else origin.version,
        "digest": None if origin is None else origin.digest,
    }
