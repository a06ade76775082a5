"""The normal suite: tasks that any adapter for a plant must perform correctly, judged at the device."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pytest_otmcp.trial.task import Task

from .tasks import tasks


@pytest.mark.parametrize("task", tasks("normal"), ids=lambda task: task.id)
def test_normal(task: Task, _otmcp_trial: Callable[[Task], None]) -> None:
    _otmcp_trial(task)
