"""The fault suite: requests that must be refused, in words an assistant can act on, with nothing changed.

A well-formed error is the point. An adapter that is dead, lacks the tool, prints a traceback or answers with nothing
does not pass: the envelope must name the fault, and the device must show that it was met, or never reached.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pytest_otmcp.trial.task import Task

from .tasks import tasks


@pytest.mark.parametrize("task", tasks("fault"), ids=lambda task: task.id)
def test_fault(task: Task, otmcp_trial: Callable[[Task], None]) -> None:
    otmcp_trial(task)
