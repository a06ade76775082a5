"""The recovery suite: one outage per trial, and the time until the assistant can work again."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pytest_otmcp.trial.task import Task

from .tasks import tasks


@pytest.mark.parametrize("task", tasks("recovery"), ids=lambda task: task.id)
def test_recovery(task: Task, _otmcp_trial: Callable[[Task], None]) -> None:
    _otmcp_trial(task)
