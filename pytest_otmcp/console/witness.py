"""The journal of a mock device while it is looked at, through its restarts.

A device that is started again begins its journal at 0. An entry is therefore named by its generation, the number of the start, and its
sequence number.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from ..core.errors import KitError
from ..plant.mock_device import MockDevice
from ..protocols.journal import JournalEntry

__all__ = ["Row", "Witness"]

_KEPT = 5000
"""Entries that are kept here; the device itself forgets what has been read and is twice as old."""

_LONG_POLL_S = 20.0


@dataclass(frozen=True, slots=True)
class Row:
    """One entry of the journal in the generation of its device."""

    generation: int
    entry: JournalEntry

    @property
    def name(self) -> str:
        """Name of the entry among those of all generations."""
        return f"{self.generation}.{self.entry['seq']}"


class Witness:
    """Follows a device's journal.

    Args:
        device: is started and stopped by others; :meth:`begin` and :meth:`end` say when.
        tell: is given the new rows, in their order.
        failed: is given the reason why the device cannot be followed any more.

    Attributes:
        rows: the newest ones.
        generation: number of the device's start, from 1.
    """

    def __init__(
        self,
        device: MockDevice,
        tell: Callable[[Sequence[Row]], Awaitable[None]],
        failed: Callable[[str], None],
    ) -> None:
        self._device = device
        self._tell = tell
        self._failed = failed
        self._since = 0
        self._fetching = asyncio.Lock()
        self._task: asyncio.Task[None] | None = None
        self._arrived = asyncio.Event()
        self.rows: deque[Row] = deque(maxlen=_KEPT)
        self.generation = 0

    def begin(self) -> None:
        """Follow the device, which has just been started."""
        self.generation += 1
        self._since = 0
        self._task = asyncio.create_task(self._follow(), name="otmcp-console-witness")

    async def end(self) -> None:
        """Take what is in the journal of the device, which is about to be stopped, and follow it no more."""
        task, self._task = self._task, None
        if task is None:
            return
        task.cancel()
        await asyncio.wait({task})
        try:
            await self.catch_up()
        except KitError as error:
            self._failed(str(error))

    async def catch_up(self) -> None:
        """Take everything that the device has recorded so far.

        Raises:
            KitError: it does not answer, or was flooded.
        """
        async with self._fetching:
            if not self._device.running:
                return
            found = await self._device.journal(self._since)
            self._since = found.next
            rows = [Row(self.generation, entry) for entry in found.entries]
            self.rows.extend(rows)
            self._arrived.set()
            if self._since > 2 * _KEPT:
                await self._device.forget(self._since - 2 * _KEPT)
        if rows:
            await self._tell(rows)

    async def news(self, timeout_s: float) -> None:
        """Return when there may be new rows, or after so many seconds."""
        self._arrived.clear()
        with suppress(TimeoutError):
            await asyncio.wait_for(self._arrived.wait(), timeout_s)

    async def _follow(self) -> None:
        try:
            while True:
                await self._device.wait(self._since, {}, timeout_s=_LONG_POLL_S)
                await self.catch_up()
        except KitError as error:
            self._failed(str(error))
