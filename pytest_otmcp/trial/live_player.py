"""Plays the steps of a repetition at a running adapter and device. Every look is noted, so that it can be repeated."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from typing import TypeVar, cast

from ..core.errors import NoHandleError
from ..core.finding import Finding
from ..plant.endpoint import check_free
from ..protocols.journal import ADAPTER
from ..record.images import Images, keep_image
from ..record.schema import HandshakeEra, ItemDevice, Observation, SessionStart
from ..session.session import McpSession
from ..subject.model import Binding, Function
from .adapter_under_test import AdapterUnderTest
from .alteration import Alteration
from .bench import Bench
from .ledger import Ledger
from .player import OBSERVING, FreshSession, Player
from .reply import Reply
from .rig import EndedError, Entry, adapter_name

__all__ = ["LiveItemState", "LivePlayer"]

T = TypeVar("T")


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
        self.stated = under_test.stated
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
        if cursor.missed:
            self._found["missed"], cursor.missed = cursor.missed, []
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


class LivePlayer(Player):
    """Does what the steps ask for at a running adapter and device, and notes every look with the repetition."""

    def __init__(self, state: LiveItemState, bench: Bench) -> None:
        under_test = state.under_test
        super().__init__(under_test.adapter.protocol, under_test.variant, state.stated, under_test.cursor)
        self.device = under_test.device
        self._under_test = under_test
        self._state = state
        self._bench = bench
        self._bugs: list[tuple[Finding, McpSession]] = []

    def join(self, ledger: Ledger) -> None:
        super().join(ledger)
        session = self.cursor.session
        if session is not None and session != self._state.told_session:
            self._state.told_session = session
            self._noted({"session": list(session)}, time.monotonic_ns())

    # -- looks --------------------------------------------------------------------------------------------

    def _noted(self, seen: Mapping[str, object], asked_ns: int) -> None:
        now_ns = time.monotonic_ns()
        self.took_s = (now_ns - asked_ns) / 1e9
        at = adapter_name(self.protocol, self.variant)
        self._ledger.observed(cast(Observation, {"at": at, "asked_ns": asked_ns, "seen_ns": now_ns, **seen}))

    def _spent(self, what: str = OBSERVING) -> AbstractContextManager[None]:
        return self._bench.spent.on(what)

    async def ask(
        self, kind: str, question: Callable[[AdapterUnderTest], Awaitable[T]], *, spent: str = OBSERVING
    ) -> T:
        asked_ns = time.monotonic_ns()
        with self._spent(spent):
            answer = await question(self._under_test)
        self._noted({kind: answer}, asked_ns)
        return answer

    async def act(self, deed: Callable[[AdapterUnderTest], Awaitable[None]]) -> None:
        with self._spent():
            await deed(self._under_test)

    async def pause(self, seconds: float) -> None:
        with self._spent("quiet windows"), self._bench.under_way.wait("what must not come"):
            await asyncio.sleep(seconds)

    async def image(self) -> dict[str, object]:
        asked_ns = time.monotonic_ns()
        with self._spent():
            image = await self.device.image()
        kind, kept = keep_image(self._state.images, adapter_name(self.protocol, self.variant), image)
        self._noted({kind: kept}, asked_ns)
        return image

    async def entries(self, kind: str, since: int) -> tuple[list[Entry], int]:
        asked_ns = time.monotonic_ns()
        with self._spent():
            journal = await self.device.journal(since)
        self._noted({kind: [since, journal.next] if kind == "session_journal" else journal.next}, asked_ns)
        return journal.entries, journal.next

    async def take_slice(self) -> list[Entry]:
        asked_ns = time.monotonic_ns()
        journal = await self.device.journal(self.cursor.next)
        self.cursor.take(journal.entries, journal.next)
        self._noted({"end": journal.next}, asked_ns)
        await self._state.release()
        return journal.entries

    async def wait(self, match: Mapping[str, object], *, timeout_s: float, count: int) -> list[Entry]:
        scaled = timeout_s * self._ledger.time_scale
        return await self._counted(self.device.wait(self.cursor.next, match, timeout_s=scaled, count=count))

    async def _counted(self, waiting: Awaitable[list[Entry]]) -> list[Entry]:
        asked_ns = time.monotonic_ns()
        with self._spent():
            entries = await waiting
        self._noted({"wait": len(entries)}, asked_ns)
        return entries

    # -- calls --------------------------------------------------------------------------------------------

    async def perform(self, operation: str, inputs: Mapping[str, object], altered: Alteration | None = None) -> Reply:
        try:
            with self._bench.under_way.call(operation):
                return self._observed(await self._under_test.call(operation, inputs, altered=altered))
        except NoHandleError:
            # The call that should have yielded the handle has failed, and that is what the item says.
            if self._ledger.failed:
                raise EndedError from None
            raise

    async def perform_and_cancel(
        self,
        operation: str,
        inputs: Mapping[str, object],
        seen: Mapping[str, object],
        timeout_s: float,
        meanwhile: Callable[[], Awaitable[object]] | None,
    ) -> Reply:
        cancel = asyncio.Event()
        # One more entry that matches than there are.
        before = len(await self.device.wait(self.cursor.next, seen, timeout_s=0.0))
        call = asyncio.create_task(self._under_test.call(operation, inputs, cancel=cancel))
        try:
            scaled = timeout_s * self._ledger.time_scale
            await self.device.wait(self.cursor.next, seen, timeout_s=scaled, count=before + 1)
            if meanwhile is not None:
                await meanwhile()
        finally:
            cancel.set()
            with self._bench.under_way.call(operation):
                await asyncio.wait({call})
        return self._observed(call.result())

    def _observed(self, reply: Reply) -> Reply:
        if self._under_test.session is not None:
            bugs = [fault for fault in reply.faults if fault.code == "internal_error"]
            self._bugs += [(bug, self._under_test.session) for bug in bugs]
        return reply

    def add_last_words(self) -> None:
        """Add the adapter's last lines on stderr as evidence to the internal errors that it reported."""
        evidence: dict[int, str] = {}
        for bug, session in self._bugs:
            if lines := session.stderr_tail():
                evidence[id(bug)] = "the adapter's last lines on stderr:\n    " + "\n    ".join(lines)
        self._ledger.explain(evidence)

    async def reconnecting(self) -> None:
        # An adapter may reconnect in its own time: a new connection is the sign to call it again. Without one it is called
        # after a pause, so that an adapter which fails at once is not called without pause.
        since = self.cursor.next
        connected = {"origin": ADAPTER, "kind": "CONNECTED"}
        seen = len(await self.device.wait(since, connected, timeout_s=0.0))
        await self.device.wait(since, connected, timeout_s=0.05, count=seen + 1)
        if self._under_test.adapter.recovery == "connect_step" or self._under_test.unconnected:
            # The connect step may fail as long as the device is not ready; then the call after it fails as well, and says so.
            with self._spent("tool calls"):
                await self._under_test.connect()

    def bindings(self, operation: str) -> Sequence[Binding] | None:
        found = self._under_test.bindings(operation)
        if any(case.command is not None for case in found or ()):
            # What commands can express is judged from the record as well.
            self._under_test.used[operation] = None
        return found

    def is_bound(self, operation: str, inputs: Mapping[str, object], *, first: bool = False) -> bool:
        bound = self._under_test.is_bound(operation, inputs, first=first)
        if not bound and self._under_test.bindings(operation):
            # What bindings are for is judged from the record as well.
            self._under_test.used[operation] = None
        return bound

    def listing(self, operation: str, tool: str) -> Mapping[str, object] | None:
        bound = self._under_test.adapter.operations.get(operation)
        # What a function of the user's passes to its tools is its own affair.
        return None if isinstance(bound, Function) else self._under_test.consulted(operation, tool)

    # -- the device ---------------------------------------------------------------------------------------

    @property
    def addresses(self) -> list[tuple[str, int]]:
        return [(endpoint.host, endpoint.port) for endpoint in self.device.endpoints.values() if endpoint.port]

    @property
    def placeholders(self) -> Mapping[str, str]:
        return self._under_test.endpoint

    @property
    def running(self) -> bool:
        return self.device.running

    @property
    def accepting_ns(self) -> int:
        return self.device.accepting_ns

    async def check_away(self) -> None:
        await check_free(self.device.endpoints.values(), self.device.walls)

    async def stop(self) -> float:
        begun = time.monotonic_ns()
        with self._spent("endpoint restarts"):
            await self.device.stop()
        took_ms = (time.monotonic_ns() - begun) / 1e6
        self._noted({"stop": took_ms}, begun)
        return took_ms

    async def start(self) -> float:
        begun = time.monotonic_ns()
        with self._spent("endpoint restarts"):
            await self.device.start()
        self.cursor.restart()
        self._state.told_session = self.cursor.session
        took_ms = (self.device.accepting_ns - begun) / 1e6
        self._noted({"start": {"ms": took_ms, "accepting_ns": self.device.accepting_ns}}, begun)
        return took_ms

    # -- the session --------------------------------------------------------------------------------------

    async def replace_session(self) -> FreshSession:
        begun = time.monotonic_ns()
        # Like an endpoint restart, this time is a result of the measurement, not its cost.
        with self._spent("fresh sessions"):
            session = self._under_test.session
            await self._under_test.close()
            report = None if session is None else session.stop_report
            await self._under_test.open()
        assert self._under_test.session is not None
        fresh = FreshSession(
            spawned_ns=self._under_test.session.spawned_ns,
            opened=self.cursor.began,
            ended=None if report is None else report.how,
            seconds=0.0 if report is None else report.seconds,
        )
        self._state.told_session = self.cursor.session
        self._noted({"fresh_session": asdict(fresh)}, begun)
        return fresh

    async def start_garbled(self) -> bool:
        return await self._started(self._under_test.open_garbled)

    async def start_without_certificate(self) -> bool:
        return await self._started(self._under_test.open_without_certificate)

    async def _started(self, start: Callable[[], Awaitable[bool]]) -> bool:
        begun = time.monotonic_ns()
        with self._spent("adapter starts"):
            started = await start()
        self._state.told_session = self.cursor.session
        self._noted({"garbled": self.cursor.began if started else None}, begun)
        return started

    async def open_by_handshake(self) -> HandshakeEra:
        begun = time.monotonic_ns()
        found: HandshakeEra = {"opened": None, "revision": None}
        if self._under_test.may_speak_by_handshake:
            with self._spent("adapter starts"):
                found["revision"] = await self._under_test.open_by_handshake()
            session = self._state.told_session = self.cursor.session
            found["opened"] = None if session is None else session[1]
        self._noted({"handshake_era": found}, begun)
        return found

    async def close_handshake_era(self) -> None:
        with self._spent("adapter starts"):
            await self._under_test.close_handshake_era()

    async def close_session(self) -> None:
        with self._spent("adapter starts"):
            await self._under_test.close()
