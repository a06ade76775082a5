"""Every stash key of the plugin in one place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .fixture_bench import Workshop
    from .live import Live
    from .narrowing import Narrowing
    from .run import Recorder, Run
    from .settings import RunSettings

__all__ = ["LIVE", "NARROWING", "PLANNED", "RECORDER", "RESULT", "RUN", "SETTINGS", "STARTED", "WORKSHOP"]

SETTINGS: pytest.StashKey[RunSettings] = pytest.StashKey()
"""On the config: the checked settings."""

STARTED: pytest.StashKey[float] = pytest.StashKey()
"""On the config: monotonic time at which the session began."""

NARROWING: pytest.StashKey[Narrowing] = pytest.StashKey()
"""On the config of a process that has collected items of the suite: what narrowed or shadowed it."""

PLANNED: pytest.StashKey[list[str]] = pytest.StashKey()
"""On the config of a process that has collected items of the suite: ids of those to run, in their order."""

RUN: pytest.StashKey[Run] = pytest.StashKey()
"""On the config of a process that executes items: its run."""

RECORDER: pytest.StashKey[Recorder] = pytest.StashKey()
"""On the config of the controller: what collects the results."""

LIVE: pytest.StashKey[Live] = pytest.StashKey()
"""On the config of the controller: what shows progress."""

RESULT: pytest.StashKey[dict[str, Any]] = pytest.StashKey()
"""On an item: what its task came to, as ``run.json`` has it."""

WORKSHOP: pytest.StashKey[Workshop] = pytest.StashKey()
"""On the config: what the public fixtures of this process share, once a test has asked for it."""
