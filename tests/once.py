"""A cache for things that several tests only read: the first worker that needs a thing makes it, once in a test run."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

__all__ = ["once"]


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], str]) -> str:
    """Call ``make`` once in a test run and return its result; other workers wait for it.

    Args:
        factory: pytest's own; the workers of a test run have a directory in common.
        name: the name of the thing that is made.
        make: gets a directory, and returns what the tests need to know of the thing.
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
