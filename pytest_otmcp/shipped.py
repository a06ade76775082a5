"""The shipped suite, for whoever needs its tasks without collecting it."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .task import Task

__all__ = ["tasks_by_id"]


def tasks_by_id() -> dict[str, Task]:
    """Every task of the shipped suite, in its order."""
    tasks: dict[str, Task] = {}
    for name in ("normal", "fault", "stress", "recovery"):
        module = import_module(f"pytest_otmcp.conformance.test_{name}")
        tasks |= {task.id: task for task in getattr(module, name.upper())}
    return tasks
