"""The test bench: one adapter under test per variant at the devices of a plant, and the time spent on each activity.

The bench starts the adapters that are asked for and ends their sessions; it does not know tasks and does not judge.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable

from ..plant.devices import Plant
from ..record.schema import AdapterFacts, Device
from ..record.tool_calls import added
from ..session.limits import Allowance
from ..subject import Subject
from ..subject.binding_check import check_bindings
from ..subject.model import READ_WRITE
from .adapter_under_test import AdapterUnderTest, BenchOptions
from .time_spent import TimeSpent
from .under_way import UnderWay

__all__ = ["Bench"]


class Bench:
    """Everything that runs during a test run. Use :meth:`prepare` and :meth:`close` on the kit's loop.

    Args:
        subject: the subject that is tested.
        options: see :class:`BenchOptions`.
        plant: the devices; they outlive the bench.

    Attributes:
        allowance: the room for what all its adapters answer in one repetition.
        under_way: what the item that is being measured is waiting for.
    """

    def __init__(self, subject: Subject, options: BenchOptions, plant: Plant) -> None:
        self.subject = subject
        self.options = options
        self.spent = TimeSpent()
        self.allowance = Allowance()
        self.under_way = UnderWay()
        self._plant = plant
        self._adapters: dict[str, AdapterUnderTest] = {}

    async def prepare(self, names: Iterable[str], started: Callable[[int, int, int], None] | None = None) -> None:
        """Start devices and adapters, all at once.

        An adapter that cannot be started is not an error here: its first task will report it.

        Args:
            names: ``protocol`` for its read-write variant, or ``protocol@ro``.
            started: called after each device and each adapter with the number of those that were started, the number of
                devices, and the number of adapters.

        Raises:
            KitError: a mock could not be started.
        """
        wanted = list(dict.fromkeys(names))
        done = 0

        def tell() -> None:
            nonlocal done
            done += 1
            if started is not None:
                started(done, len(wanted), len(wanted))

        async def device(name: str) -> None:
            await self._plant.device(name)
            tell()

        async def adapter(name: str) -> None:
            await self._open(name)
            tell()

        opening = [asyncio.create_task(adapter(name)) for name in wanted]
        try:
            with self.spent.on("plant start"):
                await asyncio.gather(*map(device, wanted))
            with self.spent.on("adapter starts"):
                await asyncio.gather(*opening, return_exceptions=True)
        except BaseException:
            for task in opening:
                task.cancel()
            await asyncio.gather(*opening, return_exceptions=True)
            raise

    async def _open(self, name: str) -> None:
        under_test = await self.adapter(name)
        await under_test.open()

    async def adapter(self, name: str) -> AdapterUnderTest:
        """Return the adapter under test of this name, ``protocol`` or ``protocol@ro``; its session is not opened.

        The read-only variant gets a device of its own: then only that variant can have caused what reaches the device
        during the whole life of a session.
        """
        device = await self._plant.device(name)
        if name not in self._adapters:
            protocol, _, variant = name.partition("@")
            adapter = self.subject.adapters[protocol]
            first = await device.first()
            self._adapters.setdefault(
                name,
                AdapterUnderTest(
                    adapter, variant or READ_WRITE, device, self.options, first=first, allowance=self.allowance
                ),
            )
        return self._adapters[name]

    def drift(self) -> list[str]:
        """Return the contradictions between the subject file and the tools that the adapters list, a sentence each."""
        found = []
        for under_test in self._adapters.values():
            # The read-only variant need not have every tool.
            if under_test.variant == READ_WRITE and under_test.tools is not None:
                found += check_bindings(under_test.adapter, under_test.tools)
        return found

    def adapters(self) -> dict[str, AdapterFacts]:
        """Return what is known of the adapters, as ``run.json`` has it under ``subject.adapters``."""
        facts: dict[str, AdapterFacts] = {}
        for under_test in self._adapters.values():
            key = under_test.adapter.protocol
            own = under_test.facts()
            calls = added([own, *([facts[key]] if key in facts else [])])
            if under_test.variant == READ_WRITE or key not in facts:
                # The server's facts are the read-write variant's; both variants use the same bindings of the subject.
                own["bindings"] |= facts[key]["bindings"] if key in facts else {}
                own["listing"] = {**(facts[key]["listing"] if key in facts else {}), **own["listing"]}
                own["unmet"] = sorted({*own["unmet"], *(facts[key]["unmet"] if key in facts else ())})
                facts[key] = own
            else:
                facts[key]["bindings"] |= own["bindings"]
                facts[key]["listing"] = {**own["listing"], **facts[key]["listing"]}
            if calls:
                facts[key]["calls"] = calls
        return dict(sorted(facts.items()))

    def told_secrets(self) -> set[str]:
        """Return the random secrets that adapters have told; they must not get into what the run keeps."""
        return set[str]().union(*(under_test.told_secrets for under_test in self._adapters.values()))

    def devices(self) -> dict[str, Device]:
        """Return the devices that adapters had so far, as ``run.json`` has them."""
        return {under_test.device_name: under_test.device_facts() for under_test in self._adapters.values()}

    async def close(self) -> None:
        """End every session: first those that anybody on this machine can tell to write, as long as they live."""
        every = list(self._adapters.values())
        first = [one for one in every if one.adapter.url_of(one.variant) is not None and one.variant == READ_WRITE]
        with self.spent.on("adapter starts"):
            for wave in (first, [one for one in every if one not in first]):
                await asyncio.gather(*(under_test.close() for under_test in wave), return_exceptions=True)
        self._adapters.clear()
