"""What honest adapters are free to do is no way for a lie."""

from __future__ import annotations

import pytest

from pytest_otmcp.suite.catalogue import tasks_by_id

from .conftest import Judge, failing, words
from .pretending import PRETENDERS


@pytest.mark.long
@pytest.mark.parametrize("name", PRETENDERS)
def test_a_lie_behind_a_freedom_fails_exactly_its_tasks(judge: Judge, name: str) -> None:
    pretender = PRETENDERS[name]
    alone = [task.id for task in tasks_by_id().values() if set(task.protocols) == {pretender.protocol}]
    results = judge(
        pretender.protocol,
        "pretending.py",
        name,
        tasks=pretender.tasks or " ".join(alone),
        described=pretender.described,
    )
    found = failing(results)
    assert found == set(pretender.fails.split()), f"{found ^ set(pretender.fails.split())}:\n{words(results)}"
    assert pretender.words in words(results)
