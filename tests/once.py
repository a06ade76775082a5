"""Makes what several tests only read once in a test run, whichever of its workers needs it first."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

__all__ = ["once"]


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], str]) -> str:
    """Return what ``make`` returned, which is called once in a test run; other workers wait for it.

    Args:
        factory: pytest's; the workers of a test run have a directory in common.
        name: of what is made.
        make: is given a directory, and returns what the tests need to know of it.
    """
    own = factory.getbasetemp()
    directory = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / name
    directory.mkdir(exist_ok=True)
    made = directory.with_suffix(".json")
    with directory.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            made.write_text(json.dumps(make(directory)))
        text: str = json.loads(made.read_text())
        return text
