"""What the kit asks of a device, mock or not: its life, its journal, its image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from .mock_device import Entry, Journal

__all__ = ["Device"]


class Device(Protocol):
    """A device that adapters connect to and that bears witness.

    Attributes:
        host, port: where adapters connect.
        running: it accepts connections.
        accepting_ns: monotonic; since when it does.
    """

    host: str
    port: int
    running: bool
    accepting_ns: int

    async def launch(self) -> None:
        """Start it and wait until it accepts connections.

        Raises:
            KitError: it cannot be started.
        """

    async def stop(self) -> None:
        """Let the endpoint vanish: connections die, new ones are refused."""

    async def start(self) -> None:
        """Let the endpoint come back at the same address; ``accepting_ns`` says when."""

    async def close(self) -> None:
        """End it for good."""

    async def image(self) -> dict[str, Any]:
        """What the device really holds."""
        ...

    async def mark(self) -> int:
        """Sequence number that the next journal entry will get."""
        ...

    async def journal(self, since: int) -> Journal:
        """The entries from ``since`` on.

        Raises:
            KitError: the oldest of them have given way to newer ones.
        """
        ...

    async def forget(self, before: int) -> None:
        """Release the entries before ``before`` for good: they have been read."""

    async def wait(self, since: int, match: Mapping[str, Any], *, timeout_s: float, count: int = 1) -> list[Entry]:
        """The entries from ``since`` on whose fields equal ``match``, as soon as there are ``count`` of them, or
        those there are when the time is over."""
        ...

    async def poke(self, **params: Any) -> None:
        """Set a value out of band."""

    async def reset(self) -> None:
        """Bring back start-up values without faults; connections and journal stay."""

    async def tick(self, steps: int = 1) -> None:
        """Advance the simulation by ``steps`` seconds of plant time."""
