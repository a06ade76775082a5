"""The time for which the machine keeps processes waiting for a processor, which is no fault of theirs (Linux)."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Coroutine, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

__all__ = ["LOOK_S", "Patience", "finish_within"]

LOOK_S = 0.1
"""Seconds between two looks at a process; what is found out is so exact."""

_STARVED_S = 60.0
"""Time without a processor, in seconds, that is not held against processes."""

_T = TypeVar("_T")


class Patience:
    """A time that processes are given, of which what they, or the thread that waits for them, wait for a processor is not taken.

    Args:
        seconds: the time, from now on.
        starved_s: seconds of waiting for a processor that are granted at most.
    """

    def __init__(self, seconds: float, *, starved_s: float = _STARVED_S) -> None:
        self._until = time.monotonic() + seconds
        self._starved_s = starved_s
        self._threads = [_Thread(threading.get_native_id())]

    def watch(self, pids: Iterable[int]) -> None:
        """From now on these processes are looked at, too: the main thread of each."""
        self._threads += map(_Thread, pids)

    def left_s(self) -> float:
        """Look again; return what is left, 0 or less when the time is over."""
        return self._until + self.starved_s() - time.monotonic()

    def starved_s(self) -> float:
        """Look again; return how long they have waited for a processor, as far as it is granted; 0 for less than :data:`LOOK_S`."""
        starved_s = sum(thread.waited_s() for thread in self._threads)
        return 0.0 if starved_s < LOOK_S else min(starved_s, self._starved_s)


async def finish_within(patience: Patience, waiting: Coroutine[Any, Any, _T]) -> _T:
    """Return the result of what is waited for.

    Raises:
        TimeoutError: the time is over; the waiting was cancelled.
    """
    task = asyncio.ensure_future(waiting)
    try:
        while (left := patience.left_s()) > 0:
            if (await asyncio.wait((task,), timeout=min(left, LOOK_S)))[0]:
                return await task
        raise TimeoutError
    finally:
        task.cancel()


@dataclass(slots=True)
class _Thread:
    """A thread: Linux, Documentation/scheduler/sched-stats.rst and proc_pid_stat(5)."""

    number: int
    _ran_ns: int = 0
    _began_ns: int | None = None
    _waited_ns: int = 0
    _looked: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        # Whether it waits now is not looked at: every call of an adapter begins with this.
        with suppress(OSError, IndexError, ValueError):
            self._ran_ns, self._began_ns = self._counted()

    def waited_s(self) -> float:
        """Return how long it has waited; of one that has ended, or where the kernel does not count, what was known last."""
        now = time.monotonic()
        try:
            ran_ns, waited_ns = self._counted()
            ready = self._read("stat").rpartition(")")[2].split()[0] == "R"
        except (OSError, IndexError, ValueError):
            return self._waited_ns / 1e9
        if self._began_ns is None:
            self._began_ns = waited_ns
        if not ready or ran_ns != self._ran_ns:
            self._looked = now
        self._ran_ns, self._waited_ns = ran_ns, waited_ns - self._began_ns
        # The kernel adds a wait when it is over.
        return self._waited_ns / 1e9 + now - self._looked

    def _counted(self) -> tuple[int, int]:
        ran_ns, waited_ns = map(int, self._read("schedstat").split()[:2])
        return ran_ns, waited_ns

    def _read(self, name: str) -> str:
        return Path(f"/proc/{self.number}/{name}").read_text(encoding="utf-8", errors="replace")
