"""The plant: every device of a run, each started once, whoever asks for it first."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from .external_broker import TappedBroker
from .mock_device import MockDevice

__all__ = ["Device", "Plant"]

Device = MockDevice | TappedBroker


class Plant:
    """The devices. Use its methods on the kit's loop.

    Args:
        broker: URL of an external MQTT broker to use, behind the kit's tap, instead of the embedded one.
    """

    def __init__(self, broker: str | None = None) -> None:
        self._broker = broker
        self._devices: dict[str, Device] = {}
        self._launches: dict[str, asyncio.Task[None]] = {}

    async def launch(self, names: Iterable[str]) -> None:
        """Begin to start these devices, without waiting for any."""
        for name in names:
            self._launch(name)

    def _launch(self, name: str) -> None:
        if name not in self._devices:
            protocol = name.partition("@")[0]
            tapped = self._broker if protocol == "mqtt" else None
            device = MockDevice(protocol) if tapped is None else TappedBroker(tapped)
            self._devices[name] = device
            self._launches[name] = asyncio.create_task(device.launch())

    async def device(self, name: str) -> Device:
        """The device ``protocol`` or ``protocol@instance``, running.

        Raises:
            KitError: it could not be started; said again at once to whoever asks next.
        """
        self._launch(name)
        # Everybody who asks waits for the one launch; nobody who gives up waiting cancels it for the others.
        await asyncio.shield(self._launches[name])
        return self._devices[name]

    async def close(self) -> None:
        """End every device."""
        await asyncio.gather(*self._launches.values(), return_exceptions=True)
        await asyncio.gather(*(device.close() for device in self._devices.values()), return_exceptions=True)
        self._devices.clear()
        self._launches.clear()
