"""The journal of a device: messages that it received and sent, decoded by the kit from recorded frames.

Its witness is the device itself, where that is a mock, or the tap in front of it. A mock's frames are fetched, and a tap's are
decoded, when entries are wanted: while a call is being timed nobody decodes anything.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Literal

from ..protocols.conversation import Conversation, Conversations, Direction, Message
from ..protocols.evidence import entry_of
from ..protocols.journal import JournalEntry
from ..protocols.oracle import has
from .owners import Peer, PeerProcess, process_told

__all__ = ["DeviceJournal"]

_CAPACITY = 200_000
"""A limit against floods, as in the mocks. Entries that were read are to be released with :meth:`DeviceJournal.forget`."""
_MOST_ANSWERABLE = 65_536
"""Records of a mock that can still be answered, as :mod:`~pytest_otmcp.protocols.conversation` has it."""

_NO_MESSAGES = frozenset({"CONNECTED", "DISCONNECTED", "malformed", "lost", "tls_ended"})

Origin = Literal["client", "plant", "kit"]


class DeviceJournal:
    """An append-only record. Sequence numbers begin at 0 and are never reused; the oldest entries are dropped when the
    capacity is reached, and are counted.

    Args:
        conversation: makes the decoder of one connection; without it the journal has no messages of frames.

    Attributes:
        dropped: number of entries that were dropped before they were released.
        taken: number that the next record of the mock has.
    """

    def __init__(self, conversation: Callable[[], Conversation] | None = None, capacity: int = _CAPACITY) -> None:
        self._conversations = None if conversation is None else Conversations(conversation)
        self._entries: deque[JournalEntry] = deque(maxlen=capacity)
        self._frames: deque[tuple[int, int, Direction, bytes, str | None]] = deque()
        # Sequence numbers of a mock's records, for their answers.
        self._seq_of_record: dict[int, int] = {}
        self._next = 0
        self.dropped = 0
        self.taken = 0
        self._news = asyncio.Event()
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
        first = self.first
        for number in [number for number, peer in self._peers.items() if peer.ended is not None and peer.ended < first]:
            del self._peers[number]

    async def wait(
        self,
        seq: int,
        match: Mapping[str, object],
        count: int,
        timeout_s: float,
        more: Callable[[float], Awaitable[None]] | None = None,
    ) -> list[JournalEntry]:
        """Wait for entries from ``seq`` on whose fields equal ``match``; return them as soon as there are ``count``, or
        those found after ``timeout_s`` seconds. A field that an entry lacks equals nothing, not even None.

        Args:
            more: returns when there may be more entries, or after so many seconds; by default when something was recorded.
        """
        end = time.monotonic() + timeout_s
        found: list[JournalEntry] = []
        while True:
            found += [entry for entry in self.since(seq) if has(entry, **match)]
            seq = max(seq, self._next)
            rest_s = end - time.monotonic()
            if len(found) >= count or rest_s <= 0:
                return found
            await (more or self.recorded)(rest_s)

    async def recorded(self, timeout_s: float) -> None:
        """Return when something was recorded, or after so many seconds."""
        self._news.clear()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._news.wait(), timeout_s)

    def heard_of(self, connection: int, process: PeerProcess | None) -> None:
        """Note which process has the other end of a client's connection."""
        self._peers[connection] = Peer(accepted_ns=time.monotonic_ns(), process=process)

    @property
    def peers(self) -> Mapping[int, Peer]:
        """The other ends of the clients' connections, by number."""
        return self._peers

    # -- of a tap -----------------------------------------------------------------------------------------

    def frame(
        self, connection: int, direction: Direction, frame: bytes, fault: str | None, passed_ns: int | None = None
    ) -> None:
        """Record one frame that passes now, or passed at ``passed_ns`` of the monotonic clock; ``fault`` is what the tap does to it."""
        self._frames.append((passed_ns or time.monotonic_ns(), connection, direction, frame, fault))
        self._news.set()

    def event(
        self,
        connection: int,
        direction: Direction,
        kind: str,
        *,
        origin: Origin = "client",
        passed_ns: int | None = None,
        **fields: object,
    ) -> None:
        """Record an event that is no frame, of now or of ``passed_ns`` of the monotonic clock."""
        self._catch_up()
        message = Message(direction=direction, kind=kind, fields=fields)
        self._append(passed_ns or time.monotonic_ns(), connection, message, origin, None, {})
        self._news.set()

    def _catch_up(self) -> None:
        while self._frames:
            t_ns, connection, direction, frame, fault = self._frames.popleft()
            told = {} if fault is None else {"fault": fault}
            for message in self._decoded(connection, direction, frame):
                self._append(t_ns, connection, message, "client", frame, told)

    # -- of a mock ----------------------------------------------------------------------------------------

    def take(self, told: Mapping[str, Any]) -> None:
        """Decode the records of a mock that have not been taken yet.

        Args:
            told: what it answers to ``journal`` or ``wait``, see the ``control`` module of the mocks.
        """
        if told["first"] > self.taken:
            # It has dropped the oldest: there is no saying what they were.
            self._next += told["first"] - self.taken
            self.dropped += told["first"] - self.taken
            self._entries.clear()
        for number, peer in told["peers"].items():
            self._peers.setdefault(
                int(number), Peer(accepted_ns=peer["accepted_ns"], process=process_told(peer["process"]))
            )
        for record in told["records"]:
            if record["number"] >= self.taken:
                self._take(record)
        self.taken = max(self.taken, told["next"])

    def _take(self, record: Mapping[str, Any]) -> None:
        direction, told, frame = record["direction"], dict(record["fields"]), None
        if record["frame"] is None:
            contract = {name: told.pop(name, False) for name in ("request", "state_changing")}
            messages = [Message(direction=direction, kind=told.pop("kind"), fields=told, **contract)]
            told = {}
        else:
            frame = bytes.fromhex(record["frame"])
            messages = self._decoded(record["connection"], direction, frame)
        if record["answers"] is not None:
            # The device knows which request it answers, also where a fault makes the answer name another.
            told["answers"] = self._seq_of_record.get(record["answers"])
        for message in messages:
            self._seq_of_record[record["number"]] = self._next
            self._append(record["t_ns"], record["connection"], message, record["origin"], frame, told)
        if len(self._seq_of_record) > _MOST_ANSWERABLE:
            del self._seq_of_record[next(iter(self._seq_of_record))]

    # -- entries ------------------------------------------------------------------------------------------

    def _decoded(self, connection: int, direction: Direction, frame: bytes) -> list[Message]:
        return [] if self._conversations is None else self._conversations.decode(connection, direction, frame)

    def _append(
        self,
        t_ns: int,
        connection: int,
        message: Message,
        origin: Origin,
        frame: bytes | None,
        told: Mapping[str, object],
    ) -> None:
        entry = entry_of(message, frame, told, seq=self._next, t_ns=t_ns, connection=connection, origin=origin)
        if len(self._entries) == self._entries.maxlen:
            self.dropped += 1
        self._entries.append(entry)
        peer = self._peers.get(connection)
        if peer is not None and message.direction == "in":
            if message.kind == "DISCONNECTED":
                peer.ended = self._next
            elif peer.spoke is None and message.kind not in _NO_MESSAGES:
                peer.spoke = self._next
        if message.kind == "DISCONNECTED" and self._conversations is not None:
            self._conversations.end(connection)
        self._next += 1
