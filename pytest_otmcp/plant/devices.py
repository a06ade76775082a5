"""The devices of a run; each is started once, when it is first asked for."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path

from ..core.walls import OFF
from ..protocols.external import BROKER, external_devices
from ..protocols.field import Consent
from ..protocols.protocol import LAUNCHES, SECURE
from ..protocols.registry import protocols
from ..session.isolation import Isolation
from .device import Device
from .field_device import FieldDevice, UnrestoredError
from .mock_device import MockDevice

__all__ = ["Plant"]


class Plant:
    """The devices of a run. Its methods are to be used on the kit's loop.

    Args:
        external: protocol to the URL of a device of the user's own, used behind the kit's tap instead of the mock.
        isolation: of the adapters, or None for none.
        outside: protocol to the reason why its adapter needs the network of the machine; empty where it does not.
        consents: protocol to what may be written to its real device.
        capture: file that shows what goes to the real device of the run, in place of the tap; None for the tap.
    """

    def __init__(
        self,
        external: Mapping[str, str] | None = None,
        isolation: Isolation | None = None,
        outside: Mapping[str, str] | None = None,
        consents: Mapping[str, Consent] | None = None,
        capture: Path | None = None,
    ) -> None:
        self._capture = capture
        self._consents = dict(consents or {})
        self._isolation = isolation
        self._own: Isolation | None = None
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
            key, _, variant = name.partition("@")
            device = self._new(key, secure=variant == LAUNCHES[SECURE])
            cable = protocols()[key].cable
            if cable and self._isolation is None:
                self._isolation = self._own = Isolation(OFF)
            if self._isolation is not None and (cable or self._own is None):
                device.walls = self._isolation.walls(outside=self._why_outside(key), cable=cable)
            self._devices[name] = device
            self._launches[name] = asyncio.create_task(device.launch())

    def _new(self, key: str, *, secure: bool) -> Device:
        protocol = protocols()[key]
        # Of a device of the user's own nobody could have another certificate.
        if secure or key not in self._external or protocol.external is None:
            return MockDevice(protocol.mock, key, secure=secure)
        module, _, name = protocol.external.implementation.partition(":")
        # A kind of device that takes no consent has none.
        consent = [self._consents[key]] if key in self._consents else []
        device: Device = getattr(import_module(module), name)(self._external[key], *consent)
        if isinstance(device, FieldDevice):
            device.capture = self._capture
        return device

    def _why_outside(self, key: str) -> str:
        if key in self._external and (external_devices()[key].option == BROKER or self._capture is not None):
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
        """End every device.

        Raises:
            UnrestoredError: a real device did not get its old values back.
        """
        await asyncio.gather(*self._launches.values(), return_exceptions=True)
        ended = await asyncio.gather(*(device.close() for device in self._devices.values()), return_exceptions=True)
        self._devices.clear()
        self._launches.clear()
        if self._own is not None:
            self._own.close()
            self._isolation = self._own = None
        for problem in ended:
            if isinstance(problem, UnrestoredError):
                raise problem
