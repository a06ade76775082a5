"""A mock device as one test sees it. Everything here runs on the kit's loop; the handles in ``devices`` call it.

The device process outlives the test: :meth:`Witness.begin` gives it back its start-up values and notes where the test's
part of the journal begins.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from .errors import KitError, UsageError
from .fixture_entries import JournalEntry
from .mock_device import MockDevice

__all__ = ["Witness"]

E = TypeVar("E", bound=JournalEntry)

_SETTLING_S = 0.5


class Witness(Generic[E]):
    """One mock device during one test."""

    def __init__(self, device: MockDevice, entry: type[E], fixture: str) -> None:
        self.device = device
        self._entry = entry
        self._fixture = fixture
        self._since = 0
        self._before_stop: list[E] = []

    async def begin(self) -> None:
        """Serve, with start-up values and without faults; the journal of the test begins here."""
        await self.start()
        await self.device.reset()
        self._before_stop.clear()
        self._since = await self.device.mark()

    async def settle(self) -> None:
        """Wait until the device has noticed that this test's connections are closed: the next test's journal must not
        begin with their end. Not for long, because they may be somebody's who keeps them."""
        if self.device.running:
            entries = await self.journal()
            opened = sum(entry.kind == "CONNECTED" for entry in entries)
            await self.wait_for({"kind": "DISCONNECTED"}, opened, _SETTLING_S)

    async def start(self) -> None:
        """A new device process on the same port, unless it is running."""
        if not self.device.running:
            await self.device.start()
            self._since = 0

    async def stop(self) -> None:
        """End the device process, if it is running; what its journal holds is kept."""
        if self.device.running:
            self._before_stop = await self.journal()
            await self.device.stop()

    async def journal(self) -> list[E]:
        """The entries since the test began."""
        if not self.device.running:
            return list(self._before_stop)
        journal = await self.device.journal(self._since)
        return self._before_stop + [self._entry(entry) for entry in journal.entries]

    async def wait_for(self, match: Mapping[str, Any], count: int, timeout_s: float) -> list[E]:
        """The entries of the test that match, as soon as there are ``count``, or when the time is over."""
        self._needs_device("wait_for")
        found = [entry for entry in self._before_stop if entry.matches(match)]
        fresh = await self.device.wait(self._since, match, count=count - len(found), timeout_s=timeout_s)
        return found + [self._entry(entry) for entry in fresh]

    async def image(self) -> dict[str, Any]:
        """What the device holds."""
        self._needs_device("image")
        return await self.device.image()

    async def tick(self, seconds: int) -> None:
        """Let plant time pass."""
        self._needs_device("tick")
        await self.device.tick(seconds)

    async def reset(self) -> None:
        """Start-up values and no faults; the journal goes on."""
        self._needs_device("reset")
        await self.device.reset()

    async def poke(self, **params: Any) -> None:
        """Set a value out of band."""
        self._needs_device("poke")
        with _refusals(self._fixture, "poke"):
            await self.device.poke(**params)

    async def fault(self, *rules: Mapping[str, Any]) -> None:
        """Replace the fault plan."""
        self._needs_device("fault")
        with _refusals(self._fixture, "fault"):
            await self.device.fault(*rules)

    def _needs_device(self, method: str) -> None:
        if not self.device.running:
            raise UsageError(f"{self._fixture}.{method}(): the device is stopped; start() it first")


class _refusals:
    """What the device does not understand is the test's mistake, not the kit's."""

    def __init__(self, fixture: str, method: str) -> None:
        self._what = f"{fixture}.{method}()"

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, KitError) and " refused " in str(error):
            raise UsageError(f"{self._what}: {str(error).partition(': ')[2]}") from None
