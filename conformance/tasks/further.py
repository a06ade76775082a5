"""The items that every further protocol has, declared once: the functions here make them from what a protocol says of its device.

A protocol's module makes one :class:`Further`, and names each item where it belongs in the order of its own ones::

    TASKS = Further("s7", device="the controller", points="a data block", ...)

    further.ping(TASKS, "K1", "Ping the adapter and confirm that the controller answers.")

Words in braces in the docstrings of steps are those of the protocol.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, Protocol, TypeVar

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked, Contended
from pytest_otmcp.protocols.journal import Entries, Image, JournalEntry
from pytest_otmcp.protocols.oracle import Witness, has
from pytest_otmcp.protocols.point import Point
from pytest_otmcp.protocols.protocol import GUARD
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.check import Generic, on_protocol
from pytest_otmcp.trial.explanation import explanation
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Steps, Task, Tasks

from .common import (
    NOTHING_SENT,
    QUIET_S,
    RAPID_CALLS,
    a_delay_shows,
    a_failed_write_is_not_made_up_for,
    a_meaningless_switch_enables_nothing,
    drawn_until,
    ends_when_its_stdin_closes,
    fresh,
    outage,
    start_without_device,
    status_is_known,
    survive_a_restart,
    untold,
)
from .common import Witness as SeenByDevice

__all__ = [
    "Further",
    "another_answers",
    "beside",
    "call",
    "ends_with_its_stdin",
    "four_at_once",
    "guard",
    "missing",
    "not_sent",
    "overflow",
    "ping",
    "rapid",
    "reads",
    "reads_back",
    "recovery",
    "refused_by_itself",
    "restart",
    "set_up",
    "there",
    "usual",
    "watchdog",
]

T = TypeVar("T")
_BUSY_S = 10.0
"""Seconds more than a watchdog takes that a machine may need that is busy."""
Of = Callable[[Repetition], T]
"""Makes what one repetition asks for."""


class Judge(Protocol):
    """Judges what a device has seen of a call.

    Args:
        entries: of the journal.
        image: of the device; empty where the protocol's requests name their targets in full.
        asked: the call.
    """

    def __call__(self, entries: Entries, image: Image, asked: Asked, /) -> list[Finding]: ...


class Further(Tasks):
    """The tasks of a further protocol, and what the items that it shares with the others have to know of it.

    Args:
        protocol: its key.
        witness: the judge of what its device sees and holds.
        was_read: expects that the device was asked for what a call reads. None where the kinds and the members of the journal's entries
            are named like the protocol's operations and their inputs.
        one_write: expects that the device saw one request that changes the plant: what a call writes; None as for ``was_read``.
        resolves: a request may name its target by a number that only the device's image explains.
        device: the device in words, such as ``the controller``.
    """

    def __init__(
        self,
        protocol: str,
        *,
        witness: Witness,
        was_read: Judge | None = None,
        one_write: Judge | None = None,
        resolves: bool = False,
        device: str | None = None,
    ) -> None:
        super().__init__()
        self.protocol = protocol
        self.witness = witness
        self.was_read = was_read or self._was_read
        self.one_write = one_write or self._one_write
        self.device = device or witness.noun
        self._resolves = resolves

    def item(
        self,
        id: str,
        suite: str,
        title: str,
        *,
        needs: str,
        capability: str,
        requirements: str,
        guard: bool = False,
        keys: str = "",
        told: Mapping[str, str] | None = None,
    ) -> Callable[[Generic], Task]:
        """Return a decorator that turns steps into the item of this protocol.

        Args:
            needs, keys: as of :meth:`~pytest_otmcp.trial.task.Tasks.task`, without the protocol.
            guard: the steps get the read-only variant, and no other.
            told: what their docstring says otherwise on this protocol: ``asked``, ``said``, ``seen`` or ``why``.
        """
        facets = [*needs.split(), *[GUARD] * guard]
        declare = self.task(
            id,
            suite,
            title,
            needs=" ".join(f"{self.protocol}.{facet}" for facet in facets),
            capability=capability,
            requirements=requirements,
            keys=" ".join(f"{self.protocol}.{key}" for key in keys.split()),
        )
        adapter = f"{self.protocol}_ro" if guard else self.protocol
        return lambda steps: declare(on_protocol(adapter, self._told(steps, told)))

    def after(self, task: Task, *, guard: bool = False) -> Callable[[Generic], None]:
        """Return a decorator that registers steps which run once after the repetitions.

        Args:
            guard: the steps get the read-only variant as well.
        """

        def declare(steps: Generic) -> None:
            task.after(on_protocol(self.protocol, self._told(steps), [GUARD] * guard))

        return declare

    def _told(self, steps: Generic, told: Mapping[str, str] | None = None) -> Generic:
        """Return steps whose docstring is about this protocol."""
        if steps.__doc__ is None:
            # With PYTHONOPTIMIZE=2 there are no docstrings.
            return steps
        parts = {**asdict(explanation(steps)), **(told or {})}
        asked, *others = (f"{name.title()}: {text}" for name, text in parts.items() if text)
        text = "\n".join([asked.removeprefix("Asked: "), "", *others])
        steps.__doc__ = text.format(device=self.device)
        return steps

    def _was_read(self, entries: Entries, image: Image, asked: Asked) -> list[Finding]:
        wanted = {"kind": asked.operation, **asked.inputs}
        what = ", ".join(map(str, wanted.values()))
        return self.witness.was_asked(entries, what, lambda found: any(has(one, **wanted) for one in found))

    def _one_write(self, entries: Entries, image: Image, asked: Asked) -> list[Finding]:
        wanted = {"kind": asked.operation, **asked.inputs}

        def problem(entry: JournalEntry) -> tuple[str, str] | None:
            return None if has(entry, **wanted) else ("WR-001", f"it saw {self.witness.describe(entry)}")

        return self.witness.exactly_one_write(entries, ", ".join(map(str, wanted.values())), problem)

    async def names(self, at: Rig) -> Image:
        """Return the image by which requests are understood."""
        return await at.device.image() if self._resolves else {}

    async def sees_and_holds(self, run: Repetition, at: Rig, asked: Asked, judge: Judge | None = None) -> None:
        """Expect that the device saw the one write, and holds it."""
        image = await self.names(at)
        found = (judge or self.one_write)(await at.journal(), image, asked)
        run.witnessed(found, self.witness.holds(image or await at.device.image(), asked.points))

    def seen(self, journal: Entries, image: Image, *asked: tuple[Reply, Asked]) -> list[Finding]:
        """Expect that each call made the device see what it asks for."""
        return fresh(journal, *((reply, partial(_read, self.was_read, image=image, asked=one)) for reply, one in asked))


def _read(judge: Judge, entries: Entries, *, image: Image, asked: Asked) -> list[Finding]:
    return judge(entries, image, asked)


async def set_up(at: Rig, *asked: Asked) -> None:
    """Set at the device what calls need."""
    for one in asked:
        for poke in one.pokes:
            await at.device.poke(**poke)


async def watchdog(at: Rig, seconds: float, **where: int) -> None:
    """Wait until outputs have fallen because their master is silent; ``seconds`` is the time of the watchdog, on a machine that is not busy."""
    await at.wait_for(timeout_s=seconds + _BUSY_S, kind="watchdog", origin="plant", **where)


async def call(at: Rig, asked: Asked) -> Reply:
    """Make a call."""
    return await at.call(asked.operation, **asked.inputs)


def ping(of: Further, id: str, title: str, *, after: Steps | None = None, **told: str) -> Task:
    """Declare the item that asks whether the device can be reached.

    Args:
        after: steps after the repetitions; None is a ping that the device answers late.
    """

    @of.item(id, "normal", title, needs="ping", capability="reading", requirements="REC-002 MCP-008", told=told)
    async def steps(run: Repetition, at: Rig) -> None:
        """Ask whether {device} can be reached.

        Said: success, and that it can be reached.
        Seen: at least one request during the call, which {device} answers.
        Why: a status from memory still says so when the plant is gone.
        """
        reply = await at.call("ping")
        run.succeeds(reply, reachable=True)
        await status_is_known(run, at, of.witness.answered, reply)

    if after is not None:
        steps.after(after)
        return steps

    @of.after(steps)
    async def it_is_slow(run: Repetition, at: Rig) -> None:
        """Ping while {device} answers a tenth of a second late.

        Said: success, and a latency that is no shorter than that.
        """
        await a_delay_shows(run, at, "ping")

    return steps


def reads(of: Further, id: str, title: str, *, needs: str, make: Of[Sequence[Asked]], **told: str) -> Task:
    """Declare the item that reads values.

    Args:
        make: the reads; with the points of the image that hold their values, where it has some.
    """

    @of.item(
        id, "normal", title, needs=needs, capability="reading", requirements="RD-001 RD-002 RD-004 MCP-009", told=told
    )
    async def steps(run: Repetition, at: Rig) -> None:
        """Read values of {device}, which were set at random just before.

        Said: these values.
        Seen: a read of each of them, and nothing that changes the plant.
        Why: values from memory, of a neighbour or in another byte order look right until an operator acts on them.
        """
        asked = make(run)
        await set_up(at, *asked)
        image = await of.names(at)
        replies = [await call(at, one) for one in asked]
        for reply, one in zip(replies, asked, strict=True):
            run.succeeds(reply, **one.outputs)
        journal = await at.journal()
        held = {point: value for one in asked for point, value in one.points.items()}
        run.witnessed(
            of.seen(journal, image, *zip(replies, asked, strict=True)),
            of.witness.nothing_changed(journal, requirement="MCP-008"),
            of.witness.holds(await at.device.image(), held) if held else [],
        )

    ends_with_its_stdin(of, steps)
    return steps


def ends_with_its_stdin(of: Further, task: Task) -> None:
    """Register the end of the session after an item."""

    @of.after(task)
    async def the_process_ends_with_its_stdin(run: Repetition, at: Rig) -> None:
        """End the session.

        Seen: the process ends by itself.
        """
        await ends_when_its_stdin_closes(at)


def reads_back(
    of: Further,
    id: str,
    title: str,
    *,
    needs: str,
    write: Of[Asked],
    read: Callable[[Image], Asked] | None = None,
    facet: str | None = None,
    judge: Judge | None = None,
    **told: str,
) -> Task:
    """Declare the item that writes a value and reads it back.

    Args:
        read: the read, from what the device holds then; None where outputs cannot be read.
        facet: without it nothing is read.
        judge: of the write; None is that of the protocol.
    """

    @of.item(id, "normal", title, needs=needs, capability="writing", requirements="WR-001 WR-002 WR-003", told=told)
    async def steps(run: Repetition, at: Rig) -> None:
        """Write a value, and read it where the adapter can.

        Said: the value that was written, in both answers.
        Seen: one write of this value, of its type and to its place; everything else in {device} stays as it was.
        Why: an adapter that says "written" may have written twice, beside the place, as another type, or not at all.
        """
        asked = write(run)
        await set_up(at, asked)
        before = await at.device.image()
        wrote = await call(at, asked)
        after = await at.device.image()
        # What the device holds now may not be the value, which is the fault of the write; the read has to tell it.
        reading = read(after) if read and (facet is None or at.subject.claims(facet)) else None
        reply = await call(at, reading) if reading else None
        run.succeeds(wrote, **asked.outputs)
        if reply and reading:
            run.succeeds(reply, **reading.outputs)
        journal = await at.journal()
        run.witnessed(
            (judge or of.one_write)(journal, after, asked),
            of.seen(journal, after, (reply, reading)) if reply and reading else [],
            of.witness.only_changed(before, after, asked.points),
        )

    return steps


def guard(of: Further, id: str, title: str, *, needs: str, write: Of[Asked], read: Of[Asked], **told: str) -> Task:
    """Declare the item that writes with writes disabled."""

    @of.item(
        id,
        "normal",
        title,
        needs=needs,
        guard=True,
        capability="write_protection",
        requirements="WR-004 WR-005 ERR-006",
        told=told,
    )
    async def steps(run: Repetition, guarded: Rig) -> None:
        """Write a value through the adapter that was started with writes disabled.

        Said: a refusal with `writes_disabled` and the outcome `not_sent`.
        Seen: no request that changes the plant or prepares that; {device} holds what it held.
        Why: the write switch is what keeps an assistant's mistake out of the plant.
        """
        before = await guarded.device.image()
        reply = await call(guarded, write(run))
        run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
        run.witnessed(
            of.witness.nothing_changed(await guarded.journal()),
            of.witness.only_changed(before, await guarded.device.image(), {}, otherwise="WR-004"),
        )

    @of.after(steps, guard=True)
    async def the_guard_was_put_to_the_test(run: Repetition, at: Rig, guarded: Rig) -> None:
        """Read with writes disabled, and write the same value with writes enabled: both must work, or the refusal proves
        nothing. Then write through the adapter that was started with a write switch that means nothing.

        Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
        Seen: over the whole life of the read-only sessions, their end included, nothing that changes the plant.
        """
        run.succeeds(await call(guarded, read(run)))
        asked = write(run)
        run.succeeds(await call(at, asked), **asked.outputs)
        run.witnessed(
            of.witness.answered(await guarded.journal()),
            of.one_write(await at.journal(), await of.names(at), asked),
        )
        # The journal of this device holds the whole life of the read-only session, its closing included, and nothing else.
        await guarded.close_session()
        run.witnessed(of.witness.nothing_changed_by(await guarded.follow(StateChanges)))
        await a_meaningless_switch_enables_nothing(run, guarded, asked.operation, **asked.inputs)

    return steps


def missing(
    of: Further,
    id: str,
    title: str,
    *,
    needs: str,
    key: str,
    make: Callable[[Any], Asked],
    reached: Callable[[Entries, Image, Asked], bool],
    refused: Callable[[Entries], list[Finding]],
    trace: dict[str, object] | None = None,
    partly: bool = True,
    **told: str,
) -> Task:
    """Declare the item that reads what the device does not have.

    Args:
        key: of the probe that names it.
        make: the read, from the probe.
        reached: tells whether requests for what a call reads reached the device.
        refused: expects that the device refused what it does not have.
        trace: members of ``meta.trace`` that tell the refusal.
        partly: the item also reads what is there in part only.
    """

    @of.item(
        id,
        "fault",
        title,
        needs=needs,
        capability="refusing",
        requirements="ERR-002 ENV-007 RD-005" + " RD-007" * partly,
        keys=f"probes.{key}",
        told=told,
    )
    async def steps(run: Repetition, at: Rig) -> None:
        """Read a place that {device} does not have.

        Said: a failure with `illegal_address`. An adapter that refuses by a list of its own may also say `invalid_input`; nothing was
            sent then.
        Seen: the read, which {device} refuses.
        Why: an assistant that gets a zero for a place that does not exist believes the zero.
        """
        asked = make(at.subject.probe(key))
        reply = await call(at, asked)
        seen = reply.during(await at.journal())
        if not reached(seen, await of.names(at), asked):
            run.fails(reply, "illegal_address", "invalid_input", outcome=NOTHING_SENT, requirement="ERR-002")
            return
        told = {"trace": trace} if trace else {}
        run.fails(reply, "illegal_address", **told, requirement="ERR-002")
        run.witnessed(refused(seen))

    return steps


def there(of: Further, task: Task, *, read: Of[Asked], beyond: Asked) -> None:
    """Register, after the item that reads what is missing, a read of what is there and one across the end of it."""

    @of.after(task)
    async def what_is_there_can_be_read_and_nothing_follows_the_end(run: Repetition, at: Rig) -> None:
        """Read a value that is there: a refusal proves something only if the same call works elsewhere. Then read a value of which
        a part lies behind the end.

        Said: success and the value; then a failure with `illegal_address`, `invalid_input` or `limit_exceeded`.
        """
        asked = read(run)
        await set_up(at, asked)
        run.succeeds(await call(at, asked), **asked.outputs)
        if at.subject.claims(beyond.operation):
            codes = ("illegal_address", "invalid_input", "limit_exceeded")
            run.fails(await call(at, beyond), *codes, requirement="RD-007", code_requirement="ERR-002")


async def another_answers(
    run: Repetition,
    at: Rig,
    asked: Asked,
    rule: Mapping[str, object],
    *codes: str,
    must_fail: Callable[[Entries], bool] | None = None,
) -> None:
    """Read what is there; then while the device answers about something else; and again.

    Args:
        rule: of the fault plan.
        codes: with which the read may fail.
        must_fail: tells from the requests of the read whether its answer can be about something else; None where any can.
    """
    await set_up(at, asked)
    run.succeeds(await call(at, asked), **asked.outputs)
    await at.device.fault(rule)
    mixed = await call(at, asked)
    await at.device.fault()
    if must_fail is None or must_fail(mixed.during(await at.journal())):
        run.fails(mixed, *codes, requirement="RD-005", code_requirement="ERR-002")
    run.succeeds(await call(at, asked), **asked.outputs)


async def not_sent(of: Further, run: Repetition, at: Rig, asked: Asked, *codes: str, requirement: str) -> None:
    """Write what the adapter has to refuse by itself, and expect that nothing is sent."""
    before = await at.device.image()
    reply = await call(at, asked)
    run.fails(reply, *codes, outcome="not_sent", requirement=requirement)
    run.witnessed(
        of.witness.nothing_changed(await at.journal(), requirement=untold(reply, requirement)),
        of.witness.only_changed(before, await at.device.image(), {}, otherwise=untold(reply, requirement)),
    )


def refused_by_itself(
    of: Further,
    id: str,
    title: str,
    *,
    needs: str,
    make: Of[Asked],
    codes: str = "type_mismatch invalid_input",
    requirements: str = "ADR-004 ERR-006",
    **told: str,
) -> Task:
    """Declare the item that writes a value of another type, or one that does not fit.

    Args:
        codes: with which the write may fail.
        requirements: of the item; the first is the one that a write which is not refused breaks.
    """
    first = requirements.split()[0]
    said = f"A failure with {' or '.join(f'`{code}`' for code in codes.split())}, and the outcome `not_sent`."

    @of.item(
        id, "fault", title, needs=needs, capability="refusing", requirements=requirements, told={"said": said, **told}
    )
    async def steps(run: Repetition, at: Rig) -> None:
        """Write a value that the target cannot hold.

        Said: a failure that says so, and the outcome `not_sent`.
        Seen: no request that changes the plant; {device} holds what it held.
        Why: whatever the value becomes when it is made to fit, nobody asked for that.
        """
        await not_sent(of, run, at, make(run), *codes.split(), requirement=first)

    return steps


def overflow(
    of: Further,
    id: str,
    title: str,
    *,
    needs: str,
    make: Of[Asked],
    fits: Callable[[Repetition, Rig], Asked],
    requirements: str = "ADR-003 ADR-004 ERR-006",
    **told: str,
) -> Task:
    """Declare the item that writes a value beyond the largest one.

    Args:
        make: the write that does not fit.
        fits: the write of the largest value.
    """
    task = refused_by_itself(
        of, id, title, needs=needs, make=make, codes="range_overflow", requirements=requirements, **told
    )

    @of.after(task)
    async def the_largest_value_is_accepted(run: Repetition, at: Rig) -> None:
        """Write the largest value that fits, or that the tool's own schema allows.

        Said: success.
        Seen: one write, and {device} holds the value.
        """
        await at.stays_quiet(QUIET_S, partial(of.witness.nothing_changed, requirement="ADR-003"))
        asked = fits(run, at)
        run.succeeds(await call(at, asked), **asked.outputs)
        await of.sees_and_holds(run, at, asked)

    return task


def four_at_once(of: Further, id: str, title: str, *, needs: str, make: Of[Sequence[Asked]], **told: str) -> Task:
    """Declare the item that makes four reads at the same time."""

    @of.item(id, "stress", title, needs=needs, capability="load", requirements="CON-001", told=told)
    async def steps(run: Repetition, at: Rig) -> None:
        """Read four values by four calls at the same time.

        Said: in each answer the value that its own call asks for.
        Seen: for each call a read of what it asks for, during the call.
        Why: an answer that belongs to another call is a wrong value that looks right.
        """
        asked = make(run)
        await set_up(at, *asked)
        image = await of.names(at)
        replies = await run.together(*(call(at, one) for one in asked))
        for reply, one in zip(replies, asked, strict=True):
            run.succeeds(reply, **one.outputs)
        run.witnessed(of.seen(await at.journal(), image, *zip(replies, asked, strict=True)))

    return steps


def beside(
    of: Further, id: str, title: str, *, needs: str, make: Of[Contended], judge: Judge | None = None, **told: str
) -> Task:
    """Declare the item that reads and writes at the same time.

    Args:
        make: a read and one write. A read that has outputs is of something else, and has them whatever is written.
        judge: of the write; None is that of the protocol.
    """

    @of.item(id, "stress", title, needs=needs, capability="load", requirements="CON-004 WR-003", told=told)
    async def steps(run: Repetition, at: Rig) -> None:
        """Read a value and write it at the same time; where outputs cannot be read, read inputs beside the write.

        Said: the old value or the new one for the read, success for the write.
        Seen: one write; {device} holds the new value.
        Why: a mixture of two values, or a lost write, shows only under load.
        """
        pair = drawn_until(
            lambda: make(run), lambda one: at.excess(one.writes[0].operation, **one.writes[0].inputs) is None
        )
        (asked,) = pair.writes
        for poke in pair.pokes:
            await at.device.poke(**poke)
        read, written = await run.together(call(at, pair.read), call(at, asked))
        run.succeeds(read, **pair.read.outputs)
        if not pair.read.outputs:
            run.one_of(read, pair.output, pair.old, *pair.new)
        run.succeeds(written, **asked.outputs)
        await of.sees_and_holds(run, at, asked, judge)

    return steps


def rapid(of: Further, id: str, title: str, *, needs: str, make: Of[Sequence[Asked]], **told: str) -> Task:
    """Declare the item that reads many times in a row."""

    @of.item(id, "stress", title, needs=needs, capability="load", requirements="CON-006", told=told)
    async def steps(run: Repetition, at: Rig) -> None:
        """Read fifty times, one call after the other; values change before they are read.

        Said: the right value in every answer.
        Seen: for each call a read of what it asks for, during the call.
        Why: leaks, caches, connections and numbers of requests that are used up show in a long series only.
        """
        asked = make(run)
        image = await of.names(at)
        replies = []
        for one in asked:
            await set_up(at, one)
            reply = await call(at, one)
            run.succeeds(reply, **one.outputs)
            replies.append(reply)
        run.witnessed(of.seen(await at.journal(), image, *zip(replies, asked, strict=True)))

    return steps


def restart(of: Further, id: str, title: str, **witnesses: SeenByDevice) -> Task:
    """Declare the item that reads before, during and after an outage.

    Args:
        witnesses: as of :func:`~.common.survive_a_restart`.
    """

    @of.item(
        id,
        "stress",
        title,
        needs="any_read recovery",
        capability="outages",
        requirements="REC-001 REC-002 RD-004",
        keys="recovery",
    )
    async def steps(run: Repetition, at: Rig) -> None:
        """Read; again after {device} was stopped; and again after it was started.

        Said: success; then a failure with `connect_failed`, `connection_lost` or `timeout`; then success in the same
            session.
        Seen: a read after {device} is back.
        Why: an outage of the line must not need a person who restarts the adapter, and old values must not hide it.
        """
        await survive_a_restart(run, at, **witnesses)

    @of.after(steps)
    async def a_failed_write_is_not_delivered_later(run: Repetition, at: Rig) -> None:
        """Write while {device} is away, and read when it is back.

        Said: a failure for the write, success for the read.
        Seen: no write: what was reported as failed is not made up for.
        """
        await a_failed_write_is_not_made_up_for(run, at)

    return steps


def recovery(of: Further, title: str) -> Task:
    """Declare the item that measures the recovery from an outage."""

    @of.item(
        f"R-{of.protocol}",
        "recovery",
        title,
        needs="any_read",
        capability="outages",
        requirements="REC-001 REC-002 MCP-009",
        keys="recovery",
    )
    async def steps(run: Repetition, at: Rig) -> None:
        """Read; again after {device} was stopped; then, after it was started, in the same session and in a fresh one with
        a new process.

        Said: success; a failure of the connection; success in both sessions.
        Seen: the reads of both sessions, and nothing that changes the plant.
        Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
        """
        await outage(run, at)

    @of.after(steps)
    async def the_adapter_starts_without_its_device(run: Repetition, at: Rig) -> None:
        """Start the adapter while {device} is down, ask, and ask again when it is there.

        Said: a failure of the connection first, success then.
        """
        await start_without_device(run, at)

    return steps


def usual(of: Further, letter: str, *, sensors: Sequence[Point], target: Point) -> None:
    """Declare, with plain titles, the items for which points that are read and one that is written are enough: T1 to T3 and ST1 to ST3 for
    the letter T.

    Args:
        sensors: two points or more, which hold whole numbers; the target is none of them.
        target: is read and written by an operation each.
    """
    reading, writing = target.reads().operation, target.writes(None).operation
    both, read = f"{writing} {reading}", sensors[0]

    def many(run: Repetition, count: int) -> list[Asked]:
        known = [point.any(run.rng) for point in sensors]
        return [known[index % len(known)] for index in range(count)]

    reads(of, f"{letter}1", "Read values.", needs=reading, make=lambda run: many(run, len(sensors)))
    reads_back(
        of,
        f"{letter}2",
        "Write a value and read it back for verification.",
        needs=both,
        write=lambda run: target.write(40 + run.rep),
        read=target.read_again,
    )
    guard(
        of,
        f"{letter}3",
        "Attempt a write with writes disabled and expect a guarded rejection.",
        needs=both,
        write=lambda run: target.write(99),
        read=lambda run: read.reads(),
    )
    four_at_once(of, f"S{letter}1", "Four concurrent reads.", needs=reading, make=lambda run: many(run, 4))
    beside(
        of,
        f"S{letter}2",
        "Concurrent read and write of one value.",
        needs=both,
        make=lambda run: target.contended(*run.rng.sample(range(100, 128), 2)),
    )
    rapid(of, f"S{letter}3", "Fifty reads in a row.", needs=reading, make=lambda run: many(run, RAPID_CALLS))
