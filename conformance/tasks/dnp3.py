"""The tasks on DNP3.

Each function is one repetition, as in :mod:`.modbus`. The inputs that tasks set have no events, but for those of the tasks on events.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from pytest_otmcp.protocols.dnp3 import calls, oracle
from pytest_otmcp.protocols.dnp3.points import OUTSTATION, analog, latch, named, several
from pytest_otmcp.protocols.exercise import Asked, Contended
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from . import further
from .common import NOTHING_SENT, QUIET_S, RAPID_CALLS, fresh, untold

__all__ = ["TASKS"]

FIRST_ANALOG, FIRST_BINARY = 1, 8
"""The first analog and the first binary input without events."""
EVENT_INPUT, STALE_INPUT = 3, 6
"""The binary input whose changes are events of class 1; the analog input that is off line."""
EVENT_POINT = oracle.point("binary_input", EVENT_INPUT)
LATCH, LOCAL_OUTPUT = 2, 5
SETPOINT, LIMITED = named("otmcp_setpoint"), named("otmcp_limited")
OPERATE, DIRECT_OPERATE = 4, 5
PARAMETER_ERROR, OBJECT_UNKNOWN = 0x0400, 0x0200
TIMED_OUT, NOT_SUPPORTED, LOCALLY, OUT_OF_RANGE = 1, 4, 7, 12
CONFIRMED_S = 1.0
"""Seconds within which a confirmation that was sent has arrived."""


TASKS = further.Further("dnp3", witness=oracle.WITNESS, was_read=calls.was_read, one_write=calls.one_write)


def latched(value: bool) -> Asked:
    """Return the command that latches the binary output."""
    return latch(LATCH).write(value, before=not value)


def drawn(run: Repetition, count: int) -> list[int]:
    """Return values for analog inputs."""
    return run.rng.sample(range(-(2**31), 2**31), count)


def some_analog(run: Repetition, count: int) -> list[Asked]:
    """Return the reads of analog inputs, which are set at random."""
    return [analog(FIRST_ANALOG + place).read(value) for place, value in enumerate(drawn(run, count))]


further.ping(
    TASKS,
    "D1",
    "Ping the adapter and confirm that the outstation answers.",
    seen="{device} answers at least one request during the call: for the status of its link, or another.",
)

further.reads(
    TASKS,
    "D2",
    "Read four analog and four binary inputs.",
    needs="read_analog read_binary",
    make=lambda run: [
        several("analog", FIRST_ANALOG, 4).read(drawn(run, 4)),
        several("binary", FIRST_BINARY, 4).read([bool(run.rng.getrandbits(1)) for _ in range(4)]),
    ],
    seen="A read of these points, by their indexes or by class 0, and nothing that changes the plant.",
    why="Values from memory, or with an index that begins at another number, look right until an operator acts on them.",
)

further.reads_back(
    TASKS,
    "D3",
    "Select and operate a binary output and read it back for verification.",
    needs="write_binary",
    write=lambda run: latched(bool(run.rng.getrandbits(1))),
    read=named("otmcp_pump").read_again,
    facet="read_alias",
    judge=calls.selected_write,
    asked="Latch a binary output to the other state, and read it where the adapter can.",
    seen="One SELECT and one OPERATE with the same objects and successive sequence numbers; every other point stays as it was.",
    why="An output that is operated without being selected, twice, or at the index beside it is another breaker.",
)

further.guard(
    TASKS,
    "D4",
    "Attempt a command with writes disabled and expect a guarded rejection.",
    needs="write_binary read_analog",
    write=lambda run: latched(True),
    read=lambda run: analog(FIRST_ANALOG).reads(),
    seen="No SELECT and nothing else that changes the plant; the restart bit and the clock are every master's to write.",
)


def event(value: bool) -> dict[str, Any]:
    """Return the event of the input that has some, as a poll tells it."""
    return {"type": "binary_input", "index": EVENT_INPUT, "value": value}


async def polled(dnp3: Rig) -> Reply:
    """Poll class 1."""
    return await dnp3.call("poll", outstation=OUTSTATION, event_class=1)


@TASKS.task(
    "D5",
    "normal",
    "Poll the events of class 1.",
    needs="dnp3.poll",
    capability="reading",
    requirements="RD-001 RD-004",
)
async def poll_events(run: Repetition, dnp3: Rig) -> None:
    """Let a binary input change three times, poll class 1, and poll it again.

    Said: the three events in their order; then none.
    Seen: two polls; the answer with the events is confirmed.
    Why: events that are not confirmed are told again as if they were new; those that are confirmed and not told have never happened.
    """
    state = bool(run.rng.getrandbits(1))
    changes = [state, not state, state]
    # Events that were left before this one are not what it is about.
    await dnp3.call("poll", role="setup", outstation=OUTSTATION, event_class=1)
    for value in changes:
        await dnp3.device.poke(point=EVENT_POINT, value=value)
    first = await polled(dnp3)
    second = await polled(dnp3)
    run.succeeds(first, events=[event(value) for value in changes])
    run.succeeds(second, events=[])
    journal = await dnp3.journal()
    witness = partial(oracle.polled, event_class=1)
    run.witnessed(fresh(journal, (first, witness), (second, witness)), oracle.confirmed(journal))


@TASKS.task(
    "D6",
    "normal",
    "Operate a binary output whose selection has timed out.",
    needs="dnp3.write_binary",
    capability="writing",
    requirements="WR-001 ERR-002",
)
async def a_selection_times_out(run: Repetition, dnp3: Rig) -> None:
    """Latch a binary output while the outstation answers the operation with status 1, select timed out.

    Said: a failure with `session_error` and the outcome `rejected`, or with `timeout`: never a success.
    Seen: one operation, which the outstation answers with this status; the output stays as it was.
    Why: the refusal of a command is a status in the echo of its object; who looks at the answer alone takes it for success.
    """
    asked = latched(bool(run.rng.getrandbits(1)))
    await further.set_up(dnp3, asked)
    before = await dnp3.device.image()
    await dnp3.device.fault(
        *({"function": function, "action": {"status": TIMED_OUT}} for function in (OPERATE, DIRECT_OPERATE))
    )
    reply = await further.call(dnp3, asked)
    await dnp3.device.fault()
    told = {"requirement": "WR-001", "code_requirement": "ERR-002"}
    run.fails(reply, "session_error", "timeout", outcome=("rejected", "unknown"), **told)
    journal = await dnp3.journal()
    run.witnessed(
        calls.one_write(journal, {}, asked),
        oracle.refused_with_status(journal, TIMED_OUT),
        oracle.only_changed(before, await dnp3.device.image(), {}, otherwise="WR-001"),
    )


@a_selection_times_out.after
async def the_output_can_be_operated(run: Repetition, dnp3: Rig) -> None:
    """Latch the output while nothing is wrong.

    Said: success.
    Seen: one operation, and the state at the output.
    """
    asked = latched(True)
    run.succeeds(await further.call(dnp3, asked), **asked.outputs)
    await TASKS.sees_and_holds(run, dnp3, asked)


@TASKS.task(
    "D7",
    "normal",
    "Read inputs while an unsolicited response comes before the answer.",
    needs="dnp3.read_analog",
    capability="reading",
    requirements="RD-001 RD-004",
)
async def an_unsolicited_response(run: Repetition, dnp3: Rig) -> None:
    """Read two analog inputs while the outstation tells an event unasked before it answers; then poll class 1, where the adapter can.

    Said: the values that were asked for; the event once, beside them or by the poll.
    Seen: the read, and a confirmation of each response that asks for one.
    Why: an outstation that tells an alarm by itself must not get an old value for an answer, or forget an alarm that nobody was told of.
    """
    value = bool(run.rng.getrandbits(1))
    if dnp3.subject.claims("poll"):
        await dnp3.call("poll", role="setup", outstation=OUTSTATION, event_class=1)
    asked = several("analog", FIRST_ANALOG, 2).read(drawn(run, 2))
    await further.set_up(dnp3, asked)
    await dnp3.device.poke(point=EVENT_POINT, value=value)
    await dnp3.device.fault({"function": 1, "times": 1, "action": {"unsolicited": True}})
    reply = await further.call(dnp3, asked)
    await dnp3.device.fault()
    run.succeeds(reply, **asked.outputs)
    await dnp3.wait_for(kind="confirm", unsolicited=True, timeout_s=CONFIRMED_S)
    told = reply.outputs.get("events") or []
    if told:
        run.succeeds(reply, events=[event(value)])
    if dnp3.subject.claims("poll"):
        run.succeeds(await polled(dnp3), events=[] if told else [event(value)])
    journal = await dnp3.journal()
    run.witnessed(
        TASKS.seen(journal, {}, (reply, asked)),
        oracle.confirmed(journal),
    )


@TASKS.task(
    "FD1",
    "fault",
    "Read analog inputs of which the last ones do not exist (2 to 9 of 0 to 7).",
    needs="dnp3.read_analog",
    capability="refusing",
    requirements="ERR-002 RD-005 RD-007",
)
async def read_missing_inputs(run: Repetition, dnp3: Rig) -> None:
    """Read the analog inputs 2 to 9 of an outstation that has eight.

    Said: a failure with `illegal_address`. An adapter that refuses by a list of its own may also say `invalid_input`; nothing was
        sent then.
    Seen: the read, which the outstation refuses by an internal indication (IIN2.1 or IIN2.2), or a read of everything that it has.
    Why: an assistant that gets six values for eight, or zeros for those that are missing, believes them.
    """
    reply = await further.call(dnp3, several("analog", 2, 8).reads())
    seen = reply.during(await dnp3.journal())
    if not oracle.reached(seen, "analog_input", 2, 8):
        run.fails(reply, "illegal_address", "invalid_input", outcome=NOTHING_SENT, requirement="ERR-002")
        return
    run.fails(reply, "illegal_address", requirement="ERR-002")
    # Whoever reads class 0 finds out by itself.
    if oracle.named(seen, "analog_input", 2, 8) and oracle.refused_with_iin(seen, PARAMETER_ERROR):
        run.witnessed(oracle.refused_with_iin(seen, OBJECT_UNKNOWN))


@read_missing_inputs.after
async def inputs_that_are_there_can_be_read(run: Repetition, dnp3: Rig) -> None:
    """Read an input that is there; then while the outstation answers about another one.

    Said: success, and the value; then no value of the other input as the one that was asked for.
    """
    (asked,) = some_analog(run, 1)
    rule = {"function": 1, "group": 30, "action": {"answer_index": 1}}
    await further.another_answers(
        run,
        dnp3,
        asked,
        rule,
        *("protocol_error", "connection_lost", "timeout"),
        # The answer to a read of everything that an outstation has is about all of its points.
        must_fail=lambda entries: oracle.named(entries, "analog_input", FIRST_ANALOG),
    )


async def _refused(run: Repetition, dnp3: Rig, status: int, asked: Asked, *codes: str) -> None:
    """Send a command that the outstation refuses, or that the adapter knows that it would refuse."""
    before = await dnp3.device.image()
    reply = await further.call(dnp3, asked)
    journal = await dnp3.journal()
    if oracle.no_state_changing_request(journal):
        run.fails(reply, *codes, outcome="rejected", requirement="ERR-002")
        run.witnessed(oracle.refused_with_status(journal, status))
    else:
        run.fails(reply, *codes, "invalid_input", outcome="not_sent", requirement="ERR-002")
    run.witnessed(oracle.only_changed(before, await dnp3.device.image(), {}, otherwise=untold(reply, "ERR-002")))


@TASKS.task(
    "FD2",
    "fault",
    "Operate a binary output that the outstation does not have (99).",
    needs="dnp3.write_binary",
    capability="refusing",
    requirements="ERR-002 ERR-006",
    keys="dnp3.probes.missing_output",
)
async def operate_missing_output(run: Repetition, dnp3: Rig) -> None:
    """Latch a binary output that the outstation does not have.

    Said: a failure with `illegal_address` or `unsupported_operation` and the outcome `rejected`; also `invalid_input` where nothing was
        sent.
    Seen: the selection, which the outstation answers with status 4, or nothing; every point stays as it was.
    Why: the status of a command that was refused is in the echo of its object, and the answer as such looks like any other.
    """
    missing = int(str(dnp3.subject.probe("missing_output")))
    await _refused(run, dnp3, NOT_SUPPORTED, latch(missing).writes(True), "illegal_address", "unsupported_operation")


@TASKS.task(
    "FD3",
    "fault",
    "Set an analog output that is limited to 0 to 100 to 1e9.",
    needs="dnp3.write_alias",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def set_beyond_the_limit(run: Repetition, dnp3: Rig) -> None:
    """Set an analog output to a value that the outstation refuses.

    Said: a failure with `illegal_value` or `range_overflow` and the outcome `rejected`; also `invalid_input` where nothing was sent.
    Seen: the selection, which the outstation answers with status 12, or nothing; every point stays as it was.
    Why: a refused setpoint that is told as written is worse than none.
    """
    await _refused(run, dnp3, OUT_OF_RANGE, LIMITED.writes(1e9), "illegal_value", "range_overflow")


@set_beyond_the_limit.after
async def a_value_within_the_limit_is_accepted(run: Repetition, dnp3: Rig) -> None:
    """Set the analog output to a value within its limit.

    Said: success.
    Seen: one operation, and the value at the output.
    """
    asked = LIMITED.write(40.5)
    run.succeeds(await further.call(dnp3, asked), **asked.outputs)
    await TASKS.sees_and_holds(run, dnp3, asked)


write_wrong_type = further.refused_by_itself(
    TASKS,
    "FD4",
    "Write a text to a binary output and expect adapter rejection.",
    needs="write_binary",
    make=lambda run: latch(LATCH).writes("off"),
    why="A text is true in many languages, and a breaker that was to open closes.",
)


@write_wrong_type.after
async def a_state_is_accepted(run: Repetition, dnp3: Rig) -> None:
    """Wait, then switch the output off.

    Said: success.
    Seen: nothing that changes the plant at first; then one operation.
    """
    await dnp3.stays_quiet(QUIET_S, partial(oracle.no_state_changing_request, requirement="ADR-004"))
    asked = latched(False)
    run.succeeds(await further.call(dnp3, asked), **asked.outputs)
    run.witnessed(calls.one_write(await dnp3.journal(), {}, asked))


@TASKS.task(
    "FD5",
    "fault",
    "Read an analog input that is off line.",
    needs="dnp3.read_analog",
    capability="refusing",
    requirements="RD-001",
)
async def read_what_is_off_line(run: Repetition, dnp3: Rig) -> None:
    """Read an analog input whose flags say that the connection to it is lost.

    Said: a failure with `bad_quality`, `partial_failure` or `device_failure`, or the value with its flags, without ONLINE among them.
    Seen: the read.
    Why: the last value of a sensor that is cut off stands still and looks like a calm plant.
    """
    asked = analog(STALE_INPUT).reads()
    reply = await further.call(dnp3, asked)
    if not reply.success:
        run.fails(reply, "bad_quality", "partial_failure", "device_failure", requirement="RD-001")
    else:
        run.judge(reply, oracle.told_off_line(reply.outputs.get("flags"), reply.label))
    run.witnessed(TASKS.seen(await dnp3.journal(), {}, (reply, asked)))


@TASKS.task(
    "FD6",
    "fault",
    "Operate a binary output that is switched to local control.",
    needs="dnp3.write_binary",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def operate_what_is_local(run: Repetition, dnp3: Rig) -> None:
    """Latch a binary output that is operated by hand at the place.

    Said: a failure with `access_denied` and the outcome `rejected`; also `invalid_input` where nothing was sent.
    Seen: the selection, which the outstation answers with status 7, or nothing; every point stays as it was.
    Why: somebody stands beside the machine, and whoever operates it from afar has to know that it does not obey.
    """
    await _refused(run, dnp3, LOCALLY, latch(LOCAL_OUTPUT).writes(True), "access_denied")


further.four_at_once(
    TASKS,
    "SD1",
    "Four concurrent reads of analog inputs.",
    needs="read_analog",
    make=lambda run: some_analog(run, 4),
)


def contended(run: Repetition) -> Contended:
    """Return a read and a command of an analog output: a request between a selection and its operation ends the selection."""
    return SETPOINT.contended(*(number + 0.5 for number in run.rng.sample(range(2**20), 2)))


further.beside(
    TASKS,
    "SD2",
    "Concurrent read and command of an analog output.",
    needs="read_alias write_alias",
    make=contended,
    judge=calls.selected_write,
    seen="One operation, selected before; {device} holds the new value.",
    why="A request between a selection and its operation ends the selection, which shows only under load.",
)


def fifty(run: Repetition) -> list[Asked]:
    """Return reads of two inputs in turn."""
    pair = some_analog(run, 2)
    return [pair[number % 2] for number in range(RAPID_CALLS)]


further.rapid(
    TASKS,
    "SD3",
    "Fifty reads of analog inputs in a row.",
    needs="read_analog",
    make=fifty,
    why="Leaks, caches and the four bits of a sequence number show in a long series only.",
)

further.restart(
    TASKS,
    "SD4",
    "Endpoint restart between reads of an analog input.",
    read_analog=partial(oracle.read_from_device, kind="analog_input", start=FIRST_ANALOG),
)

further.recovery(TASKS, "Recover from a restart of the DNP3 outstation.")
