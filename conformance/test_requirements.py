"""The requirement suite: for each row of the catalogue and each protocol, one check.

The benchmark's four suites ask what an assistant would ask. This one asks what nobody should ask, makes devices lie, fall silent
and vanish, and looks at every answer and every byte: its items say whether an adapter meets the rule that has their name.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pytest_otmcp.trial.task import Task

from .requirements import checks


@pytest.mark.parametrize("task", checks(), ids=lambda task: task.id)
def test_requirements(task: Task, _otmcp_trial: Callable[[Task], None]) -> None:
    _otmcp_trial(task)
