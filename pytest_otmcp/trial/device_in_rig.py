"""The device of a rig, as the steps of a repetition see and change it."""

from __future__ import annotations

from collections.abc import Mapping

from .player import Player

__all__ = ["DeviceInRig"]


class DeviceInRig:
    """A mock device at which the steps look, and which they change out of band."""

    def __init__(self, player: Player) -> None:
        self._player = player

    @property
    def url(self) -> str:
        """Where the device listens; empty where the protocol has no URL."""
        return self._player.placeholders.get("url", "")

    @property
    def placeholders(self) -> Mapping[str, str]:
        """What the placeholders of a subject file stand for that say where it is."""
        return self._player.placeholders

    @property
    def addresses(self) -> list[tuple[str, int]]:
        """Host and port of each of its endpoints, the main one first."""
        return self._player.addresses

    @property
    def running(self) -> bool:
        """It runs."""
        return self._player.running

    @property
    def accepting_ns(self) -> int:
        """Monotonic time since which it accepts connections."""
        return self._player.accepting_ns

    async def image(self) -> dict[str, object]:
        """Return the values that it really holds."""
        return await self._player.image()

    async def excuse(self) -> None:
        """See :meth:`pytest_otmcp.plant.field_device.FieldDevice.excuse`."""
        await self._player.act(lambda adapter: adapter.excuse())

    async def poke(self, **params: object) -> None:
        """Set a value."""
        await self._player.act(lambda adapter: adapter.device.poke(**params))

    async def fault(self, *rules: Mapping[str, object]) -> None:
        """Replace its faults by these, in the words of its fault plan; without any rule they end."""
        await self._player.act(lambda adapter: adapter.device.fault(*rules))

    async def delay(self, seconds: float) -> None:
        """Have it answer so many seconds late; 0 ends that."""
        await self._player.act(lambda adapter: adapter.device.delay(seconds))

    async def tick(self, steps: int) -> None:
        """Let ``steps`` seconds of plant time pass."""
        await self._player.act(lambda adapter: adapter.device.tick(steps))
