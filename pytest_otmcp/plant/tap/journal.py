"""The tap's journal: what passed, decoded when somebody asks.

It answers the same questions as a mock's journal, in entries of the same shape, so that a device without a journal of
its own (a broker of somebody else's) can be judged by the same predicates. Decoding waits until entries are wanted:
while a call is being timed the tap only stores frames.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from ...protocols.framing import Conversation

__all__ = ["Entry", "TapJournal"]

Entry = dict[str, Any]

_CAPACITY = 200_000


class TapJournal:
    """An append-only record. Sequence numbers begin at 0 and are never reused.

    Attributes:
        dropped: entries that gave way when the capacity was reached.
    """

    def __init__(self, capacity: int = _CAPACITY) -> None:
        self._entries: deque[Entry] = deque(maxlen=capacity)
        self._frames: deque[tuple[int, int, str, bytes, str | None, Conversation]] = deque()
        self._next = 0
        self.dropped = 0
        self._waiters: list[_Waiter] = []

    @property
    def next_seq(self) -> int:
        """Sequence number that the next entry will get."""
        self._catch_up()
        return self._next

    def entries(self, since: int = 0) -> list[Entry]:
        """The entries with this sequence number or a later one."""
        self._catch_up()
        newest = list(itertools.islice(reversed(self._entries), max(0, self._next - since)))
        newest.reverse()
        return newest

    def reset(self) -> None:
        """Forget the entries; sequence numbers go on."""
        self._catch_up()
        self._entries.clear()

    def forget(self, before: int) -> None:
        """Release the entries with a smaller sequence number for good; sequence numbers go on."""
        self._catch_up()
        while self._entries and self._entries[0]["seq"] < before:
            self._entries.popleft()

    async def wait(self, since: int, match: Mapping[str, Any], count: int = 1, timeout_s: float = 2.0) -> list[Entry]:
        """The entries from ``since`` on whose fields equal ``match``: as soon as there are ``count`` of them, or
        whatever there is after ``timeout_s`` seconds."""
        waiter = _Waiter(match, count)
        for entry in self.entries(since):
            waiter.offer(entry)
        self._waiters.append(waiter)
        try:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(waiter.satisfied.wait(), timeout_s)
        finally:
            self._waiters.remove(waiter)
        return waiter.found

    def frame(
        self, connection: int, direction: str, frame: bytes, fault: str | None, conversation: Conversation
    ) -> None:
        """Record one frame that passes now; ``fault`` is what the tap does to it."""
        self._frames.append((time.monotonic_ns(), connection, direction, frame, fault, conversation))
        if self._waiters:
            self._catch_up()

    def event(self, connection: int, direction: str, kind: str, **fields: Any) -> None:
        """Record something that is no frame."""
        self._catch_up()
        self._append(time.monotonic_ns(), connection, {"direction": direction, "kind": kind, **fields})

    def _catch_up(self) -> None:
        while self._frames:
            t_ns, connection, direction, frame, fault, conversation = self._frames.popleft()
            for fields in conversation.decode(direction, frame):
                self._append(t_ns, connection, fields if fault is None else {**fields, "fault": fault})

    def _append(self, t_ns: int, connection: int, fields: Mapping[str, Any]) -> None:
        entry = {"seq": self._next, "t_ns": t_ns, "connection": connection, **fields}
        self._next += 1
        if len(self._entries) == self._entries.maxlen:
            self.dropped += 1
        self._entries.append(entry)
        for waiter in self._waiters:
            waiter.offer(entry)


class _Waiter:
    def __init__(self, match: Mapping[str, Any], count: int) -> None:
        self._match = dict(match)
        self._count = count
        self.found: list[Entry] = []
        self.satisfied = asyncio.Event()
        if count <= 0:
            self.satisfied.set()

    def offer(self, entry: Entry) -> None:
        if all(entry.get(name) == value for name, value in self._match.items()):
            self.found.append(entry)
            if len(self.found) >= self._count:
                self.satisfied.set()
