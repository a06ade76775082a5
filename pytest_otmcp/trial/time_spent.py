"""Account of what the wall-clock time of a run was spent on. Pure but for the clock."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

__all__ = ["TimeSpent"]


@dataclass(slots=True)
class TimeSpent:
    """Wall-clock seconds by what they were spent on; nested spans count once, for the innermost span."""

    seconds: dict[str, float] = field(default_factory=dict)
    _stack: list[list[Any]] = field(default_factory=list)

    @contextmanager
    def on(self, what: str) -> Iterator[None]:
        """Count the time inside the block as spent on ``what``."""
        now = time.monotonic()
        if self._stack:
            self._add(self._stack[-1][0], now - self._stack[-1][1])
        self._stack.append([what, now])
        try:
            yield
        finally:
            now = time.monotonic()
            name, since = self._stack.pop()
            self._add(name, now - since)
            if self._stack:
                self._stack[-1][1] = now

    def move(self, source: str, target: str, seconds: float) -> None:
        """Count ``seconds`` as spent on ``target`` instead of ``source``."""
        self._add(source, -seconds)
        self._add(target, seconds)

    def _add(self, what: str, seconds: float) -> None:
        self.seconds[what] = self.seconds.get(what, 0.0) + seconds
