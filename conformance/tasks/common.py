"""Steps and windows that the tasks of several protocols share: outages, restarts, recovery."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols import oracle as device
from pytest_otmcp.protocols.exercise import READING, Asked
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.proof import Call
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.protocols.session_oracle import Exchanges
from pytest_otmcp.protocols.unsolicited import nothing_commanded
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..within import allowed, exercise

__all__ = [
    "CONNECTION_FAULTS",
    "NOTHING_SENT",
    "NOTICING_S",
    "QUIET_S",
    "RAPID_CALLS",
    "UNCERTAIN",
    "Witness",
    "a_delay_shows",
    "a_failed_write_is_not_made_up_for",
    "a_meaningless_switch_enables_nothing",
    "allowed_first",
    "drawn",
    "drawn_until",
    "each_fails",
    "each_write",
    "ends_when_its_stdin_closes",
    "fresh",
    "nothing_is_made_up_for",
    "outage",
    "start_without_device",
    "status_is_known",
    "survive_a_restart",
    "untold",
    "writes_fail",
]

T = TypeVar("T")

RAPID_CALLS = 50

_DRAWS = 5000
"""Draws to find a value that the schema of a tool allows: of 65536 values a hundred may be allowed."""

NOTICING_S = 1.0
"""Seconds for which a status may still say "connected" after the connection was cut (requirement REC-002: one keep-alive)."""

QUIET_S = 0.25
"""Seconds for which the device is watched, once per item, for a request that must not come."""

DELAY_S = 0.1
"""Seconds: well above a tick of the coarsest clock, well below every timeout."""

CONNECTION_FAULTS = ("connect_failed", "connection_lost", "timeout")
UNCERTAIN = ("not_sent", "unknown")
NOTHING_SENT = ("not_sent", "not_applicable")
"""Outcomes of a read that the adapter refuses by itself."""

TRANSIT_MS = 100.0
"""How much older than it says a cached status may be: the device answered before the adapter had read the answer."""

Witness = Callable[[Entries], list[Finding]]

ITS_OWN_REFUSALS = (
    "access_denied",
    "illegal_address",
    "invalid_input",
    "limit_exceeded",
    "not_born",
    "partial_failure",
    "unsupported_operation",
)
"""Codes by which an adapter may refuse a write to a target that it does not know, whether its device is there or not, or may fail a batch of
writes, each of which has its own reason."""


def drawn(at: Rig, operation: str, draw: Callable[[], T], inputs: Callable[[T], Mapping[str, Any]]) -> T:
    """Return what is drawn at random, drawn anew until the schema of the tool allows the operation with these inputs of it.

    A bound of its own, such as a smaller maximum, is an adapter's choice; what never lies within its bounds is the first draw.
    """
    return drawn_until(draw, lambda one: at.excess(operation, **inputs(one)) is None)


def drawn_until(draw: Callable[[], T], fits: Callable[[T], bool]) -> T:
    """Return what is drawn at random, drawn anew until it fits; what never does is the first draw."""
    first = one = draw()
    for _ in range(_DRAWS):
        if fits(one):
            return one
        one = draw()
    return first


def untold(reply: Reply, otherwise: str) -> str:
    """Return the requirement that a change at the device breaks, which should not have come of a call: ERR-006 where the reply says that
    nothing was sent, or that the device has rejected it.

    Args:
        otherwise: the requirement by which the call had to be refused; a reply that says nothing of the kind tells no untruth about it.
    """
    told = reply.native and reply.member("error", "outcome") in ("not_sent", "rejected")
    return "ERR-006" if told else otherwise


def allowed_first(at: Rig, operation: str, values: Sequence[T], inputs: Callable[[T], Mapping[str, Any]]) -> T:
    """Return the first of these values that the schema of the tool allows; the first of all where it allows none."""
    return next((one for one in values if at.excess(operation, **inputs(one)) is None), values[0])


def outages_show(rig: Rig) -> bool:
    """Tell whether the adapter has an operation that its device has to answer, so that it fails in an outage."""
    return next(_bound_reads(rig), None) is not None


def _bound_reads(rig: Rig) -> Iterator[Call]:
    # Any example of the inputs tells whether there is a tool for them.
    return (call for call in rig.proof.unreachable if rig.can_ask(call.operation, call.made(random.Random(0))))


def read_of(rig: Rig) -> Call:
    """Return the call by which an adapter is taken through an outage: the best that it has of those that its device has to answer."""
    calls = rig.proof.unreachable
    return next(_bound_reads(rig), None) or next(call for call in calls if rig.subject.claims(call.operation))


def _witness(rig: Rig, read: Call, witnesses: Mapping[str, Witness]) -> Witness:
    exchange = some_exchange(rig)
    return exchange if READING in read.inputs else witnesses.get(read.operation, exchange)


async def asked_anew(run: Repetition, rig: Rig, read: Call) -> Mapping[str, Any]:
    """Return the inputs of the next call to a device that is there, which has something to bring."""
    inputs = read.made(run.rng)
    for poke in read.brings(inputs):
        await rig.device.poke(**poke)
    return inputs


async def survive_a_restart(run: Repetition, rig: Rig, **witnesses: Witness) -> None:
    """Read before, during and after an outage of the endpoint, with the read that the adapter has, and assert all three.

    After the outage it must succeed within the time that the subject declares; how soon it did is a figure of the report.

    Args:
        witnesses: by operation, what the device must have seen of the last read; of another operation, any exchange.
    """
    read = read_of(rig)
    operation = read.operation
    warm = await rig.call(operation, **await asked_anew(run, rig, read))
    run.succeeds(warm)
    stop_ms = await rig.stop_device()
    inputs = read.made(run.rng)
    failing = await rig.call_until_failure(operation, window_s=_noticing_s(rig, operation), **inputs)
    told = run.fails(failing, *CONNECTION_FAULTS, requirement="REC-002")
    if told and protocols()[rig.protocol].has_connections:
        # An adapter that knows that its connection is gone makes a new one, which is refused. One whose call timed out, or that
        # says nothing that can be told apart, may find only now that the connection is lost.
        knows = failing.error_code in ("connect_failed", "connection_lost")
        codes = ("connect_failed",) if knows else ("connect_failed", "connection_lost")
        refused = await rig.call(operation, role="control", **inputs)
        run.fails(refused, *codes, requirement="REC-002", code_requirement="ERR-005")
    restart_ms = await rig.start_device()
    inputs = await asked_anew(run, rig, read)
    attempts = await rig.call_until_success(operation, window_s=rig.subject.recovery_s, **inputs)
    last = attempts[-1]
    run.succeeds(last, requirement="REC-001")
    run.phases = {
        "warm_call": warm.latency_ms,
        "stop": stop_ms,
        "detect": failing.latency_ms,
        "restart": restart_ms,
        "same_session": milliseconds(rig.device.accepting_ns, last.exchange.received_ns) if last.success else None,
        "same_session_attempts": len(attempts),
        "same_session_ok": bool(last.success),
        "fresh_session": None,
        "fresh_session_ok": None,
    }
    if not last.success:
        return
    if protocols()[rig.protocol].operations[operation].status:
        await status_is_known(run, rig, some_exchange(rig), last)
    else:
        run.witnessed(fresh(await rig.journal(), (last, _witness(rig, read, witnesses))))


def some_exchange(rig: Rig) -> Witness:
    """Return the check that the device has answered a request."""
    return device.Witness(noun="the device", describe=protocols()[rig.protocol].describe).answered


def _noticing_s(rig: Rig, operation: str) -> float:
    """Return how long a status may still say "connected"."""
    return max(NOTICING_S, rig.subject.max_age_s(operation) or 0.0)


def fresh(journal: Entries, *asked: tuple[Reply, Witness]) -> list[Finding]:
    """Expect that during each call the device witnessed it; return the findings about the first of which it did not.

    A failure tells nothing that could be stale.
    """
    for reply, witness in asked:
        if reply.success and (findings := witness(reply.during(journal))):
            return findings
    return []


async def status_is_known(run: Repetition, rig: Rig, witness: Witness, *replies: Reply) -> None:
    """Expect that each status was asked for during its call; a declared cache may answer, and says truthfully how old that is."""
    max_age_s = rig.subject.max_age_s(replies[0].operation)
    if max_age_s is None:
        run.witnessed(fresh(await rig.journal(), *((reply, witness) for reply in replies)))
        return
    exchanges = await rig.follow(Exchanges)
    for reply in replies:
        if findings := _cached(reply, max_age_s, exchanges):
            # The same lie fifty times is one.
            run.judge(reply, findings)
            return


def _cached(reply: Reply, max_age_s: float, exchanges: Exchanges) -> list[Finding]:
    meta = (reply.envelope or {}).get("meta")
    told = meta if isinstance(meta, dict) else {}
    source, age_ms = told.get("source"), told.get("age_ms")
    asked_ns, answered_ns = reply.exchange.sent_ns, reply.exchange.received_ns or 0
    if source == "device":
        problem = None if exchanges.between(asked_ns, answered_ns) else "it was not asked during the call"
    elif source != "cache" or not isinstance(age_ms, int | float):
        problem = f"the reply says source {source!r} and age_ms {age_ms!r}"
    elif age_ms > max_age_s * 1000:
        problem = f"the reply says that it is {age_ms} ms old, {max_age_s:g} s are declared"
    else:
        learned_ns = asked_ns - int((age_ms + TRANSIT_MS) * 1e6)
        problem = (
            None if exchanges.between(learned_ns, answered_ns) else f"it is older than the {age_ms} ms that it claims"
        )
    if problem is None:
        return []
    return [
        Finding(
            code="wrong_age",
            message=f"{reply.label}: the status should be the device's, or from a cache that says how old it is; {problem}",
            requirement="RD-004",
        )
    ]


async def a_delay_shows(run: Repetition, rig: Rig, operation: str, **inputs: Any) -> None:
    """Perform an operation while the device answers late; that the envelope says how late is judged in every call."""
    await rig.device.delay(DELAY_S)
    run.succeeds(await rig.call(operation, **inputs))
    await rig.device.delay(0)


async def outage(run: Repetition, rig: Rig, **witnesses: Witness) -> None:
    """Measure one trial with the read that the adapter has: warm call, outage, failing call, restart, same session, fresh session.

    Two ways of recovery are measured and never mixed: the same session, which the assistant already has, and a fresh session
    with a process of its own. The time of the same session counts from the moment at which the endpoint accepts connections,
    that of the fresh session from the start of its process. Both are judged at the device, with ``witnesses`` as in
    :func:`survive_a_restart`.
    """
    read = read_of(rig)
    operation = read.operation
    witness = _witness(rig, read, witnesses)
    warm = await rig.call(operation, **await asked_anew(run, rig, read))
    run.must_succeed(warm)
    # A command that an earlier item asked for must not arrive now.
    run.witnessed(nothing_commanded(rig.protocol, await rig.journal(), rig.subject.declared))
    # From here on the outage has been reached, whatever does not come after it.
    stop_ms = await rig.stop_device()
    run.phases = {
        "warm_call": warm.latency_ms,
        "stop": stop_ms,
        "detect": None,
        "restart": None,
        "same_session": None,
        "same_session_attempts": 0,
        "same_session_ok": False,
        "fresh_session": None,
        "fresh_session_ok": False,
    }
    phases = run.phases
    inputs = read.made(run.rng)
    failing = await rig.call_until_failure(operation, window_s=_noticing_s(rig, operation), **inputs)
    run.fails(failing, *CONNECTION_FAULTS, requirement="REC-002")
    phases["detect"] = failing.latency_ms
    phases["restart"] = await rig.start_device()

    # An adapter that only claims to work in a new session is not tested in the same session.
    if rig.subject.claims("recovery"):
        inputs = await asked_anew(run, rig, read)
        attempts = await rig.call_until_success(operation, window_s=rig.subject.recovery_s, **inputs)
        recovered = attempts[-1]
        phases["same_session_attempts"] = len(attempts)
        if run.succeeds(recovered, requirement="REC-001"):
            run.witnessed(witness(await rig.journal()))
        if recovered.success:
            phases["same_session"] = milliseconds(rig.device.accepting_ns, recovered.exchange.received_ns)
            phases["same_session_ok"] = True

    fresh = await rig.fresh_session()
    first = await rig.call(operation, **await asked_anew(run, rig, read))
    run.succeeds(first)
    run.witnessed(witness(await rig.session_journal()))
    run.witnessed(nothing_commanded(rig.protocol, await rig.journal(), rig.subject.declared))
    if first.success:
        phases["fresh_session"] = milliseconds(fresh.spawned_ns, first.exchange.received_ns)
        phases["fresh_session_ok"] = True


async def a_meaningless_switch_enables_nothing(run: Repetition, guarded: Rig, operation: str, **inputs: Any) -> None:
    """Start the adapter, whose session has been closed, with a write switch that means nothing, and let it write."""
    # A guard that leaks has been found out, whatever the word in its switch.
    if any(finding.requirement == "WR-004" for finding in run.ledger.findings) or not await guarded.garble_switch():
        return
    run.fails(await guarded.call(operation, **inputs), "writes_disabled", outcome="not_sent", requirement="WR-005")
    await guarded.close_session()
    commanded = nothing_commanded(guarded.protocol, await guarded.journal(), guarded.subject.declared)
    run.witnessed([replace(finding, requirement="WR-005") for finding in commanded])


async def ends_when_its_stdin_closes(rig: Rig) -> None:
    """End the adapter's process by the end of its stdin, which is judged, and start it anew."""
    await rig.fresh_session()


