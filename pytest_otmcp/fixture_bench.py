"""What the public fixtures share: devices and a loop for the whole test process, sessions for one test.

The conformance suite has a bench of its own: nothing that a vendor's tests do here reaches the devices it is judged by.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any

from .devices import Broker, JournalEntry, ModbusDevice, ModbusEntry, MqttEntry, OpcUaEntry, OpcUaPlant
from .errors import UsageError
from .fixture_device import Witness
from .loop import LoopThread
from .mock_device import MockDevice
from .plant import Plant
from .sessions import Session, SessionFactory, unknown
from .station import BenchOptions, Station
from .subject.model import READ_ONLY, READ_WRITE
from .subject.operations import PROTOCOLS

if TYPE_CHECKING:
    from .subject import Subject

__all__ = ["Desk", "Workshop"]

_FIXTURES = {"modbus": "otmcp_modbus_device", "mqtt": "otmcp_broker", "opcua": "otmcp_opcua_plant"}
_ENTRIES: dict[str, type[JournalEntry]] = {"modbus": ModbusEntry, "mqtt": MqttEntry, "opcua": OpcUaEntry}


class Workshop:
    """The kit's loop and the devices of one test process, each started when it is first asked for."""

    def __init__(self, options: BenchOptions) -> None:
        self.options = options
        self.loop = LoopThread()
        self.plant = Plant()

    def close(self) -> None:
        """End everything."""
        self.loop.run(self.plant.close())
        self.loop.close()


class Desk:
    """The devices and sessions of one test.

    Args:
        workshop: where they come from.
    """

    def __init__(self, workshop: Workshop) -> None:
        self._loop = workshop.loop
        self._workshop = workshop
        self._witnesses: dict[str, Witness[Any]] = {}
        self._stations: list[Station] = []
        self._turn = asyncio.Lock()

    # -- for fixtures -------------------------------------------------------------------------------------

    def modbus_device(self) -> ModbusDevice:
        """The Modbus device as it is at its start."""
        return ModbusDevice(self._loop, self._loop.run(self._witness("modbus")))

    def broker(self) -> Broker:
        """The MQTT broker as it is at its start."""
        return Broker(self._loop, self._loop.run(self._witness("mqtt")))

    def opcua_plant(self) -> OpcUaPlant:
        """The OPC UA plant as it is at its start."""
        return OpcUaPlant(self._loop, self._loop.run(self._witness("opcua")))

    def sessions(self, subject: Subject) -> SessionFactory:
        """What opens sessions of the subject's adapters at these devices."""
        return SessionFactory(self._loop, partial(self._open, subject))

    def close(self) -> None:
        """End the sessions of the test."""
        self._loop.run(self._close())

    # -- on the kit's loop --------------------------------------------------------------------------------

    async def _witness(self, protocol: str) -> Witness[Any]:
        # One at a time: whoever asks second must find the device as the first has prepared it.
        async with self._turn:
            if protocol not in self._witnesses:
                device = await self._workshop.plant.device(protocol)
                assert isinstance(device, MockDevice)
                witness = Witness(device, _ENTRIES[protocol], _FIXTURES[protocol])
                await witness.begin()
                self._witnesses[protocol] = witness
        return self._witnesses[protocol]

    async def _open(self, subject: Subject, protocol: str, variant: str) -> Session:
        where = f"otmcp_session({protocol!r})"
        if protocol not in PROTOCOLS:
            raise UsageError(f"{where}: {unknown('protocol', protocol, PROTOCOLS)}")
        if variant not in (READ_WRITE, READ_ONLY):
            raise UsageError(f"{where}: {unknown('variant', variant, (READ_WRITE, READ_ONLY))}")
        if protocol not in subject.adapters:
            raise UsageError(
                f"{where}: {subject.name} has no adapter for {PROTOCOLS[protocol]}, only for "
                f"{', '.join(PROTOCOLS[name] for name in subject.adapters)}; add [adapter.{protocol}] to {subject.source}"
            )
        witness = await self._witness(protocol)
        if not witness.device.running:
            raise UsageError(f"{where}: the device is stopped; start() it first")
        station = Station(subject.adapters[protocol], variant, witness.device, self._workshop.options)
        self._stations.append(station)
        await station.open()
        return Session(self._loop, station)

    async def _close(self) -> None:
        await asyncio.gather(*(station.close() for station in self._stations), return_exceptions=True)
        used = {station.adapter.protocol for station in self._stations}
        await asyncio.gather(*(self._witnesses[protocol].settle() for protocol in used))
