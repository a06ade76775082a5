"""The driver of a trial on a bench: it uses running adapters and devices, and keeps what judging again needs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from datetime import UTC, datetime

from ..core.errors import NoBindingError, SubjectError
from ..core.text import printable
from ..core.verdict import Status
from ..protocols.journal import Entries
from ..protocols.protocol import Declared
from ..record.schema import Role, SessionRemark
from ..session.process import StopReport
from ..subject.model import READ_ONLY, READ_WRITE
from .applicability import applicability, participants, why_not_in_field
from .asked_for import AskedFor
from .bench import Bench
from .driver import ItemHistory, SessionFacts
from .gc_pause import uncollected
from .live_player import LiveItemState, LivePlayer
from .proving import ARRIVAL
from .repetition import Repetition
from .rig import EndedError, Rig, adapter_name
from .task import Steps, Task, execute

__all__ = ["LiveDriver"]


class LiveDriver:
    """Driver of a task with the running adapters and devices of a bench that it needs.

    Args:
        bench: a prepared bench.
        task: the task to run.
        seed: of the run.
    """

    def __init__(self, bench: Bench, task: Task, *, seed: int) -> None:
        self._bench = bench
        self._task = task
        self._seed = seed
        self._before = dict(bench.spent.seconds)
        self._states: list[LiveItemState] = []
        self._players: list[LivePlayer] = []
        self._sessions: list[SessionRemark] = []
        self._started = datetime.now(UTC)
        self._began_ns = time.monotonic_ns()
        self._inspections = 0

    def obstacle(self) -> tuple[Status, str] | None:
        """Say what the task needs and the subject does not claim, or cannot be asked for; None when it can be run."""
        reason = why_not_in_field(self._task, self._bench.options.devices)
        if reason is not None:
            return Status.NOT_APPLICABLE, reason
        return applicability(self._task, self._bench.subject.adapters)

    def spent(self, what: str) -> AbstractContextManager[None]:
        """Count the time inside the block as spent on ``what``."""
        return self._bench.spent.on(what)

    async def prepare(self) -> None:
        """Reset the devices and open the sessions."""
        with self.spent("plant start"):
            for name in participants(self._task, self._bench.subject.adapters):
                self._states.append(LiveItemState(await self._bench.adapter(name)))
        for state in self._states:
            if not state.under_test.device.running:
                # Another program had its port when an item before wanted to start it again.
                await state.under_test.device.start()
                state.under_test.cursor.restart()
            cursor = state.under_test.cursor
            # Where the proof was that a client has arrived, nothing but another arrival can prove the session again.
            doubted = cursor.preferred == ARRIVAL and cursor.proven is None
            dead = await state.under_test.device.reset()
            # Those ended with earlier items.
            state.under_test.take_ended()
            state.under_test.take_leaks()
            await state.enter()
            if dead or doubted:
                # What an earlier item has done to the connection is nothing that this one asks about.
                await state.under_test.close()
                state.under_test.take_ended()
        await self.open_sessions()

    def before(self) -> Sequence[tuple[str, Entries, Declared, AskedFor]]:
        """Return what reached the devices while nobody called their adapters."""
        return [
            (
                state.under_test.adapter.protocol,
                state.found["before"],
                state.under_test.adapter.lists,
                state.under_test.cursor.asked_for,
            )
            for state in self._states
            if state.entered and state.found["quiet"]
        ]

    def repetition(self, rep: int, role: Role) -> Repetition:
        """Return a repetition on this bench; what the one before it was answered is not kept any more."""
        self._bench.allowance.renew()
        self._players = [LivePlayer(state, self._bench) for state in self._states]
        return Repetition(
            self._task.id,
            rep,
            role,
            seed=self._seed,
            time_scale=self._bench.options.time_scale,
            soak=self._bench.options.soak,
            suite=self._task.suite,
            rigs=map(Rig, self._players),
        )

    async def perform(self, repetition: Repetition, steps: Steps) -> None:
        """Execute the steps and take the journals."""
        try:
            await self._perform(repetition, steps)
        except BaseException:
            # No part of the item will have what was taken.
            for player in self._players:
                player.cursor.missed += repetition.ledger.of(player.protocol, player.variant)
            raise

    async def _perform(self, repetition: Repetition, steps: Steps) -> None:
        for state in self._states:
            state.under_test.cursor.looked_through = False
        try:
            with uncollected():
                await execute(self._task, steps, repetition)
        except EndedError:
            repetition.ended_early = True
            await _all_running(repetition)
        except (NoBindingError, SubjectError):
            # This item is over, but the next items need the device.
            await _all_running(repetition)
            raise
        finally:
            on_the_wire, in_client = repetition.calls_s()
            self._bench.spent.move("kit", "tool calls", on_the_wire)
            self._bench.spent.move("kit", "MCP client", in_client)
        with self.spent("observing the device"):
            await repetition.close_journals()
        for state in self._states:
            state.under_test.cursor.looked_through = True
        for player in self._players:
            player.add_last_words()

    async def inspect(self) -> list[SessionFacts]:
        """End the sessions of variants with devices of their own, and ask all sessions of the item for stray output."""
        await self.close(renew=False)
        found = await self._inspect(ending=False)
        for state in self._states:
            for session in state.under_test.take_ended():
                report = session.report
                late = (
                    report is not None
                    and report.how in ("terminated", "killed")
                    and state.under_test.variant == READ_ONLY
                )
                facts = SessionFacts(
                    protocol=state.under_test.adapter.protocol,
                    stray_lines=session.stray_lines,
                    first_stray=session.first_stray,
                    overstayed=_overstayed(report) if report is not None and late else _left(report),
                    tools_changed=session.tools_changed,
                )
                if facts.remarkable:
                    found.append(facts)
                    self._sessions.append(facts.as_record(self._inspections))
        return found + self._leaks()

    def told_at_start(self) -> list[SessionFacts]:
        """Return the secrets that were told by adapters that could not be started."""
        self._inspections += 1
        return self._leaks()

    async def end_sessions(self) -> list[SessionFacts]:
        """End all sessions and return how they ended: all start afresh, as a hanging call may affect the calls after it."""
        found = await self._inspect(ending=True)
        with self.spent("adapter starts"):
            for state in self._states:
                await state.under_test.close()
                state.under_test.take_ended()
                if state.under_test.device.faulty:
                    # The steps that wanted it slow, or silent, have ended before they could end that.
                    await state.under_test.device.delay(0.0)
        return found + self._leaks()

    def _leaks(self) -> list[SessionFacts]:
        """Return and record the secrets that were told since the last question."""
        told = ((state.under_test.adapter.protocol, state.under_test.take_leaks()) for state in self._states)
        found = [SessionFacts(protocol=protocol, leaks=leaks) for protocol, leaks in told if leaks]
        self._sessions += [facts.as_record(self._inspections) for facts in found]
        return found

    async def _inspect(self, *, ending: bool) -> list[SessionFacts]:
        self._inspections += 1
        found = []
        for state in self._states:
            session = state.under_test.session
            if session is None:
                continue
            lines, first = session.stray_output()
            facts = SessionFacts(
                protocol=state.under_test.adapter.protocol,
                unknown_ids=tuple(session.unknown_responses()),
                repeated_ids=tuple(session.repeated_responses()),
                too_deep=session.too_deep,
                stray_lines=lines,
                first_stray=first[0] if lines else "",
                tools_changed=None if ending else await session.tools_changed(),
            )
            if ending:
                died = session.died and not session.overflow
                facts = replace(
                    facts,
                    overflow=session.overflow,
                    died=await session.death_note() if died else None,
                )
            if facts.remarkable:
                found.append(facts)
                self._sessions.append(facts.as_record(self._inspections))
        return found

    async def open_sessions(self) -> None:
        """Open the sessions that are not open or that broke."""
        with self.spent("adapter starts"):
            for state in self._states:
                await state.under_test.open()

    async def close(self, *, renew: bool) -> None:
        """End the sessions that the next items shall not have; the devices of other variants than that with writes enabled are this item's alone."""
        with self.spent("adapter starts"):
            for state in self._states:
                if (renew and not state.under_test.cursor.hopeless) or state.under_test.variant != READ_WRITE:
                    await state.under_test.close()

    def timing_ms(self) -> Mapping[str, float]:
        """Return the milliseconds by what they were spent on."""
        return {
            what: round((seconds - self._before.get(what, 0.0)) * 1000, 3)
            for what, seconds in self._bench.spent.seconds.items()
            if seconds - self._before.get(what, 0.0) > 0
        }

    def history(self) -> ItemHistory:
        """Return when and in which worker the item ran, how it found the devices, and what was remarkable about the sessions."""
        return ItemHistory(
            worker=self._bench.options.worker,
            started_at=_instant(self._started),
            finished_at=_instant(datetime.now(UTC)),
            began_ns=self._began_ns,
            ended_ns=time.monotonic_ns(),
            devices={
                adapter_name(state.under_test.adapter.protocol, state.under_test.variant): state.found
                for state in self._states
                if state.entered
            },
            sessions=self._sessions,
        )


def _overstayed(report: StopReport) -> str:
    return (
        f"with writes disabled the adapter did not exit within {report.seconds:.1f} s of its stdin closing and had to be "
        f"{report.how}"
    )


def _left(report: StopReport | None) -> str | None:
    if report is None or not report.left:
        return None
    return f"the adapter ended and left processes running, which had to be killed: {printable(', '.join(report.left))}"


def _instant(moment: datetime) -> str:
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


async def _all_running(repetition: Repetition) -> None:
    for at in repetition.all:
        if not at.device.running:
            await at.start_device()
