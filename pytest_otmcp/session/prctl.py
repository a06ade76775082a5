"""What Linux offers a process about itself (prctl(2)) and Python does not: here by ctypes. Elsewhere nothing happens."""

from __future__ import annotations

import ctypes
import signal
import sys

__all__ = ["die_with_parent", "hide_memory"]

_SET_PDEATHSIG = 1
_SET_DUMPABLE = 4


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)


def die_with_parent() -> None:
    """Have this process killed when the thread that started it ends, however that happens."""
    _prctl(_SET_PDEATHSIG, signal.SIGKILL)


def hide_memory() -> None:
    """Keep other processes of the same user from reading or changing the memory of this one, and from reading its
    environment (PR_SET_DUMPABLE). A process that may trace every other one, such as root's, still can."""
    _prctl(_SET_DUMPABLE, 0)
