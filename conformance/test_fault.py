"""The fault suite: requests that must be refused, in words on which an assistant can act, with nothing changed.

The tasks require a well-formed error. An adapter that is dead, lacks the tool, prints a traceback or answers with nothing
does not pass: the envelope must name the fault, and the device must show that the faulty request, or no request, reached it.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pytest_otmcp.trial.task import Task

from .tasks import tasks


@pytest.mark.parametrize("task", tasks("fault"), ids=lambda task: task.id)
def test_fault(task: Task, _otmcp_trial: Callable[[Task], None]) -> None:
    _otmcp_trial(task)
