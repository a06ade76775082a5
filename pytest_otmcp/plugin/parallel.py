"""What the workers of pytest-xdist have measured when a signal ends the run.

pytest-xdist takes nothing from its workers any more then: results that it has not taken yet, and the items that were running, would be
missing without a word.
"""

from __future__ import annotations

import queue
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

import pytest

__all__ = ["UNFINISHED", "ended", "untaken"]

UNFINISHED = "otmcp_unfinished"
"""Key in the output of a worker: the item that was interrupted there, with the facts about the worker."""

_ENDING_S = 60.0
"""Seconds that a worker has to end its adapters and devices; one that is stuck is killed by pytest-xdist."""


def ended(nodes: Sequence[Any]) -> None:
    """Wait until the workers, which the signal was passed on to, have ended."""
    for node in nodes:
        # Whatever a worker ends with: what it has said before is kept.
        with suppress(Exception):
            node.channel.waitclose(_ENDING_S)


def untaken(config: pytest.Config) -> Iterator[Any]:
    """Return the reports of finished items that pytest-xdist has received, and has not handed on."""
    events = getattr(config.pluginmanager.get_plugin("dsession"), "queue", None)
    with suppress(queue.Empty):
        while events is not None:
            name, members = events.get_nowait()
            if name == "testreport":
                report = members["rep"]
                report.node = members["node"]
                yield report
