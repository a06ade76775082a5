"""Handles of the mock devices and of sessions with the subject, for a vendor's own tests: the kit's public fixtures.

Every handle works in plain tests as it is, and in asynchronous ones through its twin ``aio``, whose methods are awaited:

    def test_write(otmcp_modbus_device):
        image = otmcp_modbus_device.image()

    async def test_write(otmcp_modbus_device):
        image = await otmcp_modbus_device.aio.image()

The work is done on a thread of the kit's own with a loop of its own. It does not matter on which loop a test runs, who made
that loop, or whether there is one.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

from .errors import KitError, SubjectError, UsageError
from .fixture_device import Witness
from .fixture_entries import JournalEntry, ModbusEntry, MqttEntry, OpcUaEntry
from .fixture_handle import Handle
from .loop import LoopThread

__all__ = [
    "AsyncBroker",
    "AsyncDevice",
    "AsyncModbusDevice",
    "AsyncOpcUaPlant",
    "Broker",
    "Device",
    "JournalEntry",
    "KitError",
    "ModbusDevice",
    "ModbusEntry",
    "MqttEntry",
    "OpcUaEntry",
    "OpcUaPlant",
    "SubjectError",
    "UsageError",
]

E = TypeVar("E", bound=JournalEntry)

Rule = Mapping[str, Any]


class _Handle(Handle, Generic[E]):
    """What both forms of a handle have."""

    _scheme = ""

    def __init__(self, loop: LoopThread, witness: Witness[E]) -> None:
        super().__init__(loop)
        self._witness = witness

    @property
    def host(self) -> str:
        """Address on which the device serves."""
        return self._witness.device.host

    @property
    def port(self) -> int:
        """Port on which the device serves: another one in every test process, the same one during all of it."""
        return self._witness.device.port

    @property
    def url(self) -> str:
        """Both as a URL."""
        return f"{self._scheme}://{self.host}:{self.port}"

    @property
    def running(self) -> bool:
        """The device accepts connections."""
        return self._witness.device.running

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.url}{'' if self.running else ', stopped'}>"


class AsyncDevice(_Handle[E]):
    """A device in asynchronous tests; the methods do what those of :class:`Device` do."""

    async def image(self) -> dict[str, Any]:
        """See :meth:`Device.image`."""
        __tracebackhide__ = True
        return await self._wait(self._witness.image())

    async def journal(self) -> list[E]:
        """See :meth:`Device.journal`."""
        __tracebackhide__ = True
        return await self._wait(self._witness.journal())

    async def wait_for(self, *, count: int = 1, timeout_s: float = 5.0, **match: Any) -> list[E]:
        """See :meth:`Device.wait_for`."""
        __tracebackhide__ = True
        return await self._wait(self._witness.wait_for(match, count, timeout_s))

    async def fault(self, *rules: Rule) -> None:
        """See :meth:`Device.fault`."""
        __tracebackhide__ = True
        await self._wait(self._witness.fault(*rules))

    async def tick(self, seconds: int = 1) -> None:
        """See :meth:`Device.tick`."""
        __tracebackhide__ = True
        await self._wait(self._witness.tick(seconds))

    async def reset(self) -> None:
        """See :meth:`Device.reset`."""
        __tracebackhide__ = True
        await self._wait(self._witness.reset())

    async def stop(self) -> None:
        """See :meth:`Device.stop`."""
        __tracebackhide__ = True
        await self._wait(self._witness.stop())

    async def start(self) -> None:
        """See :meth:`Device.start`."""
        __tracebackhide__ = True
        await self._wait(self._witness.start())


class Device(_Handle[E]):
    """A mock device during one test.

    Every method may raise :class:`~pytest_otmcp.errors.UsageError` for something that the device cannot do, and
    :class:`~pytest_otmcp.errors.KitError` for a fault of the kit.
    """

    def image(self) -> dict[str, Any]:
        """What the device really holds, whatever anybody has said about it."""
        __tracebackhide__ = True
        return self._do(self._witness.image())

    def journal(self) -> list[E]:
        """Everything that reached the device since the test began, and that it sent, in the order of its happening.

        Entries from before a :meth:`stop` stay; the numbers of those after it begin at 0 again.
        """
        __tracebackhide__ = True
        return self._do(self._witness.journal())

    def wait_for(self, *, count: int = 1, timeout_s: float = 5.0, **match: Any) -> list[E]:
        """Wait for journal entries of this test.

        Args:
            count: how many.
            timeout_s: seconds after which the waiting ends.
            match: fields of the entry and their values, such as ``kind="PUBLISH", topic="pump"``.

        Returns:
            The entries that match as soon as there are ``count``, or those there are when the time is over. An empty
            list says that nothing of the kind happened.
        """
        __tracebackhide__ = True
        return self._do(self._witness.wait_for(match, count, timeout_s))

    def fault(self, *rules: Rule) -> None:
        """Replace the fault plan: what the device does wrong from now on. No rules: nothing."""
        __tracebackhide__ = True
        self._do(self._witness.fault(*rules))

    def tick(self, seconds: int = 1) -> None:
        """Let plant time pass; it stands still otherwise."""
        __tracebackhide__ = True
        self._do(self._witness.tick(seconds))

    def reset(self) -> None:
        """Start-up values, no faults; the journal and connections stay. Every test begins like this."""
        __tracebackhide__ = True
        self._do(self._witness.reset())

    def stop(self) -> None:
        """Kill the device: its connections die, its port refuses. Does nothing when it is stopped."""
        __tracebackhide__ = True
        self._do(self._witness.stop())

    def start(self) -> None:
        """Start a fresh device on the same port; it accepts connections when this returns. Does nothing when it runs."""
        __tracebackhide__ = True
        self._do(self._witness.start())


class AsyncModbusDevice(AsyncDevice[ModbusEntry]):
    """The Modbus TCP device in asynchronous tests."""

    _scheme = "modbus+tcp"

    async def poke(self, table: str, address: int, values: Sequence[int | bool], *, unit: int = 1) -> None:
        """See :meth:`ModbusDevice.poke`."""
        __tracebackhide__ = True
        await self._wait(self._witness.poke(unit=unit, table=table, address=address, values=list(values)))


class ModbusDevice(Device[ModbusEntry]):
    """The Modbus TCP device: unit 1 with a hundred cells in each table."""

    _scheme = "modbus+tcp"

    def __init__(self, loop: LoopThread, witness: Witness[ModbusEntry]) -> None:
        super().__init__(loop, witness)
        self.aio = AsyncModbusDevice(loop, witness)

    def poke(self, table: str, address: int, values: Sequence[int | bool], *, unit: int = 1) -> None:
        """Set cells past the protocol; nothing of it is on the journal.

        Args:
            table: ``holding_registers``, ``input_registers``, ``coils`` or ``discrete_inputs``.
            address: of the first cell, from 0 as in the PDU.
            values: registers 0 to 65535, or booleans.
            unit: unit identifier.
        """
        __tracebackhide__ = True
        self._do(self._witness.poke(unit=unit, table=table, address=address, values=list(values)))


def _message(topic: str, payload: str | bytes, qos: int, retain: bool) -> dict[str, Any]:
    content = payload.encode() if isinstance(payload, str) else payload
    return {"topic": topic, "payload": base64.b64encode(content).decode(), "qos": qos, "retain": retain}


class AsyncBroker(AsyncDevice[MqttEntry]):
    """The MQTT broker in asynchronous tests."""

    _scheme = "mqtt"

    async def poke(self, topic: str, payload: str | bytes, *, qos: int = 0, retain: bool = False) -> None:
        """See :meth:`Broker.poke`."""
        __tracebackhide__ = True
        await self._wait(self._witness.poke(publish=_message(topic, payload, qos, retain)))


class Broker(Device[MqttEntry]):
    """The MQTT broker, 3.1.1 and 5, with a Sparkplug B edge node behind it."""

    _scheme = "mqtt"

    def __init__(self, loop: LoopThread, witness: Witness[MqttEntry]) -> None:
        super().__init__(loop, witness)
        self.aio = AsyncBroker(loop, witness)

    def poke(self, topic: str, payload: str | bytes, *, qos: int = 0, retain: bool = False) -> None:
        """Publish a message from nowhere; it is on the journal with connection 0, as ``simulated``."""
        __tracebackhide__ = True
        self._do(self._witness.poke(publish=_message(topic, payload, qos, retain)))


class AsyncOpcUaPlant(AsyncDevice[OpcUaEntry]):
    """The OPC UA plant in asynchronous tests."""

    _scheme = "opc.tcp"

    async def poke(self, node: str, value: Any, *, status: str = "Good") -> None:
        """See :meth:`OpcUaPlant.poke`."""
        __tracebackhide__ = True
        await self._wait(self._witness.poke(node=node, value=value, status=status))


class OpcUaPlant(Device[OpcUaEntry]):
    """The OPC UA server of a small plant."""

    _scheme = "opc.tcp"

    def __init__(self, loop: LoopThread, witness: Witness[OpcUaEntry]) -> None:
        super().__init__(loop, witness)
        self.aio = AsyncOpcUaPlant(loop, witness)

    def poke(self, node: str, value: Any, *, status: str = "Good") -> None:
        """Set a variable past the protocol; nothing of it is on the journal.

        Args:
            node: browse name or node id.
            value: of the variable's data type.
            status: symbol of the status code that it is read with.
        """
        __tracebackhide__ = True
        self._do(self._witness.poke(node=node, value=value, status=status))
