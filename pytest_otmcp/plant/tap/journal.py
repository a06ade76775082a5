"""The journal of a tap: messages that passed, decoded when they are asked for.

Its entries and its behaviour are those of a mock's journal, so that a device without a journal of its own (a broker of the
user's) is judged by the same oracles. Decoding waits until entries are wanted: while a call is being timed the tap only stores
frames.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections import deque
from collections.abc import Mapping
from typing import Literal, cast
from weakref import WeakKeyDictionary

from ...protocols.conversation import Conversation, Direction, Message
from ...protocols.journal import JournalEntry
from ...protocols.oracle import has
from ..owners import Peer, PeerProcess

__all__ = ["TapJournal"]

_CAPACITY = 200_000
"""A limit against floods, as in the mocks. Entries that were read are to be released with :meth:`TapJournal.forget`."""

_NO_MESSAGES = frozenset({"CONNECTED", "DISCONNECTED", "malformed"})


class TapJournal:
    """An append-only record. Sequence numbers begin at 0 and are never reused; the oldest entries are dropped when the
    capacity is reached, and are counted.

    Attributes:
        dropped: number of entries that were dropped before they were released.
    """

    def __init__(self, capacity: int = _CAPACITY) -> None:
        self._entries: deque[JournalEntry] = deque(maxlen=capacity)
        self._frames: deque[tuple[int, int, Direction, bytes, str | None, Conversation]] = deque()
        # Sequence numbers of the messages that a conversation still holds, for their answers.
        self._seq_of: WeakKeyDictionary[Message, int] = WeakKeyDictionary()
        self._next = 0
        self.dropped = 0
        self._waiters: list[_Waiter] = []
        self._peers: dict[int, Peer] = {}

    @property
    def next(self) -> int:
        """Sequence number that the next entry will get."""
        self._catch_up()
        return self._next

    @property
    def first(self) -> int:
        """Sequence number of the oldest entry that is kept; that of the next entry while there is none."""
        return self.next - len(self._entries)

    def since(self, seq: int) -> list[JournalEntry]:
        """Return the kept entries with this sequence number or a later one; the cost is that of these entries alone."""
        self._catch_up()
        # A deque is slow to index in its middle, but not to walk from its end.
        newest = list(itertools.islice(reversed(self._entries), max(0, self._next - seq)))
        newest.reverse()
        return newest

    def forget(self, before: int) -> None:
        """Release the entries with a smaller sequence number for good; sequence numbers go on."""
        for _ in range(min(before, self.next) - self.first):
            self._entries.popleft()

    async def wait(self, seq: int, match: Mapping[str, object], count: int, timeout_s: float) -> list[JournalEntry]:
        """Wait for entries from ``seq`` on whose fields equal ``match``; return them as soon as there are ``count``, or
        those found after ``timeout_s`` seconds."""
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

    def heard_of(self, connection: int, process: PeerProcess | None) -> None:
        """Note which process has the other end of a client's connection."""
        self._peers[connection] = Peer(accepted_ns=time.monotonic_ns(), process=process)

    @property
    def peers(self) -> Mapping[int, Peer]:
        """The other ends of the clients' connections, by number."""
        return self._peers

    def frame(
        self, connection: int, direction: Direction, frame: bytes, fault: str | None, conversation: Conversation
    ) -> None:
        """Record one frame that passes now; ``fault`` is what the tap does to it."""
        self._frames.append((time.monotonic_ns(), connection, direction, frame, fault, conversation))
        if self._waiters:
            self._catch_up()

    def event(
        self,
        connection: int,
        direction: Direction,
        kind: str,
        *,
        origin: Literal["client", "kit"] = "client",
        **fields: object,
    ) -> None:
        """Record an event that is no frame."""
        self._catch_up()
        message = Message(direction=direction, kind=kind, fields=fields)
        self._append(time.monotonic_ns(), connection, message, None, origin)

    def _catch_up(self) -> None:
        while self._frames:
            t_ns, connection, direction, frame, fault, conversation = self._frames.popleft()
            for message in conversation.decode(direction, frame):
                self._append(t_ns, connection, message, fault, "client")

    def _append(
        self, t_ns: int, connection: int, message: Message, fault: str | None, origin: Literal["client", "kit"]
    ) -> None:
        contract: JournalEntry = {
            "seq": self._next,
            "t_ns": t_ns,
            "connection": connection,
            "direction": message.direction,
            "kind": message.kind,
            "request": message.request,
            "state_changing": message.state_changing,
            "answers": None if message.answers is None else self._seq_of.get(message.answers),
            "origin": origin,
        }
        entry = cast(JournalEntry, {**contract, **message.fields, **({} if fault is None else {"fault": fault})})
        self._seq_of[message] = self._next
        if len(self._entries) == self._entries.maxlen:
            self.dropped += 1
        self._entries.append(entry)
        peer = self._peers.get(connection)
        if peer is not None and peer.spoke is None and message.direction == "in" and message.kind not in _NO_MESSAGES:
            peer.spoke = self._next
        self._next += 1
        for waiter in self._waiters:
            waiter.offer(entry)


class _Waiter:
    """A collector of the entries that one ``wait`` asks for."""

    def __init__(self, match: Mapping[str, object], count: int) -> None:
        self._match = dict(match)
        self._count = count
        self.found: list[JournalEntry] = []
        self.satisfied = asyncio.Event()
        if count <= 0:
            self.satisfied.set()

    def offer(self, entry: JournalEntry) -> None:
        """Take the entry if it matches. A field that the entry lacks equals nothing, not even None."""
        if has(entry, **self._match):
            self.found.append(entry)
            if len(self.found) >= self._count:
                self.satisfied.set()
