"""The journal of a device: every request and answer in order, with waiting for what is to come."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

__all__ = ["Entry", "Journal"]

Entry = dict[str, Any]

_CAPACITY = 200_000


class Journal:
    """An append-only record. Sequence numbers begin at 0 and are never reused; the oldest entries give way when the
    capacity is reached, and are counted."""

    def __init__(self, capacity: int = _CAPACITY) -> None:
        self._entries: deque[Entry] = deque(maxlen=capacity)
        self.next = 0
        self.dropped = 0
        self._waiters: list[_Waiter] = []

    def append(self, *, connection: int, direction: str, kind: str, **fields: Any) -> None:
        """Record something that happened now.

        Args:
            connection: number of the connection, 0 for none.
            direction: ``in`` for what the device received, ``out`` for what it sent.
            kind: what it is, in the protocol's words.
            fields: JSON-safe facts of the protocol.
        """
        entry = {
            "seq": self.next,
            "t_ns": time.monotonic_ns(),
            "connection": connection,
            "direction": direction,
            "kind": kind,
            **fields,
        }
        self.next += 1
        if len(self._entries) == self._entries.maxlen:
            self.dropped += 1
        self._entries.append(entry)
        for waiter in self._waiters:
            waiter.offer(entry)

    def since(self, seq: int) -> list[Entry]:
        """The entries with this sequence number or a later one."""
        missing = self.next - seq
        if missing <= 0:
            return []
        if missing >= len(self._entries):
            return list(self._entries)
        newest = [entry for entry, _ in zip(reversed(self._entries), range(missing), strict=False)]
        newest.reverse()
        return newest

    def clear(self) -> None:
        """Forget the entries; sequence numbers go on."""
        self._entries.clear()

    async def wait(self, seq: int, match: Mapping[str, Any], count: int, timeout_s: float) -> list[Entry]:
        """The entries from ``seq`` on whose fields equal ``match``: as soon as there are ``count`` of them, or
        whatever there is after ``timeout_s`` seconds."""
        waiter = _Waiter(match, count)
        for entry in self.since(seq):
            waiter.offer(entry)
        self._waiters.append(waiter)
        try:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(waiter.satisfied.wait(), timeout_s)
        finally:
            self._waiters.remove(waiter)
        return waiter.found


class _Waiter:
    def __init__(self, match: Mapping[str, Any], count: int) -> None:
        self._match = dict(match)
        self._count = count
        self.found: list[Entry] = []
        self.satisfied = asyncio.Event()
        if count <= 0:
            self.satisfied.set()

    def offer(self, entry: Entry) -> None:
        if all(name in entry and entry[name] == value for name, value in self._match.items()):
            self.found.append(entry)
            if len(self.found) >= self._count:
                self.satisfied.set()
