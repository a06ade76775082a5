"""Every stash key of the plugin in one place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .run import Run
    from .settings import RunSettings

__all__ = ["RESULT", "RUN", "SETTINGS"]

SETTINGS = pytest.StashKey["RunSettings"]()
"""On the config: the checked settings."""

RUN = pytest.StashKey["Run"]()
"""On the config: the run of this process, from the moment conformance items are collected."""

RESULT = pytest.StashKey[dict[str, Any]]()
"""On an item: what its task came to, as ``run.json`` has it."""
