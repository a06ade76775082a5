"""Every stash key of the plugin in one place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .live import Live
    from .run import Recorder, Run
    from .settings import RunSettings
__all__ = ["LIVE", "RECORDER", "REQUIRED", "RESULT", "RUN", "SETTINGS"]

SETTINGS: pytest.StashKey[RunSettings] = pytest.StashKey()
"""On the config: the checked settings."""

REQUIRED: pytest.StashKey[list[str]] = pytest.StashKey()
"""On the config: ids of all items of the set, before anything was deselected."""

RUN: pytest.StashKey[Run] = pytest.StashKey()
"""On the config of a process that executes items: its run."""

RECORDER: pytest.StashKey[Recorder] = pytest.StashKey()
"""On the config of the controller: what collects the results."""

LIVE: pytest.StashKey[Live] = pytest.StashKey()
"""On the config of the controller: what shows progress."""

RESULT: pytest.StashKey[dict[str, Any]] = pytest.StashKey()
"""On an item: what its task came to, as ``run.json`` has it."""
