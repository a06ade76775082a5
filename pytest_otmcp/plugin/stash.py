"""Every stash key of the plugin in one place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from ..report.baseline import Baseline
    from ..subject.selection import Selection
    from .controller import RunRecorder
    from .endings import Endings
    from .interference import Interference
    from .options import RunSettings
    from .progress import Progress
    from .results import ItemResult
    from .worker import Run

__all__ = [
    "BASELINE",
    "ENDINGS",
    "INTERFERENCE",
    "PLANNED",
    "PROGRESS",
    "RECORDER",
    "RESULT",
    "RUN",
    "SELECTION",
    "SETTINGS",
    "STARTED",
]

SETTINGS: pytest.StashKey[RunSettings] = pytest.StashKey()
"""On the config: the checked settings."""

BASELINE: pytest.StashKey[Baseline | None] = pytest.StashKey()
"""On the config: the earlier run that the verdict is compared with."""

SELECTION: pytest.StashKey[Selection] = pytest.StashKey()
"""On the config: the adapters that the run measures, once they were asked for."""

STARTED: pytest.StashKey[float] = pytest.StashKey()
"""On the config: monotonic time at which the session began."""

ENDINGS: pytest.StashKey[Endings] = pytest.StashKey()
"""On the config of a process of a run of the suite: the signals that end it."""

INTERFERENCE: pytest.StashKey[Interference] = pytest.StashKey()
"""On the config of a process that has collected items of the suite: everything that narrowed or shadowed the suite."""

PLANNED: pytest.StashKey[list[str]] = pytest.StashKey()
"""On the config of a process that has collected items of the suite: ids of the items to run, in their order."""

RUN: pytest.StashKey[Run] = pytest.StashKey()
"""On the config of a process that executes items: its run."""

RECORDER: pytest.StashKey[RunRecorder] = pytest.StashKey()
"""On the config of the controller: the collector of the results."""

PROGRESS: pytest.StashKey[Progress] = pytest.StashKey()
"""On the config of the controller: the display of progress."""

RESULT: pytest.StashKey[ItemResult] = pytest.StashKey()
"""On an item: the result of its task, as in ``run.json``."""
