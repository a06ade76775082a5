"""A bench as the stage of a trial: live adapters at live devices, and what has to be kept of them for judging again."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from typing import Any

from .applicability import applicability
from .at_device import AtDevice, EndedError, Entry, FreshSession
from .bench import READ_ONLY, READ_WRITE, Bench, Station
from .findings import Finding
from .history import Images
from .mcp_session import McpSession
from .observation import Reply
from .repetition import Repetition
from .stage import SessionFacts
from .subject.model import Function
from .task import Steps, Task
from .verdict import Status

__all__ = ["BenchStage"]


class BenchStage:
    """The stations of a bench that a task needs.

    Args:
        bench: has been prepared.
        task: what is to be run.
        seed: of the run.
    """

    def __init__(self, bench: Bench, task: Task, *, seed: int) -> None:
        self._bench = bench
        self._task = task
        self._seed = seed
        self._before = dict(bench.spent.seconds)
        self._places: list[_Place] = []
        self._images = Images()
        self._sessions: list[dict[str, Any]] = []
        self._inspections = 0

    def obstacle(self) -> tuple[Status, str] | None:
        """What the subject does not claim, or cannot be asked for."""
        return applicability(self._task, self._bench.subject.adapters)

    def spent(self, what: str) -> AbstractContextManager[None]:
        """Count the time inside the block as spent on ``what``."""
        return self._bench.spent.on(what)

    async def prepare(self) -> None:
        """Reset the devices and open the sessions."""
        with self.spent("plant start"):
            for name in self._task.adapters:
                protocol, _, variant = name.partition("@")
                self._places.append(_Place(await self._bench.station(protocol, variant or READ_WRITE)))
        for place in self._places:
            device = place.station.device
            await device.reset()
            place.station.mark = place.begin = await device.mark()
            place.accepting_ns = device.accepting_ns
        await self.open_sessions()

    def repetition(self, rep: int, role: str) -> Repetition:
        """A repetition on this bench."""
        return Repetition(
            self._task.id,
            rep,
            role,
            seed=self._seed,
            time_scale=self._bench.options.time_scale,
            places=[AtStation(place, self._bench, self._images) for place in self._places],
        )

    async def perform(self, repetition: Repetition, steps: Steps) -> None:
        """Execute the steps and take the journals."""
        try:
            await steps(repetition)
        except EndedError:
            for at in repetition.all:
                if not at.running:
                    await at.start_device()
        finally:
            self._bench.spent.move("kit", "tool calls", repetition.calls_s())
        with self.spent("observing the device"):
            await repetition.close_journals()
        for at in repetition.all:
            if isinstance(at, AtStation):
                at.add_last_words()

    async def inspect(self) -> list[SessionFacts]:
        """Ask the sessions for stray output."""
        return await self._inspect(ending=False)

    async def end_sessions(self) -> list[SessionFacts]:
        """A call that hangs may spread to the next ones: everybody starts afresh, and says how it ended."""
        found = await self._inspect(ending=True)
        with self.spent("adapter starts"):
            for place in self._places:
                await place.station.close()
        return found

    async def _inspect(self, *, ending: bool) -> list[SessionFacts]:
        self._inspections += 1
        found = []
        for place in self._places:
            session = place.station.session
            if session is None:
                continue
            lines, first = session.stray_output()
            facts = SessionFacts(
                protocol=place.station.adapter.protocol, stray_lines=lines, first_stray=first[0] if lines else ""
            )
            if ending:
                died = session.died and not session.overflow
                facts = replace(
                    facts,
                    overflow=session.overflow,
                    died=await session.death_note() if died else None,
                    unknown_ids=tuple(session.unknown_responses()),
                )
            if facts.remarkable:
                found.append(facts)
                self._sessions.append({"inspection": self._inspections, **facts.as_record()})
        return found

    async def open_sessions(self) -> None:
        """Open those that are not, or broke."""
        with self.spent("adapter starts"):
            for place in self._places:
                await place.station.open()

    async def close(self) -> None:
        """End the read-only session: its device belongs to this item alone."""
        with self.spent("adapter starts"):
            for place in self._places:
                if place.station.variant == READ_ONLY:
                    await place.station.close()

    def timing_ms(self) -> Mapping[str, float]:
        """Milliseconds by what they were spent on."""
        return {
            what: round((seconds - self._before.get(what, 0.0)) * 1000, 3)
            for what, seconds in self._bench.spent.seconds.items()
            if seconds - self._before.get(what, 0.0) > 0
        }

    def history(self) -> dict[str, Any]:
        """Stations, images and sessions."""
        return {
            "stations": [place.as_record() for place in self._places],
            "images": self._images.kept,
            "sessions": self._sessions,
        }


class _Place:
    """A station during one item.

    Attributes:
        begin: sequence number in the device's journal at which the item began.
        accepting_ns: since when the device accepted connections then.
        earlier: entries before ``begin`` that were looked at nevertheless.
        used: operations that were performed.
    """

    def __init__(self, station: Station) -> None:
        self.station = station
        self.begin = 0
        self.accepting_ns = 0
        self.earlier: list[Entry] = []
        self.used: dict[str, None] = {}
        self.restarted = False

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
            "earlier": self.earlier,
            "bindings": {
                name: None if cases is None or isinstance(cases, Function) else [asdict(case) for case in cases]
                for name, cases in bound.items()
            },
        }


class AtStation(AtDevice):
    """A station of the bench. Every look at the device is noted with the repetition."""

    def __init__(self, place: _Place, bench: Bench, images: Images) -> None:
        super().__init__(place.station.adapter.protocol, place.station.variant)
        self.station = place.station
        self.device = place.station.device
        self._place = place
        self._bench = bench
        self._images = images
        self._since = place.station.mark
        self._bugs: list[tuple[Finding, McpSession]] = []

    @property
    def running(self) -> bool:
        return self.device.running

    @property
    def accepting_ns(self) -> int:
        return self.device.accepting_ns

    def _observing(self) -> AbstractContextManager[None]:
        return self._bench.spent.on("observing the device")

    def _noted(self, what: str, seen: Any) -> None:
        self._repetition.observed(self, what, seen)

    async def _perform(self, operation: str, role: str, inputs: Mapping[str, Any]) -> Reply:
        self._place.used[operation] = None
        reply = await self.station.call(operation, role=role, **inputs)
        if self.station.session is not None:
            bugs = [fault for fault in reply.faults if fault.code == "internal_error"]
            self._bugs += [(bug, self.station.session) for bug in bugs]
        return reply

    def add_last_words(self) -> None:
        """Give the adapter's last lines on stderr as the evidence of bugs that it reported of itself."""
        findings = self._repetition.findings
        for bug, session in self._bugs:
            if lines := session.stderr_tail():
                evidence = "the adapter's last lines on stderr:\n    " + "\n    ".join(lines)
                findings[findings.index(bug)] = replace(bug, evidence=evidence)

    async def journal(self) -> list[Entry]:
        with self._observing():
            journal = await self.device.journal(self._since)
        self._noted("journal", journal.next)
        return journal.entries

    async def wait_for(self, *, timeout_s: float, count: int = 1, **match: Any) -> list[Entry]:
        with self._observing():
            scaled = timeout_s * self._repetition.time_scale
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
        with self._bench.spent.on("adapter starts"):
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
