"""TMO: time limits and cancellation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.text import counted
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.journal import Entries, JournalEntry
from pytest_otmcp.protocols.protocol import TIMES
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.expectations import failed
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .steps import (
    CONNECTION_FAULTS,
    QUIET_S,
    a_read_works,
    a_write_works,
    answers_again,
    citing,
    exercise,
    faulty,
    polls,
    silence,
    since,
    vanishing,
)

__all__ = ["TASKS"]

TASKS = Checks()

_WAITED = ("rate_limited", "device_busy")
"""What a call is told that had no turn before its time was over."""

_DRIP_S = 1.5
"""Seconds between two bytes of an answer, so that no answer is complete within a usual deadline."""

_QUEUED_S, _QUEUED_BEHIND_S = 0.1, 0.4
_SEEN_S = 2.0
_WATCHED_S = {False: 4.0, True: 60.0}
"""How long a device that refuses connections is watched in the short and in the long form."""
_MOST_ATTEMPTS = {False: 15, True: 30}
"""Attempts to connect meanwhile: 30 in a minute. Pauses that grow use up less than half of them in the first seconds: those that double
from a millisecond on make 12 attempts, those of a quarter of a second 16."""


# -- time limits --------------------------------------------------------------------------------------------


@TASKS.every_protocol("TMO-001", "Every call is answered within the deadline.")
async def every_call_ends_in_time(run: Repetition, at: Rig) -> None:
    """Read by two calls at the same time; the connection of the first dies without an end, and what is answered afterwards comes
    byte by byte. Read again when that is over.

    Said: failures of the connection within the deadline, one of them `rate_limited` or `device_busy` where it waited behind the other; then
        success.
    Seen: the reads.
    Why: an assistant that waits for ever cannot tell anybody that the plant is out of reach.
    """
    await a_read_works(run, at)
    asks = exercise(at)
    await at.device.fault(
        *({**condition, "times": 1, "action": vanishing(at)} for condition in asks.reads[:1]),
        *faulty(asks.reads, **({"drip_s": _DRIP_S} if protocols()[at.protocol].has_connections else silence(at))),
    )
    asked = asks.read(run.rng)
    for poke in asked.pokes:
        await at.device.poke(**poke)
    replies = await run.together(*(at.call(asked.operation, **asked.inputs) for _ in range(2)))
    await at.device.fault()
    # One call may have waited behind the other until its time was over: nothing of it was sent, and it was not the device that failed it.
    waited = [reply.error_code in _WAITED for reply in replies].count(True) == 1
    codes = (*CONNECTION_FAULTS, "protocol_error", *(_WAITED if waited else ()))
    for reply in replies:
        # An adapter with a long deadline may have asked again, or waited for all the bytes.
        if reply.success:
            run.succeeds(reply, requirement="TMO-001", **asked.outputs)
        else:
            run.fails(reply, *codes, requirement="TMO-001", code_requirement="ERR-005")
    await answers_again(run, at)


@TASKS.every_protocol(
    "TMO-002", "A call to a silent device ends in time, and is repeated no more often than it says.", beside=TIMES
)
async def repetitions_are_bounded(run: Repetition, at: Rig, retimed: Rig | None = None) -> None:
    """Read while the device is silent, and again when it is not. The same where the adapter was told other time limits and numbers of
    repetitions, if the subject file has such a launch.

    Said: a failure of the connection within the deadline, with the number of attempts; then success. With the other settings within the
        time that the subject file says of them.
    Seen: the same request no more often than that; with the other settings as often as the subject file says.
    Why: repetitions of the adapter and of its library multiply; a device that is slow already is asked twelve times. A setting that has
        no effect is found out when the plant stands still.
    """
    await a_read_works(run, at)
    reply, same = await _read_in_silence(run, at)
    # Who polls does so again when the device answers again.
    await answers_again(run, at)
    attempts = _attempts(reply)
    if attempts is not None and len(same) > attempts and not await polls(at, same):
        message = f"{reply.label}: meta.attempts says {attempts}, the device saw the same request {len(same)} times"
        run.finding("repeated", message, "TMO-002", evidence=protocols()[at.protocol].seen(same))
    if retimed is not None:
        await _settings_have_their_effect(run, retimed)


async def _read_in_silence(run: Repetition, at: Rig) -> tuple[Reply, list[JournalEntry]]:
    """Return the reply to a read while the device is silent, and the equal requests that the device saw."""
    await at.device.fault(*faulty(exercise(at).reads, **silence(at)))
    asked = exercise(at).read(run.rng)
    reply = await at.call(asked.operation, **asked.inputs)
    await at.device.fault()
    run.fails(reply, *CONNECTION_FAULTS, requirement="TMO-002", code_requirement="ERR-005")
    return reply, _repeated(at, reply.during(await at.journal()))


async def _settings_have_their_effect(run: Repetition, at: Rig) -> None:
    """Read with other settings while the device is silent: the time, and the requests, are those that the subject file says of them. With
    short time limits a call may fail because something stood still, so what works is asked for until it does; and what is wrong is
    wrong twice."""
    await answers_again(run, at)
    found: list[Finding] = []
    for _ in range(2):
        found = await _ignored_settings(run, at)
        if not found:
            return
    run.witnessed(found)


async def _ignored_settings(run: Repetition, at: Rig) -> list[Finding]:
    times = at.subject.times
    assert times is not None
    reply, same = await _read_in_silence(run, at)
    await answers_again(run, at)
    deadline_ms = times.deadline_s * at.time_scale * 1000
    said = f"{reply.label}: with the settings of the launch 'retimed'"
    found = []
    if reply.latency_ms is not None and reply.latency_ms > deadline_ms:
        message = f"{said} a call to a silent device should end within {deadline_ms:.0f} ms, this one took {reply.latency_ms:.0f} ms"
        found.append(Finding(code="setting_ignored", message=message, requirement="TMO-002"))
    if times.attempts is not None and len(same) != times.attempts and not (same and await polls(at, same)):
        message = (
            f"{said} the device should have seen the same request {counted(times.attempts, 'time')}, "
            f"it saw it {counted(len(same), 'time')}"
        )
        evidence = protocols()[at.protocol].seen(same)
        found.append(Finding(code="setting_ignored", message=message, requirement="TMO-002", evidence=evidence))
    return found


def _attempts(reply: Reply) -> int | None:
    attempts = reply.member("meta", "attempts") if reply.native else None
    return attempts if isinstance(attempts, int) else None


def _repeated(at: Rig, entries: Entries) -> list[JournalEntry]:
    """Return the requests that read and are equal, of those that are there most often."""
    conditions = exercise(at).reads
    reading = [entry for entry in entries if entry["request"] and any(_meets(entry, one) for one in conditions)]
    describe = protocols()[at.protocol].describe
    most = Counter(map(describe, reading)).most_common(1)
    return [entry for entry in reading if most and describe(entry) == most[0][0]]


def _meets(entry: JournalEntry, condition: Mapping[str, object]) -> bool:
    """Tell whether a request, or one of the services that it holds, is what a condition of a fault plan is about; what reads changes
    nothing."""
    named = {name: value for name, value in condition.items() if not isinstance(value, bool)}
    services: Any = entry.get("items", ())
    held = [one.get("asks") for one in services]
    return not entry["state_changing"] and all(
        value in (entry["kind"], entry.get(name), *held) for name, value in named.items()
    )


# -- cancellation -------------------------------------------------------------------------------------------


@TASKS.every_protocol("TMO-003", "A call that was cancelled ends.", writes=True)
async def a_cancelled_call_ends(run: Repetition, at: Rig) -> None:
    """Cancel a read, and a write, that the device has taken and does not answer; then a write that came while a read was waiting.
    After each of them read; in the end write.

    Said: success for the calls that are not cancelled.
    Seen: for a call that was cancelled at most one request; one of a write should not come afterwards.
    Why: who cancels a command believes that it is over; a repetition moves the plant when nobody expects it.
    """
    asks = exercise(at)
    await a_write_works(run, at)
    await a_read_works(run, at)

    await at.device.fault(*faulty(asks.reads, **silence(at)))
    asked = asks.read(run.rng)
    reply = await at.call_and_cancel(asked.operation, seen={"request": True}, timeout_s=_SEEN_S, **asked.inputs)
    await at.device.fault()
    await at.watch(QUIET_S)
    same = _repeated(at, since(reply, await at.journal()))
    await answers_again(run, at)
    if len(same) > 1 and not await polls(at, same):
        _once(run, at, reply, same)

    await at.device.fault(*faulty(asks.writes, **silence(at)))
    asked = asks.write(run.rng)
    reply = await at.call_and_cancel(asked.operation, seen={"state_changing": True}, timeout_s=_SEEN_S, **asked.inputs)
    await _cancelled_write(run, at, asked, reply)

    # Of a session that is new nothing could be proven while its reads have no answer.
    await at.prove_first()
    await at.device.fault(*faulty(asks.reads, **silence(at)))
    reading, asked = asks.read(run.rng), asks.write(run.rng)
    _, reply = await run.together(
        at.call_and_cancel(reading.operation, seen={"kind": "none"}, timeout_s=_QUEUED_BEHIND_S, **reading.inputs),
        at.call_and_cancel(asked.operation, seen={"state_changing": True}, timeout_s=_QUEUED_S, **asked.inputs),
    )
    await _cancelled_write(run, at, asked, reply)
    await a_write_works(run, at)


async def _cancelled_write(run: Repetition, at: Rig, asked: Asked, reply: Reply) -> None:
    await at.device.fault()
    await at.watch(QUIET_S)
    await answers_again(run, at)
    _once(run, at, reply, exercise(at).done(since(reply, await at.journal()), asked))


def _once(run: Repetition, at: Rig, reply: Reply, found: Sequence[JournalEntry]) -> None:
    if len(found) > 1:
        message = f"{reply.label}: of a call that was cancelled the device should have seen at most one request, it saw {len(found)}"
        run.finding("repeated", message, "TMO-003", evidence=protocols()[at.protocol].seen(found))


@TASKS.every_protocol("TMO-004", "A write whose answer did not come has an unknown outcome.", writes=True, status=True)
async def the_outcome_is_unknown(run: Repetition, at: Rig) -> None:
    """Write while the device takes the request and does not answer.

    Said: a failure of the connection with the outcome `unknown`; or success where the adapter has found out that it was done.
    Seen: the write, which was carried out.
    Why: an assistant that reads "not sent" sends the command again, and the valve moves twice.
    """
    asks = exercise(at)
    await a_write_works(run, at)
    await at.device.fault(*faulty(asks.writes, **silence(at)))
    asked = asks.write(run.rng)
    reply = await at.call(asked.operation, **asked.inputs)
    await at.device.fault()
    if asks.done(since(reply, await at.journal()), asked) and not reply.success:
        found = failed(reply, *CONNECTION_FAULTS, outcome="unknown", code_requirement="ERR-005")
        run.judge(reply, citing("TMO-004", found))
    await answers_again(run, at)


# -- connecting again ---------------------------------------------------------------------------------------


@TASKS.check("TMO-005", "A lost connection is made anew with growing pauses.", needs="mqtt.subscribe mqtt.recovery")
async def connecting_again_has_pauses(run: Repetition, mqtt: Rig) -> None:
    """End the connection and reset every new one for four seconds, in the long form for a minute.

    Said: success when that is over.
    Seen: for each connection that has ended at most 15 attempts to connect again, in a minute at most 30.
    Why: a broker that comes back and is stormed by its clients goes down again.
    """
    await a_read_works(run, mqtt)
    before = await mqtt.journal()
    await mqtt.device.fault({"packet": "CONNECT", "action": {"reset": True}})
    await mqtt.device.poke(disconnect={"client_id": None, "reason_code": 139})
    watched_s = _WATCHED_S[run.soak]
    await mqtt.watch(watched_s)
    seen = (await mqtt.journal())[len(before) :]
    await mqtt.device.fault()
    attempts = [entry for entry in seen if entry["kind"] == "CONNECT"]
    # On a machine that stands still the device is watched for longer.
    attempts = [entry for entry in attempts if entry["t_ns"] - attempts[0]["t_ns"] <= watched_s * 1e9]
    tried = {entry["connection"] for entry in attempts}
    ended = {entry["connection"] for entry in seen if entry["kind"] == "DISCONNECTED"} - tried
    most = _MOST_ATTEMPTS[run.soak] * max(1, len(ended))
    if len(attempts) > most:
        message = f"mqtt: within {watched_s:g} s the adapter has tried to connect {len(attempts)} times, it should at most {most} times"
        run.witnessed([Finding(code="reconnects", message=message, requirement="TMO-005", strength="SHOULD")])
    await answers_again(run, mqtt)
