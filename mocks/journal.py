"""The journal of a device as the device keeps it: the frames that passed, and the events that are no frame, in order.

What a frame says is none of its business: the kit decodes frames when it wants to know (``pytest_otmcp.plant.journal``). A device
says of a frame only what its bytes do not: which message it answers, and what a fault rule has done to it.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from .peer import Process

__all__ = ["Direction", "Journal", "Origin", "Record"]

Direction = Literal["in", "out"]
Origin = Literal["client", "plant", "kit"]

_CAPACITY = 200_000
"""A limit against floods. Records that were read are to be released with :meth:`Journal.forget`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A frame, or an event that is none.

    Attributes:
        number: 0 for the first record of a device process, one more for each that follows.
        t_ns: time of the monotonic clock, in nanoseconds.
        connection: number of the connection, 1 for the first; 0 for none.
        direction: ``in`` for what the device received and for the state of a connection, ``out`` for what it sent.
        origin: whose connection it is: ``client`` (a client from outside), ``plant`` (a simulated part of the plant that
            is a client of its own device), ``kit`` (a poke of the kit that the protocol shows as a message).
        frame: its bytes; None for an event.
        answers: number of the record of the message that this one answers, as far as the device says so.
        fields: JSON-safe; of a frame what the device says beside its bytes, of an event its ``kind`` and what else there is to say.
    """

    number: int
    t_ns: int
    connection: int
    direction: Direction
    origin: Origin
    frame: bytes | None
    answers: int | None
    fields: Mapping[str, Any]

    def told(self) -> dict[str, Any]:
        """Return the record for the control channel."""
        return {
            "number": self.number,
            "t_ns": self.t_ns,
            "connection": self.connection,
            "direction": self.direction,
            "origin": self.origin,
            "frame": None if self.frame is None else self.frame.hex(),
            "answers": self.answers,
            "fields": self.fields,
        }


@dataclass(slots=True, kw_only=True)
class _Peer:
    """The other end of a connection.

    Attributes:
        accepted_ns: time at which the connection was accepted.
        process: that had it then; None if that cannot be known.
        ended: number of the record of its end.
    """

    accepted_ns: int
    process: Process | None
    ended: int | None = None


class Journal:
    """An append-only record. Numbers begin at 0 and are never reused; the oldest records are dropped when the capacity is
    reached, and are counted.

    Attributes:
        next: number that the next record will get.
        dropped: number of records that were dropped before they were released.
        reads: how often somebody has asked for records.
    """

    def __init__(self, capacity: int = _CAPACITY) -> None:
        self._records: deque[Record] = deque(maxlen=capacity)
        self.next = 0
        self.dropped = 0
        self.reads = 0
        self._peers: dict[int, _Peer] = {}
        self._news = asyncio.Event()

    @property
    def first(self) -> int:
        """Number of the oldest record that is kept; that of the next record while there is none."""
        return self.next - len(self._records)

    def connected(self, connection: int, process: Process | None, **fields: Any) -> int:
        """Record a new connection of a client; return the number of the record.

        Args:
            connection: its number.
            process: that has its other end, as :mod:`~.peer` finds it.
            fields: JSON-safe facts of the protocol.
        """
        self.heard_of(connection, process)
        return self.event(connection=connection, direction="in", kind="CONNECTED", **fields)

    def heard_of(self, connection: int, process: Process | None) -> None:
        """Note who has the other end of a connection without a beginning that could be recorded, as senders of datagrams are."""
        self._peers[connection] = _Peer(accepted_ns=time.monotonic_ns(), process=process)

    def frame(
        self,
        frame: bytes,
        *,
        connection: int,
        direction: Direction,
        answers: int | None = None,
        origin: Origin = "client",
        **fields: Any,
    ) -> int:
        """Record a frame of this moment, as it is on the wire; return the number of the record.

        Args:
            frame, connection, direction, answers, origin: see :class:`Record`.
            fields: what the device says of it beside its bytes, such as the ``fault`` that a rule makes of it.
        """
        return self._append(connection, direction, origin, frame, answers, fields)

    def event(
        self,
        *,
        connection: int,
        direction: Direction,
        kind: str,
        answers: int | None = None,
        origin: Origin = "client",
        **fields: Any,
    ) -> int:
        """Record an event of this moment that is no frame; return the number of the record.

        The messages of a protocol that the kit has no decoder for are events too: their fields then say ``request`` and
        ``state_changing``.

        Args:
            connection, direction, answers, origin: see :class:`Record`.
            kind: type of the event.
            fields: JSON-safe facts of it.
        """
        if kind == "DISCONNECTED" and connection in self._peers:
            self._peers[connection].ended = self.next
        return self._append(connection, direction, origin, None, answers, {"kind": kind, **fields})

    def _append(
        self,
        connection: int,
        direction: Direction,
        origin: Origin,
        frame: bytes | None,
        answers: int | None,
        fields: Mapping[str, Any],
    ) -> int:
        record = Record(
            number=self.next,
            t_ns=time.monotonic_ns(),
            connection=connection,
            direction=direction,
            origin=origin,
            frame=frame,
            answers=answers,
            fields=fields,
        )
        if len(self._records) == self._records.maxlen:
            self.dropped += 1
        self._records.append(record)
        self.next += 1
        self._news.set()
        return record.number

    def since(self, number: int) -> list[Record]:
        """Return the kept records with this number or a later one; the cost is that of these records alone."""
        # A deque is slow to index in its middle, but not to walk from its end.
        newest = list(itertools.islice(reversed(self._records), max(0, self.next - number)))
        newest.reverse()
        return newest

    def forget(self, before: int) -> None:
        """Release the records with a smaller number for good; numbers go on."""
        for _ in range(min(before, self.next) - self.first):
            self._records.popleft()
        first = self.first
        self._peers = {
            number: peer for number, peer in self._peers.items() if peer.ended is None or peer.ended >= first
        }

    def peers(self, records: Iterable[Record]) -> dict[int, dict[str, Any]]:
        """Return what is known of the other ends of the connections that these records are about."""
        numbers = dict.fromkeys(record.connection for record in records)
        return {
            number: {"accepted_ns": peer.accepted_ns, "process": None if peer.process is None else asdict(peer.process)}
            for number in numbers
            if (peer := self._peers.get(number)) is not None
        }

    async def wait(self, number: int, timeout_s: float) -> None:
        """Return when there is a record of this number, or after so many seconds."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while self.next <= number:
                    self._news.clear()
                    await self._news.wait()
