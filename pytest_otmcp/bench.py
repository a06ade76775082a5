"""The test bench: the plant's devices, one station per adapter variant, and where the time went.

The bench starts what is asked for and ends everything; it does not know tasks and does not judge.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from .plant import MockDevice
from .station import READ_ONLY, READ_WRITE, BenchOptions, Device, NoBindingError, Station
from .subject import Subject
from .subject.drift import drift
from .tap_broker import TappedBroker

__all__ = ["READ_ONLY", "READ_WRITE", "Bench", "BenchOptions", "NoBindingError", "Plant", "Station", "TimeSpent"]


@dataclass(slots=True)
class TimeSpent:
    """Wall-clock seconds by what they were spent on; nested spans count once, for the innermost."""

    seconds: dict[str, float] = field(default_factory=dict)
    _stack: list[list[Any]] = field(default_factory=list)

    @contextmanager
    def on(self, what: str) -> Iterator[None]:
        """Count the time inside the block as spent on ``what``."""
        now = time.monotonic()
        if self._stack:
            self._add(self._stack[-1][0], now - self._stack[-1][1])
        self._stack.append([what, now])
        try:
            yield
        finally:
            now = time.monotonic()
            name, since = self._stack.pop()
            self._add(name, now - since)
            if self._stack:
                self._stack[-1][1] = now

    def move(self, source: str, target: str, seconds: float) -> None:
        """Count ``seconds`` as spent on ``target`` instead of ``source``."""
        self._add(source, -seconds)
        self._add(target, seconds)

    def _add(self, what: str, seconds: float) -> None:
        self.seconds[what] = self.seconds.get(what, 0.0) + seconds


class Plant:
    """The devices, each started when it is first asked for.

    Args:
        broker: URL of an external MQTT broker to use, behind the kit's tap, instead of the embedded one.
    """

    def __init__(self, broker: str | None = None) -> None:
        self._broker = broker
        self._devices: dict[str, Device] = {}
        self._launches: dict[str, asyncio.Task[None]] = {}

    async def device(self, name: str) -> Device:
        """The device ``protocol`` or ``protocol@instance``, running.

        Raises:
            KitError: it could not be started; said again at once to whoever asks next.
        """
        if name not in self._devices:
            protocol = name.partition("@")[0]
            tapped = self._broker if protocol == "mqtt" else None
            device = MockDevice(protocol) if tapped is None else TappedBroker(tapped)
            self._devices[name] = device
            self._launches[name] = asyncio.create_task(device.launch())
        # Everybody who asks waits for the one launch; nobody who gives up waiting cancels it for the others.
        await asyncio.shield(self._launches[name])
        return self._devices[name]

    async def close(self) -> None:
        """End every device."""
        await asyncio.gather(*self._launches.values(), return_exceptions=True)
        await asyncio.gather(*(device.close() for device in self._devices.values()), return_exceptions=True)
        self._devices.clear()
        self._launches.clear()


class Bench:
    """Everything that runs during a test run. Use :meth:`prepare` and :meth:`close` on the kit's loop.

    Args:
        subject: who is tested.
        options: see :class:`BenchOptions`.
        plant: the devices, if they are to outlive this bench.
    """

    def __init__(self, subject: Subject, options: BenchOptions | None = None, plant: Plant | None = None) -> None:
        self.subject = subject
        self.options = options or BenchOptions()
        self.spent = TimeSpent()
        self._plant = plant or Plant(self.options.broker)
        self._owns_plant = plant is None
        self._stations: dict[tuple[str, str], Station] = {}

    async def prepare(self, protocols: Iterable[str]) -> None:
        """Start the devices and the read-write adapters of these protocols, all at once.

        An adapter that cannot be started is not an error here: its first task will say so.

        Raises:
            KitError: a mock could not be started.
        """
        wanted = [name for name in dict.fromkeys(protocols) if name in self.subject.adapters]
        with self.spent.on("plant start"):
            await asyncio.gather(*(self._plant.device(name) for name in wanted))
        with self.spent.on("adapter starts"):
            stations = [await self.station(name) for name in wanted]
            await asyncio.gather(*(station.open() for station in stations), return_exceptions=True)

    async def station(self, protocol: str, variant: str = READ_WRITE) -> Station:
        """The station of an adapter variant; its session is not opened.

        The read-only variant gets a device of its own: what reaches that device during the whole life of a session
        can then be nobody else's doing.
        """
        key = (protocol, variant)
        if key not in self._stations:
            device = await self._plant.device(protocol if variant == READ_WRITE else f"{protocol}@{variant}")
            self._stations[key] = Station(self.subject.adapters[protocol], variant, device, self.options)
        return self._stations[key]

    def drift(self) -> list[str]:
        """Contradictions between the subject file and the tools that the adapters list, a sentence each."""
        found = []
        for (_, variant), station in self._stations.items():
            # The read-only variant need not have every tool.
            if variant == READ_WRITE and station.tools is not None:
                found += drift(station.adapter, station.tools)
        return found

    def facts(self) -> dict[str, Any]:
        """What is known of the subject's servers, as ``run.json`` has it under ``subject.adapters``."""
        facts: dict[str, Any] = {}
        for (protocol, variant), station in self._stations.items():
            session = station.session
            if variant == READ_WRITE and session is not None:
                facts[protocol] = {
                    **station.adapter.facts(),
                    "unmet": sorted(station.unmet),
                    "server_name": session.server_name,
                    "server_version": session.server_version,
                    "protocol_version": session.protocol_version,
                    "tools": len(session.tools),
                }
        return facts

    async def close(self) -> None:
        """End every session, and every device unless the plant is somebody else's."""
        with self.spent.on("adapter starts"):
            await asyncio.gather(*(station.close() for station in self._stations.values()), return_exceptions=True)
        self._stations.clear()
        if self._owns_plant:
            await self._plant.close()
