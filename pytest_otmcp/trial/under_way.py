"""What an item is waiting for at this moment, in words for a person who watches the run. Pure but for the clock."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["UnderWay"]

_SOON_S = 1.0
"""Seconds: a shorter wait is not worth a word."""


class UnderWay:
    """The calls of the item that is being measured.

    Attributes:
        calls: how many were made since the item began.
    """

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Begin an item."""
        self._began = time.monotonic()
        self._waits: dict[object, tuple[str, float]] = {}
        self.calls = 0

    @contextmanager
    def call(self, operation: str) -> Iterator[None]:
        """Count a call, and wait for its reply inside the block."""
        self.calls += 1
        with self.wait(f"the reply to {operation}"):
            yield

    @contextmanager
    def wait(self, what: str) -> Iterator[None]:
        """Wait for ``what`` inside the block."""
        token = object()
        self._waits[token] = what, time.monotonic()
        try:
            yield
        finally:
            del self._waits[token]

    @property
    def seconds(self) -> float:
        """Seconds since the item began."""
        return time.monotonic() - self._began

    def words(self) -> str:
        """Return the number of the call, and for what the item has been waiting longest, such as
        ``call 17, 3 s for the reply to read_holding``."""
        longest = min(self._waits.values(), key=lambda wait: wait[1], default=None)
        if longest is None or (waited_s := time.monotonic() - longest[1]) < _SOON_S:
            return f"call {self.calls}"
        return f"call {self.calls}, {waited_s:.0f} s for {longest[0]}"
