"""The adapters and the tasks of this run, as its options and its subject file select them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import pytest

from ..core.errors import UsageError
from ..core.text import one_line
from .stash import SELECTION, SETTINGS

if TYPE_CHECKING:
    from ..subject.selection import Selection
    from ..trial.task import Task

__all__ = ["refuse", "required_tasks", "select_adapters"]


def refuse(error: UsageError) -> NoReturn:
    """End the run with one sentence and exit code 2."""
    pytest.exit(one_line(str(error)), returncode=2)


def select_adapters(config: pytest.Config) -> Selection:
    """Return the adapters of this run; a mistake in the subject file ends it."""
    from ..subject.selection import select

    if SELECTION not in config.stash:
        settings = config.stash[SETTINGS]
        try:
            config.stash[SELECTION] = select(settings.subject, settings.protocols)
        except UsageError as error:
            refuse(error)
    return config.stash[SELECTION]


def required_tasks(config: pytest.Config) -> dict[str, Task]:
    """Return the tasks that a run with these adapters must have, by id."""
    from ..suite.catalogue import tasks_by_id

    return tasks_by_id(select_adapters(config).subject.adapters, config.stash[SETTINGS].suites)
