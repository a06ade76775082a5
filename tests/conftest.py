"""Hooks and fixtures of all tests: long and weekly tests are left out unless asked for, and adapters can be started warm."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator

import pytest

from pytest_otmcp.core.walls import MODES, OFF
from pytest_otmcp.soundness.warm_start import WarmStart

from . import lanes
from .lanes import pytest_collection_modifyitems, pytest_sessionfinish, pytest_testnodedown
from .outside_witnesses import not_run

__all__ = [
    "pytest_addoption",
    "pytest_collection_modifyitems",
    "pytest_configure",
    "pytest_sessionfinish",
    "pytest_terminal_summary",
    "pytest_testnodedown",
    "pytest_xdist_auto_num_workers",
    "warm_start",
]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the options of lanes, and the walls around the adapters of ``tests/soundness``."""
    lanes.pytest_addoption(parser)
    parser.addoption(
        "--isolation", choices=MODES, default=OFF, help="walls around the adapters of tests/soundness (default: off)"
    )


def pytest_configure() -> None:
    """Keep options that are meant for this pytest from those that the tests start."""
    os.environ.pop("PYTEST_ADDOPTS", None)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say what did not run."""
    lanes.say_what_was_left_out(terminalreporter, config)
    for line in not_run(terminalreporter.stats.get("skipped", [])):
        terminalreporter.write_line(line, yellow=True)


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_xdist_auto_num_workers() -> Generator[None, int, int]:
    """Return two workers for each processor: a test waits for other processes a third of the time."""
    workers = yield
    return workers if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ else 2 * workers


@pytest.fixture(scope="session")
def warm_start() -> Iterator[WarmStart]:
    """A server that starts adapters without the time that their imports take."""
    server = WarmStart()
    yield server
    server.close()
