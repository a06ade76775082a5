"""Steps and windows that the tasks of several protocols share: outages, restarts, recovery."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.protocols.session_oracle import Exchanges
from pytest_otmcp.protocols.unsolicited import nothing_commanded
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

__all__ = [
    "CONNECTION_FAULTS",
    "NOTHING_SENT",
    "QUIET_S",
    "RAPID_CALLS",
    "UNCERTAIN",
    "Witness",
    "a_delay_shows",
    "a_failed_write_is_not_made_up_for",
    "a_meaningless_switch_enables_nothing",
    "allowed_first",
    "drawn",
    "ends_when_its_stdin_closes",
    "fresh",
    "outage",
    "start_without_device",
    "status_is_known",
    "survive_a_restart",
    "untold",
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

Asked = tuple[str, Mapping[str, Any]]
"""An operation and its inputs."""


def drawn(at: Rig, operation: str, draw: Callable[[], T], inputs: Callable[[T], Mapping[str, Any]]) -> T:
    """Return what is drawn at random, drawn anew until the schema of the tool allows the operation with these inputs of it.

    A bound of its own, such as a smaller maximum, is an adapter's choice; what never lies within its bounds is the first draw.
    """
    first = one = draw()
    for _ in range(_DRAWS):
        if at.excess(operation, **inputs(one)) is None:
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


async def survive_a_restart(run: Repetition, rig: Rig, operation: str, **inputs: Any) -> Reply:
    """Perform the operation before, during and after an outage of the endpoint, assert all three, and return the last reply.

    After the outage it must succeed within the time that the subject declares; how soon it did is a figure of the report.
    """
    warm = await rig.call(operation, **inputs)
    run.succeeds(warm)
    stop_ms = await rig.stop_device()
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
    attempts = await rig.call_until_success(operation, window_s=rig.recovery_s, **inputs)
    last = attempts[-1]
    run.succeeds(last, requirement="REC-001")
    run.phases = {
        "warm_call": warm.latency_ms,
        "stop": stop_ms,
        "detect": failing.latency_ms,
        "restart": restart_ms,
        "same_session": milliseconds(rig.accepting_ns, last.exchange.received_ns) if last.success else None,
        "same_session_attempts": len(attempts),
        "same_session_ok": bool(last.success),
        "fresh_session": None,
        "fresh_session_ok": None,
    }
    return last


def _noticing_s(rig: Rig, operation: str) -> float:
    """Return how long a status may still say "connected"."""
    return max(NOTICING_S, rig.max_age_s(operation) or 0.0)


def fresh(journal: Entries, *asked: tuple[Reply, Witness]) -> list[Finding]:
    """Expect that during each call the device witnessed it; return the findings about the first of which it did not."""
    for reply, witness in asked:
        if findings := witness(reply.during(journal)):
            return findings
    return []


async def status_is_known(run: Repetition, rig: Rig, witness: Witness, *replies: Reply) -> None:
    """Expect that each status was asked for during its call; a declared cache may answer, and says truthfully how old that is."""
    max_age_s = rig.max_age_s(replies[0].operation)
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
    await rig.delay(DELAY_S)
    run.succeeds(await rig.call(operation, **inputs))
    await rig.delay(0)


async def outage(run: Repetition, rig: Rig, operation: str, witness: Witness, **inputs: Any) -> None:
    """Measure one trial: warm call, outage, failing call, restart, same session, fresh session.

    Two ways of recovery are measured and never mixed: the same session, which the assistant already has, and a fresh session
    with a process of its own. The time of the same session counts from the moment at which the endpoint accepts connections,
    that of the fresh session from the start of its process. Both are judged at the device.
    """
    warm = await rig.call(operation, **inputs)
    run.must_succeed(warm)
    # A command that an earlier item asked for must not arrive now.
    run.witnessed(nothing_commanded(rig.protocol, await rig.journal(), rig.declared))
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
    failing = await rig.call_until_failure(operation, window_s=_noticing_s(rig, operation), **inputs)
    run.fails(failing, *CONNECTION_FAULTS, requirement="REC-002")
    phases["detect"] = failing.latency_ms
    phases["restart"] = await rig.start_device()

    # An adapter that only claims to work in a new session is not tested in the same session.
    if rig.claims("recovery"):
        attempts = await rig.call_until_success(operation, window_s=rig.recovery_s, **inputs)
        recovered = attempts[-1]
        phases["same_session_attempts"] = len(attempts)
        if run.succeeds(recovered, requirement="REC-001"):
            run.witnessed(witness(await rig.journal()))
        if recovered.success:
            phases["same_session"] = milliseconds(rig.accepting_ns, recovered.exchange.received_ns)
            phases["same_session_ok"] = True

    fresh = await rig.fresh_session()
    first = await rig.call(operation, **inputs)
    run.succeeds(first)
    run.witnessed(witness(await rig.session_journal()))
    run.witnessed(nothing_commanded(rig.protocol, await rig.journal(), rig.declared))
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
    commanded = nothing_commanded(guarded.protocol, await guarded.journal(), guarded.declared)
    run.witnessed([replace(finding, requirement="WR-005") for finding in commanded])


async def ends_when_its_stdin_closes(rig: Rig) -> None:
    """End the adapter's process by the end of its stdin, which is judged, and start it anew."""
    await rig.fresh_session()


async def start_without_device(run: Repetition, rig: Rig, operation: str, **inputs: Any) -> None:
    """Start the adapter while its device is down: it has to start, to say what is wrong, and to work when the device is there."""
    # A step that connects cannot succeed now, so there is no session to ask.
    if not rig.reconnects:
        return
    await rig.stop_device()
    await rig.fresh_session()
    run.fails(await rig.call(operation, **inputs), *CONNECTION_FAULTS, requirement="REC-002")
    await rig.start_device()
    if rig.claims("recovery"):
        attempts = await rig.call_until_success(operation, window_s=rig.recovery_s, **inputs)
        run.succeeds(attempts[-1], requirement="REC-001")


async def a_failed_write_is_not_made_up_for(
    run: Repetition, rig: Rig, nothing_changed: Callable[..., list[Finding]], *, write: Asked, read: Asked
) -> None:
    """Write while the device is away, and read when it is back: what was reported as failed must not be sent later.

    Args:
        nothing_changed: the protocol's oracle ``(journal, requirement=…)`` that no request changes the device.
        write, read: operations with their inputs.
    """
    writing, value = write
    reading, place = read
    if not rig.claims(writing):
        return
    await rig.prove()
    await rig.stop_device()
    reply = await rig.call(writing, **value)
    run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN, requirement="WR-001", code_requirement="REC-002")
    await rig.start_device()
    # An adapter that answers again has its connection back: a write that it had kept for later would have been sent by now.
    last = (await rig.call_until_success(reading, window_s=rig.recovery_s, **place))[-1]
    run.succeeds(last, requirement="REC-001")
    await rig.stays_quiet(QUIET_S, partial(nothing_changed, requirement="WR-010"))
    # A further answer shows that adapter and device ran during that time.
    run.succeeds(await rig.call(reading, **place), requirement="REC-001")
    run.witnessed(nothing_changed(await rig.journal(), requirement="WR-010"))


def milliseconds(begin_ns: int, end_ns: int | None) -> float | None:
    return None if end_ns is None else (end_ns - begin_ns) / 1e6
