"""What a conformance test may ask for."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from .keys import RESULT, RUN

if TYPE_CHECKING:
    from .task import Task

__all__ = ["otmcp_trial"]


@pytest.fixture
def otmcp_trial(request: pytest.FixtureRequest) -> Callable[[Task], None]:
    """A function that runs a task and makes the test fail, skip or err as the task's result says."""

    def run(task: Task) -> None:
        __tracebackhide__ = True
        result = request.config.stash[RUN].execute(task)
        request.node.stash[RESULT] = result
        if result["status"] == "NOT_APPLICABLE":
            pytest.skip(f"{task.id}: the subject does not claim {' and '.join(task.adapters)}")
        if result["status"] != "PASS":
            pytest.fail(explain(result), pytrace=False)

    return run


def explain(result: dict[str, object]) -> str:
    """The failure message of an item: its first findings, each with the repetition that showed it."""
    samples = result["samples"]
    findings = result["findings"]
    assert isinstance(samples, list)
    assert isinstance(findings, list)
    bad = [sample for sample in samples if not sample["ok"]]
    lines = [
        f"{result['id']} {result['title']} [{result['status']}] {len(samples) - len(bad)}/{result['planned']} passed"
    ]
    lines += [f"  {finding['message']}" for finding in findings]
    for sample in bad[:2]:
        for finding in sample["findings"][:4]:
            rule = f" [{finding['requirement']}]" if finding["requirement"] else ""
            lines.append(f"  rep {sample['repetition'] + 1}/{result['planned']}: {finding['message']}{rule}")
            if finding["evidence"]:
                lines.append(f"      {finding['evidence']}")
    if len(bad) > 2:
        lines.append(f"  … and {len(bad) - 2} more repetitions; all are in run.json")
    return "\n".join(lines)
