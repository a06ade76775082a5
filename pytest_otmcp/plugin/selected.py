"""The adapters and the tasks of this run, as its options and its subject file select them."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, NoReturn

import pytest

from ..core.errors import UsageError
from ..core.matrix import REQUIREMENTS
from ..core.text import one_line
from .stash import SELECTION, SETTINGS

if TYPE_CHECKING:
    from ..subject.selection import Selection
    from ..trial.task import Task

__all__ = ["known_rows", "refuse", "required_tasks", "select_adapters"]


def refuse(error: UsageError) -> NoReturn:
    """End the run with one sentence and exit code 2."""
    pytest.exit(one_line(str(error)), returncode=2)


def known_rows(asked: tuple[str, ...]) -> tuple[str, ...]:
    """Return the rows and checks that were asked for as the catalogue spells them; their case does not matter.

    Raises:
        UsageError: there is no check of one of them.
    """
    if not asked:
        return ()
    from ..suite.catalogue import all_tasks
    from ..suite.requirements import requirements

    checks = [task for task in all_tasks().values() if task.suite == REQUIREMENTS]
    known = {name.casefold(): name for task in checks for name in (task.id, *task.requirements)}
    for name in asked:
        if name.casefold() in known:
            continue
        if name.upper() in requirements():
            raise UsageError(
                f"--otmcp-only: {name} has no check of its own; otmcp explain {name} says where it is judged"
            )
        near = difflib.get_close_matches(name.casefold(), sorted(known), 1)
        hint = f"did you mean {known[near[0]]}?" if near else "'otmcp docs checks' lists them"
        raise UsageError(f"--otmcp-only: there is no row or check {name!r}; {hint}")
    return tuple(known[name.casefold()] for name in asked)


def select_adapters(config: pytest.Config) -> Selection:
    """Return the adapters of this run; a mistake in the subject file ends it."""
    from ..subject.selection import select, without_cable

    if SELECTION not in config.stash:
        settings = config.stash[SETTINGS]
        try:
            config.stash[SELECTION] = without_cable(select(settings.subject, settings.protocols), _cable_refused)
        except UsageError as error:
            refuse(error)
    return config.stash[SELECTION]


def _cable_refused() -> str | None:
    from ..session.cable import cable_refused

    return cable_refused()


def required_tasks(config: pytest.Config) -> dict[str, Task]:
    """Return the tasks that a run with these adapters must have, by id."""
    from ..suite.catalogue import tasks_by_id

    settings = config.stash[SETTINGS]
    return tasks_by_id(select_adapters(config).subject.adapters, settings.suites, settings.devices)
