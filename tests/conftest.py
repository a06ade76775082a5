"""Hooks and fixtures of all tests: long tests are left out unless asked for, and adapters can be started warm."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from .long_tests import (
    pytest_collection_modifyitems,
    pytest_sessionfinish,
    pytest_terminal_summary,
    pytest_testnodedown,
)
from .warm_start import WarmStart

__all__ = [
    "pytest_collection_modifyitems",
    "pytest_sessionfinish",
    "pytest_terminal_summary",
    "pytest_testnodedown",
    "warm_start",
]


@pytest.fixture(scope="session")
def warm_start() -> Iterator[WarmStart]:
    """A server that starts adapters without the time that their imports take."""
    server = WarmStart()
    yield server
    server.close()
