"""The rig of a running adapter at its device. Every look at the device is noted, so that it can be repeated."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from typing import Any, cast

from ..core.errors import KitError, NoHandleError
from ..core.finding import Finding
from ..plant.device import Journal
from ..plant.endpoint import check_free
from ..protocols.bounds import Bounds, Times
from ..protocols.journal import ADAPTER
from ..protocols.protocol import Declared
from ..record.images import Images, keep_image
from ..record.schema import Footprint, HandshakeEra, ItemDevice, Observation, SessionStart, ToolListing
from ..session.footprint import footprint
from ..session.session import McpSession
from ..subject.addressing import addressed_by
from ..subject.claims import Claims
from ..subject.model import Binding, Function
from .adapter_under_test import AdapterUnderTest
from .alteration import Alteration
from .bench import Bench
from .ledger import Ledger
from .reply import Reply
from .rig import EndedError, Entry, FreshSession, Rig

__all__ = ["LiveItemState", "LiveRig"]


_RELEASED_AT_ONCE = 1000
"""Entries of a journal that are released at once, at least: letting the device forget takes a request of its own, for which
most repetitions shall not have to wait."""


class LiveItemState:
    """An adapter under test and its device during one item.

    Attributes:
        told_session: the start of the adapter's session as the record of the item has it so far.
    """

    def __init__(self, under_test: AdapterUnderTest) -> None:
        self.under_test = under_test
        self.claims = Claims.of_subject({under_test.adapter.protocol: under_test.adapter})
        self.images: Images = {}
        self.told_session: SessionStart | None = None
        self._found: ItemDevice | None = None

    async def enter(self) -> None:
        """Begin the item at this device: take what reached it since the last item that had it."""
        device, cursor = self.under_test.device, self.under_test.cursor
        asked_ns = time.monotonic_ns()
        journal = await device.journal(cursor.next)
        seen_ns = time.monotonic_ns()
        self._found = {
            "device": self.under_test.device_name,
            "begin": journal.next,
            "asked_ns": asked_ns,
            "seen_ns": seen_ns,
            "accepting_ns": device.accepting_ns,
            "starts": cursor.starts,
            "before": journal.entries,
            "quiet": cursor.quiet,
            "session": cursor.session,
        }
        if (proof := cursor.proof) is not None:
            self._found["proof"] = proof
        self.told_session = cursor.session
        cursor.take(journal.entries, journal.next)
        if not self._found["quiet"]:
            cursor.forget_faults()
        await self.release()

    async def release(self) -> None:
        """Let the device forget what has been taken, once there is enough of it: the record has it already."""
        cursor = self.under_test.cursor
        if cursor.next - cursor.released >= _RELEASED_AT_ONCE:
            await self.under_test.device.forget(cursor.next)
            cursor.released = cursor.next

    @property
    def entered(self) -> bool:
        """The item has begun at this device."""
        return self._found is not None

    @property
    def found(self) -> ItemDevice:
        """The device as the item found it."""
        assert self._found is not None, "the item has not been entered"
        return self._found


class LiveRig(Rig):
    """A running adapter under test at its device. Every look at the device is noted with the repetition."""

    def __init__(self, state: LiveItemState, bench: Bench) -> None:
        under_test = state.under_test
        super().__init__(under_test.adapter.protocol, under_test.variant, under_test.cursor)
        self.under_test = under_test
        self.device = under_test.device
        self._state = state
        self._bench = bench
        self._bugs: list[tuple[Finding, McpSession]] = []

    def join(self, ledger: Ledger) -> None:
        super().join(ledger)
        session = self._cursor.session
        if session is not None and session != self._state.told_session:
            self._state.told_session = session
            self._noted({"session": list(session)}, time.monotonic_ns())

    def claims(self, facet: str) -> bool:
        return self._state.claims.has(f"{self.protocol}.{facet}")

    def blocks(self, operation: str) -> bool:
        return operation in self.under_test.adapter.blocking

    def max_age_s(self, operation: str) -> float | None:
        return self.under_test.adapter.cached.get(operation)

    @property
    def native(self) -> bool:
        return self.under_test.adapter.answering.native

    @property
    def recovery_s(self) -> float:
        return self.under_test.adapter.recovery_s

    @property
    def declared(self) -> Declared:
        return self.under_test.adapter.lists

    @property
    def bounds(self) -> Bounds:
        return self.under_test.adapter.bounds or Bounds()

    @property
    def times(self) -> Times | None:
        return self.under_test.adapter.times

    def probe(self, name: str) -> Any:
        return self.under_test.adapter.probes[name]

    @property
    def reconnects(self) -> bool:
        adapter = self.under_test.adapter
        return adapter.recovery != "connect_step" and not (adapter.connect is not None and adapter.connect.keep)

    @property
    def lacks(self) -> Collection[str]:
        return self.under_test.adapter.missing_inputs()

    def judges(self, output: str) -> bool:
        return output not in self.under_test.adapter.unjudged()

    @property
    def addresses(self) -> list[tuple[str, int]]:
        return [(endpoint.host, endpoint.port) for endpoint in self.device.endpoints.values() if endpoint.port]

    def listing(self, operation: str, tool: str) -> Mapping[str, object] | None:
        bound = self.under_test.adapter.operations.get(operation)
        # What a function of the user's passes to its tools is its own affair.
        return None if isinstance(bound, Function) else self.under_test.consulted(operation, tool)

    @property
    def _placeholders(self) -> Mapping[str, str]:
        return self.under_test.endpoint

    @property
    def device_url(self) -> str:
        return self.under_test.endpoint.get("url", "")

    @property
    def addressed_by(self) -> Sequence[str]:
        return addressed_by(self.under_test.adapter)

    def bindings(self, operation: str) -> Sequence[Binding] | None:
        found = self.under_test.bindings(operation)
        if any(case.command is not None for case in found or ()):
            # What commands can express is judged from the record as well.
            self.under_test.used[operation] = None
        return found

    def _is_bound(self, operation: str, inputs: Mapping[str, object], *, first: bool = False) -> bool:
        return self.under_test.is_bound(operation, inputs, first=first)

    @property
    def running(self) -> bool:
        return self.device.running

    @property
    def accepting_ns(self) -> int:
        return self.device.accepting_ns

    def _observing(self) -> AbstractContextManager[None]:
        return self._bench.spent.on("observing the device")

    def _noted(self, seen: Mapping[str, object], asked_ns: int) -> None:
        observation = {"at": self.name, "asked_ns": asked_ns, "seen_ns": time.monotonic_ns(), **seen}
        self._ledger.observed(cast(Observation, observation))

    async def _perform(self, operation: str, inputs: Mapping[str, object], altered: Alteration | None = None) -> Reply:
        try:
            with self._bench.under_way.call(operation):
                return self._observed(await self.under_test.call(operation, inputs, altered=altered))
        except NoHandleError:
            # The call that should have yielded the handle has failed, and that is what the item says.
            if self._ledger.failed:
                raise EndedError from None
            raise

    async def _check_away(self) -> None:
        await check_free(self.device.endpoints.values())

    async def _perform_and_cancel(
        self,
        operation: str,
        inputs: Mapping[str, object],
        seen: Mapping[str, object],
        timeout_s: float,
        meanwhile: Callable[[], Awaitable[object]] | None,
    ) -> Reply:
        cancel = asyncio.Event()
        # One more entry that matches than there are.
        before = len(await self.device.wait(self._cursor.next, seen, timeout_s=0.0))
        call = asyncio.create_task(self.under_test.call(operation, inputs, cancel=cancel))
        try:
            scaled = timeout_s * self._ledger.time_scale
            await self.device.wait(self._cursor.next, seen, timeout_s=scaled, count=before + 1)
            if meanwhile is not None:
                await meanwhile()
        finally:
            cancel.set()
            with self._bench.under_way.call(operation):
                await asyncio.wait({call})
        return self._observed(call.result())

    def _observed(self, reply: Reply) -> Reply:
        if self.under_test.session is not None:
            bugs = [fault for fault in reply.faults if fault.code == "internal_error"]
            self._bugs += [(bug, self.under_test.session) for bug in bugs]
        return reply

    def add_last_words(self) -> None:
        """Add the adapter's last lines on stderr as evidence to the internal errors that it reported."""
        evidence: dict[int, str] = {}
        for bug, session in self._bugs:
            if lines := session.stderr_tail():
                evidence[id(bug)] = "the adapter's last lines on stderr:\n    " + "\n    ".join(lines)
        self._ledger.explain(evidence)

    async def _look(self, since: int) -> tuple[Journal, int]:
        """Return the journal from ``since`` on, and when it was asked for."""
        asked_ns = time.monotonic_ns()
        with self._observing():
            return await self.device.journal(since), asked_ns

    async def _journal(self) -> list[Entry]:
        journal, asked_ns = await self._look(self._cursor.next)
        self._noted({"journal": journal.next}, asked_ns)
        return journal.entries

    async def _wait(self, match: Mapping[str, object], *, timeout_s: float, count: int) -> list[Entry]:
        asked_ns = time.monotonic_ns()
        with self._observing():
            scaled = timeout_s * self._ledger.time_scale
            entries = await self.device.wait(self._cursor.next, match, timeout_s=scaled, count=count)
        self._noted({"wait": len(entries)}, asked_ns)
        return entries

    async def _session_journal(self) -> list[Entry]:
        begin = self._cursor.began
        journal, asked_ns = await self._look(begin)
        self._noted({"session_journal": [begin, journal.next]}, asked_ns)
        return journal.entries

    async def _feed(self) -> None:
        journal, asked_ns = await self._look(self._cursor.fed)
        self._cursor.feed(journal.entries, journal.next)
        self._noted({"followed": journal.next}, asked_ns)

    async def image(self) -> dict[str, object]:
        asked_ns = time.monotonic_ns()
        with self._observing():
            image = await self.device.image()
        kind, kept = keep_image(self._state.images, self.name, image)
        self._noted({kind: kept}, asked_ns)
        return image

    async def poke(self, **params: object) -> None:
        with self._observing():
            await self.device.poke(**params)

    async def fault(self, *rules: Mapping[str, object]) -> None:
        with self._observing():
            await self.device.fault(*rules)

    async def delay(self, seconds: float) -> None:
        with self._observing():
            await self.device.delay(seconds)

    async def tick(self, steps: int) -> None:
        with self._observing():
            await self.device.tick(steps)

    async def pause(self, seconds: float) -> None:
        with self._bench.spent.on("quiet windows"), self._bench.under_way.wait("what must not come"):
            await asyncio.sleep(seconds)

    async def _reconnecting(self) -> None:
        # An adapter may reconnect in its own time: a new connection is the sign to call it again. Without one it is called
        # after a pause, so that an adapter which fails at once is not called without pause.
        since = self._cursor.next
        connected = {"origin": ADAPTER, "kind": "CONNECTED"}
        seen = len(await self.device.wait(since, connected, timeout_s=0.0))
        await self.device.wait(since, connected, timeout_s=0.05, count=seen + 1)
        if self.under_test.adapter.recovery == "connect_step" or self.under_test.unconnected:
            # The connect step may fail as long as the device is not ready; then the call after it fails as well, and says so.
            with self._bench.spent.on("tool calls"):
                await self.under_test.connect()

    async def _stop(self) -> float:
        begun = time.monotonic_ns()
        with self._bench.spent.on("endpoint restarts"):
            await self.device.stop()
        took_ms = (time.monotonic_ns() - begun) / 1e6
        self._noted({"stop": took_ms}, begun)
        return took_ms

    async def start_device(self) -> float:
        begun = time.monotonic_ns()
        with self._bench.spent.on("endpoint restarts"):
            await self.device.start()
        self._cursor.restart()
        self._state.told_session = self._cursor.session
        took_ms = (self.device.accepting_ns - begun) / 1e6
        self._noted({"start": {"ms": took_ms, "accepting_ns": self.device.accepting_ns}}, begun)
        return took_ms

    async def _replace_session(self) -> FreshSession:
        begun = time.monotonic_ns()
        # Like an endpoint restart, this time is a result of the measurement, not its cost.
        with self._bench.spent.on("fresh sessions"):
            session = self.under_test.session
            await self.under_test.close()
            report = None if session is None else session.stop_report
            await self.under_test.open()
        assert self.under_test.session is not None
        fresh = FreshSession(
            spawned_ns=self.under_test.session.spawned_ns,
            opened=self._cursor.began,
            ended=None if report is None else report.how,
            seconds=0.0 if report is None else report.seconds,
        )
        self._state.told_session = self._cursor.session
        self._noted({"fresh_session": asdict(fresh)}, begun)
        return fresh

    async def garble_switch(self) -> bool:
        begun = time.monotonic_ns()
        with self._bench.spent.on("adapter starts"):
            started = await self.under_test.open_garbled()
        self._state.told_session = self._cursor.session
        self._noted({"garbled": self._cursor.began if started else None}, begun)
        return started

    async def _open_by_handshake(self) -> HandshakeEra:
        begun = time.monotonic_ns()
        found: HandshakeEra = {"opened": None, "revision": None}
        if self.under_test.may_speak_by_handshake:
            with self._bench.spent.on("adapter starts"):
                found["revision"] = await self.under_test.open_by_handshake()
            session = self._state.told_session = self._cursor.session
            found["opened"] = None if session is None else session[1]
        self._noted({"handshake_era": found}, begun)
        return found

    async def close_handshake_era(self) -> None:
        with self._bench.spent.on("adapter starts"):
            await self.under_test.close_handshake_era()

    async def footprint(self) -> Footprint:
        asked_ns = time.monotonic_ns()
        session = self.under_test.session
        found = footprint(None if session is None else session.pid)
        self._noted({"process": found}, asked_ns)
        return found

    async def tool_list(self) -> Mapping[str, ToolListing]:
        asked_ns = time.monotonic_ns()
        names = self._session.tools
        listed = {name: entry for name in names if (entry := self.under_test.listing(name)) is not None}
        self._noted({"listed": listed}, asked_ns)
        return listed

    async def listed_tools(self) -> str:
        asked_ns = time.monotonic_ns()
        with self._bench.spent.on("tool calls"):
            digest = await self._session.list_anew(timeout_s=self.under_test.deadline_s)
        self._noted({"tools": digest}, asked_ns)
        return digest

    async def listing_took_s(self) -> float:
        await self.listed_tools()
        seen = self._ledger.observations[-1]
        return (seen["seen_ns"] - seen["asked_ns"]) / 1e9

    async def send_line(self, line: str) -> bool:
        asked_ns = time.monotonic_ns()
        sent = self._session.write_line(line.encode("utf-8", "surrogateescape"))
        self._noted({"line_sent": sent}, asked_ns)
        return sent

    async def refuses(self, tool: str) -> bool | None:
        asked_ns = time.monotonic_ns()
        with self._bench.spent.on("tool calls"):
            refused = await self.under_test.refuses(tool)
        self._noted({"refuses": refused}, asked_ns)
        return refused

    async def made_file(self, name: str) -> bool:
        asked_ns = time.monotonic_ns()
        found = self.under_test.take_file(name)
        self._noted({"made_file": found}, asked_ns)
        return found

    async def stderr(self) -> list[str]:
        asked_ns = time.monotonic_ns()
        lines = self._session.stderr_tail()
        self._noted({"stderr": lines}, asked_ns)
        return lines

    @property
    def _session(self) -> McpSession:
        session = self.under_test.session
        if session is None:
            raise KitError(f"the steps look at the session of {self.name}, there is none")
        return session

    async def close_session(self) -> None:
        with self._bench.spent.on("adapter starts"):
            await self.under_test.close()

    async def take_slice(self) -> list[Entry]:
        asked_ns = time.monotonic_ns()
        journal = await self.device.journal(self._cursor.next)
        self._cursor.take(journal.entries, journal.next)
        self._noted({"end": journal.next}, asked_ns)
        await self._state.release()
        return journal.entries
