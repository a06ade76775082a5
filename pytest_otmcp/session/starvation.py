"""The time for which the machine keeps processes waiting for a processor, which is no fault of theirs (Linux)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

__all__ = ["finish_within"]

_LOOK_S = 0.1
"""Seconds between two looks at a process; what is found out is so exact."""

_T = TypeVar("_T")


async def finish_within(
    seconds: float, waiting: Coroutine[Any, Any, _T], pids: Iterable[int], *, starved_s: float
) -> _T:
    """Return the result of what is waited for. The time for which the machine does not let processes run is no part of the limit.

    Args:
        seconds: limit of the time in which the processes run, or wait for something else than a processor.
        pids: the processes that must run for it.
        starved_s: seconds of waiting for a processor that are granted at most.

    Raises:
        TimeoutError: the limit has passed; the waiting was cancelled.
    """
    task = asyncio.ensure_future(waiting)
    try:
        begun = time.monotonic()
        starvation = _Starvation(pids)
        left = seconds
        while left > 0:
            if (await asyncio.wait((task,), timeout=min(left, _LOOK_S)))[0]:
                return await task
            left = seconds + min(starvation.seconds(), starved_s) - (time.monotonic() - begun)
        raise TimeoutError
    finally:
        task.cancel()


class _Starvation:
    """The waiting of processes' main threads for a processor, from the moment at which this is created."""

    def __init__(self, pids: Iterable[int]) -> None:
        self._threads = [_Thread(pid) for pid in pids]

    def seconds(self) -> float:
        """Look again; return for how long, in all, the processes were ready to run and did not run."""
        return sum(thread.waited_s() for thread in self._threads)


@dataclass(slots=True)
class _Thread:
    """A main thread: Linux, Documentation/scheduler/sched-stats.rst and proc_pid_stat(5)."""

    pid: int
    _ran_ns: int = 0
    _began_ns: int | None = None
    _waited_ns: int = 0
    _looked: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        self.waited_s()

    def waited_s(self) -> float:
        """Return how long it has waited; of one that has ended, or where the kernel does not count, what was known last."""
        now = time.monotonic()
        try:
            ran_ns, waited_ns = map(int, self._read("schedstat").split()[:2])
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

    def _read(self, name: str) -> str:
        return Path(f"/proc/{self.pid}/{name}").read_text(encoding="utf-8", errors="replace")
