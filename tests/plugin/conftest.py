"""Fixtures for the tests that run pytest in the repository of a vendor."""

from __future__ import annotations

import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from pytest_otmcp.soundness.warm_start import WarmStart

from .vendor import PATIENCE_S, Repository


@pytest.fixture
def empty_repository(tmp_path: Path, warm_start: WarmStart) -> Repository:
    """A repository without files."""
    return Repository(tmp_path, warm_start)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Lets Ctrl-C and the end of a terminal end the processes that a test starts.

    A shell without job control starts background programs with SIGINT ignored, ``nohup`` with SIGHUP ignored, and child processes inherit
    that.
    """
    asked = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in asked.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def waiting() -> Iterator[socket.socket]:
    """A listening socket; an adapter that connects to it waits until the connection is closed."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(PATIENCE_S)
        yield listener
