"""The journal of a device: every request and answer in order; a client can wait for later entries.

Every entry of every protocol has the fields of :class:`JournalEntry`. A protocol adds fields of its own; its package says
which (``modbus.pdu``, ``mqtt.describe``, ``opcua.session``).
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypedDict

from .peer import Process

__all__ = ["Direction", "Entry", "Journal", "JournalEntry", "Origin"]

Direction = Literal["in", "out"]
Origin = Literal["client", "plant", "kit"]


class JournalEntry(TypedDict):
    """The fields that every entry of every protocol has.

    Attributes:
        seq: sequence number: 0 for the first entry of a device process, one more for each that follows.
        t_ns: time of the monotonic clock, in nanoseconds.
        connection: number of the connection, 1 for the first; 0 for none.
        direction: ``in`` for a message that the device received and for the state of a connection, ``out`` for a
            message that it sent.
        kind: the type of the message, in the protocol's words.
        request: True when this message asks the plant for something. Session keeping is no request where the protocol
            separates the two, and a message of the plant's own clients or of the kit never is one.
        state_changing: True when this message may change the plant; only a request can.
        answers: sequence number of the entry that this message answers; None for an unsolicited message.
        origin: whose connection it is: ``client`` (a client from outside), ``plant`` (a simulated part of the plant that
            is a client of its own device), ``kit`` (a poke of the kit that the protocol shows as a message).
    """

    seq: int
    t_ns: int
    connection: int
    direction: Direction
    kind: str
    request: bool
    state_changing: bool
    answers: int | None
    origin: Origin


Entry = dict[str, Any]
"""The fields of a :class:`JournalEntry` and those of the protocol, JSON-safe."""

_CAPACITY = 200_000
"""A limit against floods. Entries that were read are to be released with :meth:`Journal.forget`."""

_NO_MESSAGES = frozenset({"CONNECTED", "DISCONNECTED", "malformed", "lost"})


@dataclass(slots=True, kw_only=True)
class _Peer:
    """The other end of a connection.

    Attributes:
        accepted_ns: time at which the connection was accepted.
        process: that had it then; None if that cannot be known.
        spoke: sequence number of its first message that is one of the protocol.
        ended: sequence number of its end.
    """

    accepted_ns: int
    process: Process | None
    spoke: int | None = None
    ended: int | None = None


class Journal:
    """An append-only record. Sequence numbers begin at 0 and are never reused; the oldest entries are dropped when the
    capacity is reached, and are counted.

    Attributes:
        next: sequence number that the next entry will get.
        dropped: number of entries that were dropped before they were released.
        reads: how often somebody has asked for entries.
    """

    def __init__(self, capacity: int = _CAPACITY) -> None:
        self._entries: deque[Entry] = deque(maxlen=capacity)
        self.next = 0
        self.dropped = 0
        self.reads = 0
        self._peers: dict[int, _Peer] = {}
        self._waiters: list[_Waiter] = []

    @property
    def first(self) -> int:
        """Sequence number of the oldest entry that is kept; that of the next entry while there is none."""
        return self.next - len(self._entries)

    def connected(self, connection: int, process: Process | None, **fields: Any) -> int:
        """Record a new connection of a client; return the sequence number.

        Args:
            connection: its number.
            process: that has its other end, as :mod:`~.peer` finds it.
            fields: JSON-safe facts of the protocol.
        """
        self.heard_of(connection, process)
        return self.append(connection=connection, direction="in", kind="CONNECTED", **fields)

    def heard_of(self, connection: int, process: Process | None) -> None:
        """Note who has the other end of a connection without a beginning that could be recorded, as senders of datagrams are."""
        self._peers[connection] = _Peer(accepted_ns=time.monotonic_ns(), process=process)

    def append(
        self,
        *,
        connection: int,
        direction: Direction,
        kind: str,
        request: bool = False,
        state_changing: bool = False,
        answers: int | None = None,
        origin: Origin = "client",
        **fields: Any,
    ) -> int:
        """Record a message or an event of this moment; return its sequence number.

        Args:
            connection, direction, kind, request, state_changing, answers, origin: see :class:`JournalEntry`.
            fields: JSON-safe facts of the protocol.
        """
        contract: JournalEntry = {
            "seq": self.next,
            "t_ns": time.monotonic_ns(),
            "connection": connection,
            "direction": direction,
            "kind": kind,
            "request": request,
            "state_changing": state_changing,
            "answers": answers,
            "origin": origin,
        }
        entry: Entry = {**contract, **fields}
        if len(self._entries) == self._entries.maxlen:
            self.dropped += 1
        self._entries.append(entry)
        if direction == "in" and (peer := self._peers.get(connection)) is not None:
            if kind == "DISCONNECTED":
                peer.ended = self.next
            elif peer.spoke is None and kind not in _NO_MESSAGES:
                peer.spoke = self.next
        self.next += 1
        for waiter in self._waiters:
            waiter.offer(entry)
        return contract["seq"]

    def since(self, seq: int) -> list[Entry]:
        """Return the kept entries with this sequence number or a later one; the cost is that of these entries alone."""
        self.reads += 1
        # A deque is slow to index in its middle, but not to walk from its end.
        newest = list(itertools.islice(reversed(self._entries), max(0, self.next - seq)))
        newest.reverse()
        return newest

    def forget(self, before: int) -> None:
        """Release the entries with a smaller sequence number for good; sequence numbers go on."""
        for _ in range(min(before, self.next) - self.first):
            self._entries.popleft()
        first = self.first
        self._peers = {
            number: peer for number, peer in self._peers.items() if peer.ended is None or peer.ended >= first
        }

    def peers(self, entries: Iterable[Entry]) -> dict[int, dict[str, Any]]:
        """Return what is known of the other ends of the connections that these entries are about."""
        numbers = dict.fromkeys(entry["connection"] for entry in entries)
        return {number: asdict(self._peers[number]) for number in numbers if number in self._peers}

    async def wait(self, seq: int, match: Mapping[str, Any], count: int, timeout_s: float) -> list[Entry]:
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


class _Waiter:
    """A collector of the entries that one ``wait`` asks for."""

    def __init__(self, match: Mapping[str, Any], count: int) -> None:
        self._match = dict(match)
        self._count = count
        self.found: list[Entry] = []
        self.satisfied = asyncio.Event()
        if count <= 0:
            self.satisfied.set()

    def offer(self, entry: Entry) -> None:
        """Take the entry if it matches. A field that the entry lacks equals nothing, not even None."""
        if all(name in entry and entry[name] == value for name, value in self._match.items()):
            self.found.append(entry)
            if len(self.found) >= self._count:
                self.satisfied.set()
