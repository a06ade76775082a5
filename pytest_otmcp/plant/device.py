"""The interface of a device, mock or not: its life, its journal, its image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ..core.errors import MeddledError
from ..protocols.journal import JournalEntry
from ..session.isolation import Walls
from .endpoint import Endpoint
from .owners import Sessions

__all__ = ["Device", "Journal", "check_kept"]


def check_kept(since: int, first: int) -> None:
    """Raise an error when a journal no longer holds the entries asked for.

    Args:
        since: sequence number of the first entry asked for.
        first: sequence number of the oldest entry that the journal holds.

    Raises:
        KitError: the oldest of the entries were released, or have given way to newer ones.
    """
    if since < first:
        raise MeddledError(
            f"the journal no longer goes back to entry {since}: the oldest that it holds is {first}; the device was flooded, which an "
            "adapter can do"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Journal:
    """A slice of a device's journal.

    Attributes:
        entries: in the order of their arrival.
        next: sequence number that the next entry will get.
    """

    entries: list[JournalEntry]
    next: int


class Device(Protocol):
    """A device that adapters connect to and that is the witness of what they do.

    Attributes:
        running: True while it serves.
        faulty: True while a fault plan or a delay is in force.
        accepting_ns: monotonic time since which it serves. A TCP port accepts connections then. A UDP port or a pseudo
            terminal accepts nothing; there it is the time at which the device said that it reads its telegrams.
        sessions: the sessions of adapters that it is there for; its journal says of each entry whose it is.
        credentials: what an adapter needs to reach it where it speaks the secure form of its protocol, as PEM: ``ca``, ``cert``, ``key``;
            empty where it does not.
        account: ``user`` and ``password`` of the account that it knows there; empty where it knows none.
        walls: around its adapters, or None for none; its endpoints are where they lead. They are set before it is launched.
    """

    running: bool
    faulty: bool
    accepting_ns: int
    sessions: Sessions
    credentials: Mapping[str, bytes]
    account: Mapping[str, str]
    walls: Walls | None

    @property
    def endpoints(self) -> Mapping[str, Endpoint]:
        """Its endpoints for adapters, by name, the main endpoint first; empty before the launch."""
        ...

    @property
    def host(self) -> str:
        """Address of its first port; empty if it has none."""
        ...

    @property
    def port(self) -> int:
        """Number of its first port; 0 if it has none."""
        ...

    async def launch(self) -> None:
        """Start it and wait until it serves.

        Raises:
            KitError: it cannot be started.
        """

    async def stop(self) -> None:
        """Take its endpoints away: TCP connections break and new ones are refused; datagrams and telegrams are not
        answered, and those that are sent meanwhile are never delivered."""

    async def start(self) -> None:
        """Bring its endpoints back at the same addresses, with an empty journal; ``accepting_ns`` says when.

        Raises:
            ExhaustedError: another program has taken one of them.
        """

    async def close(self) -> None:
        """End it for good."""

    async def image(self) -> dict[str, object]:
        """Return what the device really holds.

        Raises:
            KitError: it cannot be asked.
        """
        ...

    async def mark(self) -> int:
        """Return the sequence number that the next journal entry will get."""
        ...

    async def first(self) -> int:
        """Return the sequence number of the oldest journal entry that has not been released, or of the next entry."""
        ...

    async def journal(self, since: int) -> Journal:
        """Return the entries from ``since`` on.

        Raises:
            KitError: the oldest of them were released, or have given way to newer ones.
        """
        ...

    async def wait(
        self, since: int, match: Mapping[str, object], *, timeout_s: float, count: int = 1
    ) -> list[JournalEntry]:
        """Wait for entries from ``since`` on that have all fields of ``match``; return them as soon as there are
        ``count``, or those found when the time is over.

        Raises:
            KitError: the oldest entries from ``since`` on were released, or have given way to newer ones.
        """
        ...

    async def forget(self, before: int) -> None:
        """Release the entries before ``before`` for good: they have been read."""

    async def poke(self, **params: object) -> None:
        """Set a value out of band."""

    async def preset(self, presets: Sequence[Mapping[str, object]]) -> None:
        """Give it by pokes what has to be there for an adapter: now, and again whenever it was started or reset.

        A device of the user's own has what it has.
        """

    async def fault(self, *rules: Mapping[str, object]) -> None:
        """Replace the fault plan; no rules clears it.

        Raises:
            KitError: the device is none of the kit's own.
        """

    async def delay(self, seconds: float) -> None:
        """Give every answer so many seconds late from now on; 0 ends that."""

    async def reset(self) -> bool:
        """Bring back start-up values without faults; connections and journal stay. Return whether a connection is dead that its client may
        not have given up."""

    async def tick(self, steps: int = 1) -> None:
        """Advance the simulation by ``steps`` seconds of plant time."""