async def start_without_device(run: Repetition, rig: Rig) -> None:
    """Start the adapter while its device is down: it has to start, to say what is wrong, and to work when the device is there.

    An adapter that needs a new session after an outage then writes during one; the others do that where they read in one session.
    """
    # A step that connects cannot succeed now, so there is no session to ask.
    if rig.subject.reconnects:
        read = read_of(rig)
        await rig.stop_device()
        await rig.fresh_session()
        failing = await rig.call(read.operation, **read.made(run.rng))
        run.fails(failing, *CONNECTION_FAULTS, requirement="REC-002")
        await rig.start_device()
        if rig.subject.claims("recovery"):
            inputs = await asked_anew(run, rig, read)
            attempts = await rig.call_until_success(read.operation, window_s=rig.subject.recovery_s, **inputs)
            run.succeeds(attempts[-1], requirement="REC-001")
    if not rig.subject.claims("recovery"):
        await rig.fresh_session()
        await a_failed_write_is_not_made_up_for(run, rig)


async def a_failed_write_is_not_made_up_for(run: Repetition, rig: Rig) -> None:
    """Write by every operation that writes while the device is away, and read when it is back: what was reported as failed must not be
    sent later."""
    if await writes_fail(run, rig):
        await rig.start_device()
        await nothing_is_made_up_for(run, rig)


