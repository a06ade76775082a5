"""The memory of a mock is its own: the journal that is in it decides on an adapter, which runs as the same user."""

from __future__ import annotations

import ctypes
import sys

__all__ = ["hide_memory"]

_SET_DUMPABLE = 4


def hide_memory() -> None:
    """Keep other processes of the same user from reading or changing the memory of this one and of those that it forks
    (PR_SET_DUMPABLE, prctl(2)). A process that may trace every other one, such as root's, still can."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_DUMPABLE, ctypes.c_ulong(0), 0, 0, 0)
