"""A live adapter at its device in a repetition. Every look at the device is noted, so that it can be repeated."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict
from typing import Any

from ..core.finding import Finding
from ..record.images import Images
from ..session.session import McpSession
from ..subject.model import Function
from .adapter_under_test import AdapterUnderTest
from .bench import Bench
from .reply import Reply
from .rig import Entry, FreshSession, Rig

__all__ = ["LiveItemState", "LiveRig"]


class LiveItemState:
    """A station during one item.

    Attributes:
        begin: sequence number in the device's journal at which the item began.
        before: the entries before that, from the end of the last item that had this adapter at its device.
        accepting_ns: since when the device accepted connections then.
        earlier: entries before ``begin`` that were looked at nevertheless.
        used: operations that were performed.
    """

    def __init__(self, station: AdapterUnderTest) -> None:
        self.station = station
        self.begin = 0
        self.accepting_ns = 0
        self.before: list[Entry] = []
        self.earlier: list[Entry] = []
        self.used: dict[str, None] = {}
        self.restarted = False

    async def enter(self) -> None:
        """The item begins."""
        station = self.station
        if station.session is not None and station.looked_through:
            journal = await station.device.journal(station.mark)
            self.before, self.begin = journal.entries, journal.next
        else:
            self.begin = await station.device.mark()
        station.mark = self.begin

    def as_record(self) -> dict[str, Any]:
        """What judging again needs to know of it."""
        adapter = self.station.adapter
        bound = {name: adapter.operations.get(name) for name in self.used}
        return {
            "protocol": adapter.protocol,
            "variant": self.station.variant,
            "deadline_s": self.station.deadline_s,
            "endpoint": self.station.endpoint,
            "accepting_ns": self.accepting_ns,
            "begin": self.begin,
            "before": self.before,
            "earlier": self.earlier,
            "recovery": adapter.recovery,
            "unclaimed": sorted(adapter.unclaimed),
            "probes": dict(adapter.probes),
            "lacks": sorted(adapter.missing_inputs()),
            "blocking": list(adapter.blocking),
            "bindings": {
                name: None if cases is None or isinstance(cases, Function) else [asdict(case) for case in cases]
                for name, cases in bound.items()
            },
        }


class LiveRig(Rig):
    """A station of the bench. Every look at the device is noted with the repetition."""

    def __init__(self, place: LiveItemState, bench: Bench, images: Images) -> None:
        super().__init__(place.station.adapter.protocol, place.station.variant)
        self.station = place.station
        self.device = place.station.device
        self._place = place
        self._bench = bench
        self._images = images
        self._since = place.station.mark
        self._bugs: list[tuple[Finding, McpSession]] = []

    def claims(self, facet: str) -> bool:
        return self.station.adapter.why_not_claimed(facet) is None

    def blocks(self, operation: str) -> bool:
        return operation in self.station.adapter.blocking

    def probe(self, name: str) -> Any:
        return self.station.adapter.probes[name]

    def accepts_input(self, operation: str, name: str) -> bool:
        return f"{operation}.{name}" not in self.station.adapter.missing_inputs()

    @property
    def running(self) -> bool:
        return self.device.running

    @property
    def accepting_ns(self) -> int:
        return self.device.accepting_ns

    def _observing(self) -> AbstractContextManager[None]:
        return self._bench.spent.on("observing the device")

    def _noted(self, what: str, seen: Any) -> None:
        self._ledger.observed(self.name, what, seen)

    async def _perform(self, operation: str, inputs: Mapping[str, Any]) -> Reply:
        self._place.used[operation] = None
        reply = await self.station.call(operation, **inputs)
        if self.station.session is not None:
            bugs = [fault for fault in reply.faults if fault.code == "internal_error"]
            self._bugs += [(bug, self.station.session) for bug in bugs]
        return reply

    def add_last_words(self) -> None:
        """Give the adapter's last lines on stderr as the evidence of bugs that it reported of itself."""
        evidence: dict[int, str] = {}
        for bug, session in self._bugs:
            if lines := session.stderr_tail():
                evidence[id(bug)] = "the adapter's last lines on stderr:\n    " + "\n    ".join(lines)
        self._ledger.explain(evidence)

    async def journal(self) -> list[Entry]:
        with self._observing():
            journal = await self.device.journal(self._since)
        self._noted("journal", journal.next)
        return journal.entries

    async def wait_for(self, *, timeout_s: float, count: int = 1, **match: Any) -> list[Entry]:
        with self._observing():
            scaled = timeout_s * self._ledger.time_scale
            entries = await self.device.wait(self._since, match, timeout_s=scaled, count=count)
        self._noted("wait", len(entries))
        return entries

    async def session_journal(self) -> list[Entry]:
        since = self.station.session_mark
        with self._observing():
            journal = await self.device.journal(since)
        place = self._place
        if not place.restarted and not place.earlier:
            place.earlier = [entry for entry in journal.entries if entry["seq"] < place.begin]
        self._noted("session_journal", [since, journal.next])
        return journal.entries

    async def image(self) -> dict[str, Any]:
        with self._observing():
            image = await self.device.image()
        self._noted("image", self._images.keep(self.name, image))
        return image

    async def poke(self, **params: Any) -> None:
        with self._observing():
            await self.device.poke(**params)

    async def tick(self, steps: int) -> None:
        with self._observing():
            await self.device.tick(steps)

    async def _watch(self, seconds: float) -> None:
        with self._bench.spent.on("quiet windows"):
            await asyncio.sleep(seconds)

    async def _reconnecting(self) -> None:
        # An adapter may reconnect in its own time: a new connection is the sign to ask again, at the latest
        # after a pause that keeps an adapter which fails at once from being hammered.
        seen = len(await self.device.wait(0, {"kind": "CONNECTED"}, timeout_s=0.0))
        await self.device.wait(0, {"kind": "CONNECTED"}, timeout_s=0.05, count=seen + 1)
        if self.station.adapter.recovery == "connect_step":
            # It may fail as long as the device is not ready; then the call after it fails as well, and says so.
            with self._bench.spent.on("tool calls"):
                await self.station.connect()

    async def _stop(self) -> float:
        begun = time.monotonic()
        with self._bench.spent.on("endpoint restarts"):
            await self.device.stop()
        took_ms = (time.monotonic() - begun) * 1000
        self._noted("stop", took_ms)
        return took_ms

    async def start_device(self) -> float:
        begun = time.monotonic_ns()
        with self._bench.spent.on("endpoint restarts"):
            await self.device.start()
        self._since = self.station.mark = self.station.session_mark = 0
        self._place.restarted = True
        took_ms = (self.device.accepting_ns - begun) / 1e6
        self._noted("start", {"ms": took_ms, "accepting_ns": self.device.accepting_ns})
        return took_ms

    async def _replace_session(self) -> FreshSession:
        # Like the restarts of endpoints this is what is measured, not what measuring costs.
        with self._bench.spent.on("fresh sessions"):
            session = self.station.session
            report = await session.close() if session is not None else None
            await self.station.open()
        assert self.station.session is not None
        fresh = FreshSession(
            spawned_ns=self.station.session.spawned_ns,
            ended=None if report is None else report.how,
            seconds=0.0 if report is None else report.seconds,
        )
        self._noted("fresh_session", asdict(fresh))
        return fresh

    async def close_session(self) -> None:
        with self._bench.spent.on("adapter starts"):
            await self.station.close()

    async def take_slice(self) -> list[Entry]:
        journal = await self.device.journal(self._since)
        self.station.mark = self._since = journal.next
        self._noted("end", journal.next)
        return journal.entries
