"""Pytest hooks that leave the long tests out of a test run that does not ask for them, and say how many there are.

The long tests are marked ``long``: they need LaTeX, a browser, a foreign broker, packages from an index, a built wheel,
or 30 repetitions of the suite. ``pytest tests -m long`` runs them; ``.ci/run`` runs the others first and then these.
"""

from __future__ import annotations

from typing import Any

import pytest

__all__ = [
    "pytest_collection_modifyitems",
    "pytest_sessionfinish",
    "pytest_testnodedown",
    "say_what_was_left_out",
]

_LEFT_OUT = pytest.StashKey[int]()
"""The number of long tests that were left out of this run."""

_OF_WORKER = "long_tests_left_out"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the long tests, unless ``-m`` decides."""
    if config.option.markexpr:
        return
    long = [item for item in items if item.get_closest_marker("long") is not None]
    if long:
        items[:] = [item for item in items if item not in long]
        config.hook.pytest_deselected(items=long)
    config.stash[_LEFT_OUT] = len(long)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand a worker's number to the controller, which collects nothing itself."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput[_OF_WORKER] = session.config.stash.get(_LEFT_OUT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take the number from a worker; every worker collects all tests."""
    node.config.stash[_LEFT_OUT] = getattr(node, "workeroutput", {}).get(_OF_WORKER, 0)


def say_what_was_left_out(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say how many long tests were left out, and how to run them."""
    number = config.stash.get(_LEFT_OUT, 0)
    if number:
        terminalreporter.write_line(f"{number} long tests were left out; pytest -m long runs them")
