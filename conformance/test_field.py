"""The suite of a real device: what can be judged where it is only read, and written to as far as a person consents."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pytest_otmcp.trial.task import Task

from .field import TASKS


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.id)
def test_field(task: Task, _otmcp_trial: Callable[[Task], None]) -> None:
    _otmcp_trial(task)