async def writes_fail(run: Repetition, rig: Rig) -> bool:
    """Stop the device and write once by every operation that writes; return whether the adapter has any, and else leave the device as it
    is."""
    writes = each_write(run, rig)
    if not writes:
        return False
    await rig.prove()
    await rig.stop_device()
    await each_fails(run, rig, writes)
    return True


def each_write(run: Repetition, rig: Rig) -> list[Asked]:
    """Return one write by every operation that writes and that the adapter has, with inputs that the schema of its tool allows."""
    every = [] if protocols()[rig.protocol].exercise is None else exercise(rig).each_write(run.rng)
    return [asked for asked in every if rig.can_ask(asked.operation, asked.inputs) and allowed(rig, asked)]


async def each_fails(run: Repetition, rig: Rig, writes: Iterable[Asked], *, code_requirement: str = "REC-002") -> None:
    """Write while the device is away, in a session that was proven before, and expect that each write fails.

    Args:
        code_requirement: id of the requirement that another error code breaks.
    """
    exercise = protocols()[rig.protocol].exercise
    for asked in writes:
        # The target of the usual write is one that every task writes to; an adapter may not know those of the others.
        usual = exercise is not None and asked.operation == exercise.writing
        refusals = () if usual else ITS_OWN_REFUSALS
        reply = await rig.call(asked.operation, **asked.inputs)
        run.fails(
            reply,
            *CONNECTION_FAULTS,
            *refusals,
            outcome=UNCERTAIN,
            requirement=protocols()[rig.protocol].operations[asked.operation].requirement,
            code_requirement=code_requirement,
        )


async def nothing_is_made_up_for(run: Repetition, rig: Rig) -> None:
    """Read, as the device is back after writes have failed, and expect that none of them comes then."""
    if not rig.subject.claims("recovery"):
        await rig.fresh_session()
    read = read_of(rig)
    # An adapter that answers again has its connection back: a write that it had kept for later would have been sent by now.
    inputs = await asked_anew(run, rig, read)
    last = (await rig.call_until_success(read.operation, window_s=rig.subject.recovery_s, **inputs))[-1]
    run.succeeds(last, requirement="REC-001")
    await rig.stays_quiet(QUIET_S, partial(_nothing_late, rig))
    # A further answer shows that adapter and device ran during that time.
    run.succeeds(await rig.call(read.operation, **await asked_anew(run, rig, read)), requirement="REC-001")
    run.witnessed(_nothing_late(rig, await rig.journal()))


def _nothing_late(rig: Rig, entries: Entries) -> list[Finding]:
    late = nothing_commanded(rig.protocol, entries, rig.subject.declared)
    return [replace(finding, requirement="WR-010") for finding in late]


def milliseconds(begin_ns: int, end_ns: int | None) -> float | None:
    return None if end_ns is None else (end_ns - begin_ns) / 1e6
