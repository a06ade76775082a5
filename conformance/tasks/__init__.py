"""The tasks of the conformance suite: one module for each protocol, one for tasks on several protocols.

A protocol's description names the module of its tasks, so the tasks of a protocol that an installed package registers are
found the same way.
"""

from __future__ import annotations

import math
from importlib import import_module

from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.task import Task

__all__ = ["MODULES_APART", "modules", "tasks"]

MODULES_APART = (f"{__name__}.cross",)
"""Modules with tasks that belong to no single protocol."""


def modules() -> tuple[str, ...]:
    """Return the dotted names of all modules that declare tasks, in the order of tables and figures. Protocols may share one."""
    return (*dict.fromkeys(protocol.tasks for protocol in protocols().values()), *MODULES_APART)


def tasks(suite: str | None = None) -> list[Task]:
    """Return the tasks of every protocol, of one suite or of all, in the order in which they run."""
    declared = [task for module in modules() for task in import_module(module).TASKS]
    # The sort is stable: tasks without a position of their own come last, in the order of their declaration.
    ordered = sorted(declared, key=lambda task: (SUITES.index(task.suite), task.position or math.inf))
    return [task for task in ordered if suite in (None, task.suite)]
