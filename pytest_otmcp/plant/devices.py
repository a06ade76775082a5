"""The devices of a run; each is started once, when it is first asked for."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from importlib import import_module

from ..protocols.registry import protocols
from ..session.isolation import Isolation
from .device import Device
from .mock_device import MockDevice

__all__ = ["Plant"]


class Plant:
    """The devices of a run. Its methods are to be used on the kit's loop.

    Args:
        external: protocol to the URL of a device of the user's own, used behind the kit's tap instead of the mock.
        isolation: of the adapters, or None for none.
        outside: protocol to the reason why its adapter needs the network of the machine; empty where it does not.
    """

    def __init__(
        self,
        external: Mapping[str, str] | None = None,
        isolation: Isolation | None = None,
        outside: Mapping[str, str] | None = None,
    ) -> None:
        self._isolation = isolation
        self._outside = dict(outside or {})
        self._external = dict(external or {})
        self._devices: dict[str, Device] = {}
        self._launches: dict[str, asyncio.Task[None]] = {}

    async def launch(self, names: Iterable[str]) -> None:
        """Begin to start these devices, without waiting for any of them."""
        for name in names:
            self._launch(name)

    def _launch(self, name: str) -> None:
        if name not in self._devices:
            key = name.partition("@")[0]
            device = self._new(key)
            if self._isolation is not None:
                device.walls = self._isolation.walls(outside=self._why_outside(key))
            self._devices[name] = device
            self._launches[name] = asyncio.create_task(device.launch())

    def _new(self, key: str) -> Device:
        protocol = protocols()[key]
        if key not in self._external or protocol.external is None:
            return MockDevice(protocol.mock, key)
        module, _, name = protocol.external.implementation.partition(":")
        device: Device = getattr(import_module(module), name)(self._external[key])
        return device

    def _why_outside(self, key: str) -> str:
        if key in self._external:
            return f"the device for {protocols()[key].name} is {self._external[key]}"
        return f"{protocols()[key].name}: {why}" if (why := self._outside.get(key)) else ""

    async def device(self, name: str) -> Device:
        """Return the device ``protocol`` or ``protocol@instance``, running.

        Raises:
            KitError: it could not be started; every later request raises the error again at once.
        """
        self._launch(name)
        # All callers wait for the same launch; a caller that stops waiting does not cancel it for the others.
        await asyncio.shield(self._launches[name])
        return self._devices[name]

    async def close(self) -> None:
        """End every device."""
        await asyncio.gather(*self._launches.values(), return_exceptions=True)
        await asyncio.gather(*(device.close() for device in self._devices.values()), return_exceptions=True)
        self._devices.clear()
        self._launches.clear()
