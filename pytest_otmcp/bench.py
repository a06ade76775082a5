"""The test bench: the plant's devices, one session per adapter variant, and where the time went.

A :class:`Station` is one adapter variant at its device. The bench starts what is asked for, replaces a session that
broke, and ends everything; it does not know tasks and does not judge.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from . import __version__
from .errors import KitError, SubjectError
from .mcp_session import McpSession, SessionOptions
from .observation import Reply, Wire, observe
from .plant import MockDevice
from .subject import Adapter, Subject
from .tap_broker import TappedBroker

__all__ = ["Bench", "BenchOptions", "NoBindingError", "Plant", "Station", "TimeSpent"]

Device = MockDevice | TappedBroker

READ_ONLY = "ro"
READ_WRITE = "rw"

_SCHEMES = {"modbus": "modbus+tcp", "mqtt": "mqtt", "opcua": "opc.tcp"}


class NoBindingError(Exception):
    """The subject claims the protocol but does not say which tool performs an operation: not testable."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchOptions:
    """Settings of a run that the bench needs.

    Attributes:
        era: MCP protocol era, ``auto`` or ``legacy``.
        time_scale: factor on every deadline and window, for slow machines.
        broker: URL of an external MQTT broker, or None for the embedded one.
    """

    era: str = "auto"
    time_scale: float = 1.0
    broker: str | None = None


class Station:
    """One adapter variant, its session, and the device it talks to."""

    def __init__(self, adapter: Adapter, variant: str, device: Device, options: BenchOptions) -> None:
        self.adapter = adapter
        self.variant = variant
        self.device = device
        self.session: McpSession | None = None
        self._options = options
        self._start_failure: SubjectError | None = None
        self.mark = 0
        self.session_mark = 0

    @property
    def deadline_s(self) -> float:
        """Seconds within which every call must have answered."""
        return self.adapter.deadline_s * self._options.time_scale

    def new_session(self) -> McpSession:
        """A session that has not been opened yet, with a process of its own."""
        device = self.device
        endpoint = {
            "host": device.host,
            "port": str(device.port),
            "url": f"{_SCHEMES[self.adapter.protocol]}://{device.host}:{device.port}",
            "python": sys.executable,
            "kit_version": __version__,
        }
        launch = self.adapter.variants[self.variant].for_endpoint(endpoint)
        options = SessionOptions(
            era=self._options.era,
            start_timeout_s=30.0 * self._options.time_scale,
            exit_grace_s=3.0 * self._options.time_scale,
        )
        return McpSession(launch.command, launch.env, launch.cwd, options)

    async def open(self) -> None:
        """Make sure that there is a usable session.

        Raises:
            SubjectError: the adapter cannot be started. Said again at once when it was found before: a start that
                runs into its deadline must not be waited for by every item.
        """
        if self._start_failure is not None:
            raise self._start_failure
        if self.session is not None and not self.session.died:
            return
        await self.close()
        # Everything that this session will ever do to its device is on the journal from here on.
        self.session_mark = await self.device.mark()
        session = self.new_session()
        try:
            await session.open()
        except SubjectError as failure:
            self._start_failure = failure
            raise
        self.session = session

    async def close(self) -> None:
        """Close the session, if there is one."""
        session, self.session = self.session, None
        if session is not None:
            await session.close()

    async def call(self, operation: str, *, role: str, session: McpSession | None = None, **inputs: Any) -> Reply:
        """Perform an abstract operation through the adapter's own tool.

        Args:
            operation: name of the operation.
            role: see :class:`~pytest_otmcp.observation.Reply`.
            session: a session other than the station's.
            inputs: the operation's inputs.

        Raises:
            NoBindingError: the subject does not say which tool performs it.
        """
        binding = self.adapter.bindings.get(operation)
        if binding is None:
            raise NoBindingError(f"{self.adapter.protocol}: the subject binds no tool to the operation {operation!r}")
        session = session or self.session
        if session is None:
            raise KitError(f"the {self.adapter.protocol} session was used before it was opened")
        arguments = binding.fill(inputs)
        # The client gives up a little later than the deadline, so that a late answer is seen to be late.
        exchange = await session.call(binding.tool, arguments, timeout_s=1.2 * self.deadline_s)
        wire = Wire(
            request=exchange.request,
            response=exchange.response,
            sent_ns=exchange.sent_ns,
            received_ns=exchange.received_ns,
            failure=exchange.failure,
            client_complaint=exchange.client_complaint,
        )
        reply = observe(
            wire,
            adapter=self.adapter.protocol,
            variant=self.variant,
            operation=operation,
            tool=binding.tool,
            arguments=arguments,
            role=role,
            deadline_s=self.deadline_s,
        )
        if reply.envelope is not None:
            reply.outputs = binding.read(reply.envelope)
        return reply


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

    def facts(self) -> dict[str, Any]:
        """What is known of the subject's servers, as ``run.json`` has it under ``subject.adapters``."""
        facts: dict[str, Any] = {}
        for (protocol, variant), station in self._stations.items():
            session = station.session
            if variant == READ_WRITE and session is not None:
                facts[protocol] = {
                    "command": list(station.adapter.variants[variant].command),
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
