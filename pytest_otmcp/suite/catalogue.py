"""The shipped suite and kit, for whoever needs the tasks without collecting them, or wants to know which they are."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from importlib import import_module, resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

    from ..trial.task import Task

__all__ = ["kit_digest", "suite_digest", "tasks_by_id"]

_JUDGING = ("pytest_otmcp", "pytest_otmcp.conformance", "pytest_otmcp.mocks")
"""The packages that decide what a run comes to; the reference adapters are subjects like any other."""

_MAPPED = ("conformance", "mocks", "reference_adapters")
_KINDS = (".py", ".json", ".toml")


def tasks_by_id() -> dict[str, Task]:
    """Every task of the shipped suite, in its order."""
    tasks: dict[str, Task] = {}
    for name in ("normal", "fault", "stress", "recovery"):
        module = import_module(f"pytest_otmcp.conformance.test_{name}")
        tasks |= {task.id: task for task in getattr(module, name.upper())}
    return tasks


@cache
def suite_digest() -> str:
    """``sha256:…`` over the conformance modules in this process's import path: which suite a run was."""
    return _digest(["pytest_otmcp.conformance"])


@cache
def kit_digest() -> str:
    """``sha256:…`` over everything that judges: kit, suite and mock devices; the same from a wheel and from a checkout."""
    return _digest(_JUDGING)


def _digest(packages: list[str] | tuple[str, ...]) -> str:
    digest = hashlib.sha256()
    for package in packages:
        for name, file in sorted(_files(package, resources.files(package))):
            digest.update(name.encode() + b"\0" + file.read_bytes() + b"\0")
    return "sha256:" + digest.hexdigest()


def _files(name: str, folder: Traversable) -> Iterator[tuple[str, Traversable]]:
    for entry in folder.iterdir():
        if entry.name.endswith(_KINDS):
            yield f"{name}/{entry.name}", entry
        # In a wheel the mapped folders lie in the kit's, in a checkout beside it; each has its own turn.
        elif entry.is_dir() and not (name == "pytest_otmcp" and entry.name in _MAPPED):
            yield from _files(f"{name}/{entry.name}", entry)
