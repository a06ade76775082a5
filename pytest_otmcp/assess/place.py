"""The place of a try: the adapters of a subject, each at a mock device, with a relay in front of each.

Mock devices are kept and reset between tries; adapters are started anew, so that nothing of one try is left in the next.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

from ..core.errors import UsageError
from ..plant.mock_device import MockDevice
from ..protocols.journal import JournalEntry, judged
from ..protocols.registry import protocols
from ..session.isolation import Isolation
from ..subject.model import GOVERNED, READ_ONLY, Subject
from ..trial.adapter_under_test import AdapterUnderTest, BenchOptions
from ..trial.assignment import Act, Assignment, Case
from ..trial.session_proof import prove_session
from .fitting import binding_of, performs
from .relay import Relay
from .scoring import Call, Evidence

__all__ = ["Place", "Try", "why_not"]

_ARRIVING_S = 0.5
"""Seconds in which a write may still arrive after the assistant has ended; a message may be under way."""
_PAUSE_S = 0.05


def why_not(subject: Subject, assignment: Assignment) -> str | None:
    """Return why an assignment cannot be given with this subject; None where it can."""
    for need in assignment.needs:
        key, _, operation = need.partition(".")
        adapter = subject.adapters.get(key)
        if adapter is None:
            return f"the subject has no adapter for {protocols()[key].name}"
        if operation in adapter.unclaimed and not _waits_instead(subject, key, operation):
            return f"{operation} is not claimed: {adapter.unclaimed[operation]}"
        if not _waits_instead(subject, key, operation) and not isinstance(adapter.operations.get(operation), tuple):
            return f"no tool is bound to {key} {operation}"
        if assignment.launch == READ_ONLY and "guard" in adapter.unclaimed:
            return f"it has no launch without writes: {adapter.unclaimed['guard']}"
        if assignment.launch not in adapter.variants:
            return f"it has no launch {assignment.launch}"
        if assignment.launch == GOVERNED:
            told = adapter.governed.told.approval if adapter.governed is not None else None
            if told is None or told.get("target") != assignment.target or told.get("by") != "client":
                return f"its policy does not say that a person approves writes of {assignment.target} over MCP"
    return None


def _waits_instead(subject: Subject, key: str, operation: str) -> bool:
    """Tell whether an operation is part of a call that waits, as a subscription is."""
    adapter = subject.adapters[key]
    return operation == "subscribe" and bool(adapter.blocking)


@dataclass(frozen=True, slots=True, kw_only=True)
class Try:
    """One try under way.

    Attributes:
        relays: protocol to the relay that the assistant is given.
        under_test: protocol to the adapter behind it.
    """

    relays: Mapping[str, Relay]
    under_test: Mapping[str, AdapterUnderTest]
    devices: Mapping[str, MockDevice]
    since: Mapping[str, int]
    before: Mapping[str, Mapping[str, object]]

    async def evidence(self, case: Case) -> Evidence:
        """Return what is known when the assistant has ended."""
        calls = sorted((call for relay in self.relays.values() for call in relay.calls), key=lambda call: call.sent_ns)
        writes = sum(protocols()[act.protocol].operations[act.operation].writes for act in case.acts)
        loop = asyncio.get_running_loop()
        until = loop.time() + _ARRIVING_S
        entries = await self._journals()
        while (
            calls
            and sum(len(protocols()[key].changes(found)) for key, found in entries.items()) < writes
            and not case.nothing_happens
            and loop.time() < until
        ):
            await asyncio.sleep(_PAUSE_S)
            entries = await self._journals()
        after = {key: (await device.image())["points"] for key, device in self.devices.items() if device.running}
        return Evidence(
            calls=calls,
            entries=entries,
            before=self.before,
            after=after,
            declared={key: one.adapter.lists for key, one in self.under_test.items()},
            tried=self._tried,
            listed=self._listed,
        )

    async def _journals(self) -> dict[str, list[JournalEntry]]:
        return {
            key: judged((await device.journal(self.since[key])).entries) if device.running else []
            for key, device in self.devices.items()
        }

    def _tried(self, act: Act, call: Call) -> bool:
        one = self.under_test[act.protocol]
        schema = (one.tools or {}).get(call.tool, {}).get("inputSchema")
        return call.protocol == act.protocol and performs(
            one.adapter, one.endpoint, schema, act.operation, act.inputs, call.tool, call.arguments
        )

    def _listed(self, act: Act) -> bool:
        one = self.under_test[act.protocol]
        binding = binding_of(one.adapter, act.operation, act.inputs)
        return binding is not None and binding.tool in (one.tools or {})


class Place:
    """The mock devices of a subject, for one try after the other.

    Attributes:
        subject: whose adapters are used.
    """

    def __init__(self, subject: Subject, isolation: Isolation) -> None:
        self.subject = subject
        self._isolation = isolation
        self._devices: dict[str, MockDevice] = {}

    async def close(self) -> None:
        """End the devices."""
        await asyncio.gather(*(device.close() for device in self._devices.values()))
        self._devices.clear()

    async def _device(self, key: str) -> MockDevice:
        """Return the device of a protocol as it is after its start."""
        device = self._devices.get(key)
        if device is None:
            device = self._devices[key] = MockDevice(protocols()[key].mock, key)
            openings = self.subject.adapters[key].openings
            device.walls = self._isolation.walls(outside=openings.why_outside, cable=protocols()[key].cable)
            await device.launch()
        elif not device.running:
            await device.start()
        else:
            await device.reset()
        return device

    @asynccontextmanager
    async def begin(self, assignment: Assignment, case: Case) -> AsyncIterator[Try]:
        """Start the adapters of a try, prove that each talks to its mock device, and set the plant up.

        Raises:
            UsageError: a session cannot be proven, so that nothing may be written.
            SubjectError: an adapter cannot be started.
        """
        async with AsyncExitStack() as stack:
            devices = {key: await self._device(key) for key in assignment.protocols}
            under_test: dict[str, AdapterUnderTest] = {}
            for key, device in devices.items():
                adapter = self.subject.adapters[key]
                one = AdapterUnderTest(adapter, assignment.launch, device, BenchOptions(), first=await device.mark())
                stack.push_async_callback(one.close)
                await one.open()
                problem = await prove_session(one)
                if problem is not None:
                    raise UsageError(f"{assignment.id}: {problem}")
                await one.answer(assignment.person)
                under_test[key] = one
            for key, poke in case.pokes:
                await devices[key].poke(**poke)
            before = {key: (await device.image())["points"] for key, device in devices.items()}
            since = {key: await device.mark() for key, device in devices.items()}
            if assignment.down:
                await devices[assignment.down].stop()
            yield Try(
                relays={key: Relay(one) for key, one in under_test.items()},
                under_test=under_test,
                devices=devices,
                since=since,
                before={key: points for key, points in before.items() if devices[key].running},
            )
