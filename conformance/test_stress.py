"""The stress suite: concurrent calls, fifty calls in a row, and an endpoint that goes away in the middle.

The restart tasks have three phases and all three are asserted: the read before the outage works, the read during the outage
fails with an envelope within its deadline, the read after it works. Then a command is given during an outage: it must fail,
and must not be delivered when the endpoint is back.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pytest_otmcp.trial.task import Task

from .tasks import tasks


@pytest.mark.parametrize("task", tasks("stress"), ids=lambda task: task.id)
def test_stress(task: Task, _otmcp_trial: Callable[[Task], None]) -> None:
    _otmcp_trial(task)
