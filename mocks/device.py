"""The base class of all devices, and the clock of their simulation. See ``packages`` for what else a mock offers."""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .endpoint import OpenEndpoint
from .journal import Journal
from .serial_line import SerialLine

__all__ = ["Device", "Simulation"]


class Device(ABC):
    """A device that serves one protocol and keeps a journal of what reached it.

    Attributes:
        protocol: name of the protocol.
        port: port of the first endpoint, None if that has none; set by the launcher, before ``serve``.
        journal: everything that reached the device and that it sent.
        lines: its serial lines.
    """

    protocol: str
    port: int | None = None
    lines: Sequence[SerialLine] = ()

    def __init__(self) -> None:
        self.journal = Journal()

    @abstractmethod
    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        """Serve on the declared endpoints, by name; return when connections are accepted and telegrams read."""

    @abstractmethod
    async def aclose(self) -> None:
        """Stop serving."""

    def secure(self, folder: Path) -> None:
        """Speak the secure form of the protocol, with the certificates of a folder; called before ``serve``. See :mod:`.tls`.

        Raises:
            ValueError: the protocol has none.
        """
        raise ValueError(f"{self.protocol} has no secure form here")

    async def caught_up(self) -> None:
        """Return when all that clients had sent before has been read. What they send over sockets is there at once."""
        for line in self.lines:
            await line.caught_up()

    @abstractmethod
    def image(self) -> dict[str, Any]:
        """Return a JSON-safe copy of the values that the device really holds.

        Its member ``points`` is flat and exists for every protocol: it maps the name of each value that the plant
        holds, in the protocol's own addressing, to the value. The other members are the protocol's own.
        """

    @abstractmethod
    async def poke(self, params: Mapping[str, Any]) -> None:
        """Set a value out of band.

        Raises:
            ValueError: the parameters name something that does not exist; the message says what.
        """

    @abstractmethod
    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        """Replace the fault plan; return how often each rule of the old plan was applied.

        Raises:
            ValueError: a rule is not understood; the old plan stays.
        """

    @property
    def dead_connections(self) -> int:
        """Number of connections over which nothing passes any more, although neither side has been told of an end."""
        return 0

    @abstractmethod
    async def reset(self) -> None:
        """Restore the start-up values and drop the faults; connections and journal stay. Never called during a tick."""

    @abstractmethod
    async def tick(self) -> None:
        """Advance the simulation by one second of plant time, deterministically. Never called during a reset."""


class Simulation:
    """The clock that ticks a device once a second until paused; one tick or reset at a time."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._task: asyncio.Task[None] | None = None
        self._turn = asyncio.Lock()

    def resume(self) -> None:
        """Tick once a second from now on."""
        if self._task is None:
            self._task = asyncio.create_task(self._run(), name="simulation")

    async def pause(self) -> None:
        """Stop ticking; when this returns no tick is under way."""
        task, self._task = self._task, None
        if task is None:
            return
        # While this method holds the lock the task is between ticks, so no tick is cut short.
        async with self._turn:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    async def tick(self, steps: int) -> None:
        """Advance by this many seconds at once."""
        for _ in range(steps):
            async with self._turn:
                await self._device.tick()

    async def reset(self) -> None:
        """Restore the start-up values; the simulation stays running or paused as before."""
        async with self._turn:
            await self._device.reset()

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            due += 1.0
            await asyncio.sleep(max(0.0, due - loop.time()))
            try:
                await self.tick(1)
            except Exception as error:
                # Without a report a plant whose ticks fail would be taken for a paused plant.
                loop.call_exception_handler({"message": "a tick of the simulation failed", "exception": error})
