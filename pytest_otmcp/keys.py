"""Every stash key of the plugin in one place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .live import Live
    from .run import Recorder, Run
    from .settings import RunSettings

__all__ = ["LIVE", "RECORDER", "REQUIRED", "RESULT", "RUN", "SETTINGS"]

SETTINGS = pytest.StashKey["RunSettings"]()
"""On the config: the checked settings."""

REQUIRED = pytest.StashKey[list[str]]()
"""On the config: ids of all items of the set, before anything was deselected."""

RUN = pytest.StashKey["Run"]()
"""On the config of a process that executes items: its run."""

RECORDER = pytest.StashKey["Recorder"]()
"""On the config of the controller: what collects the results."""

LIVE = pytest.StashKey["Live"]()
"""On the config of the controller: what shows progress."""

RESULT = pytest.StashKey[dict[str, Any]]()
"""On an item: what its task came to, as ``run.json`` has it."""
