"""The tasks on DNP3.

Each function is one repetition, as in :mod:`.modbus`. The inputs that tasks set have no events, but for those of the tasks on events.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from pytest_otmcp.protocols.dnp3 import oracle
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

from .common import (
    NOTHING_SENT,
    QUIET_S,
    RAPID_CALLS,
    Witness,
    a_delay_shows,
    a_failed_write_is_not_made_up_for,
    a_meaningless_switch_enables_nothing,
    drawn,
    ends_when_its_stdin_closes,
    fresh,
    outage,
    start_without_device,
    status_is_known,
    survive_a_restart,
    untold,
)

__all__ = ["TASKS"]

TASKS = Tasks()

OUTSTATION = 10
FIRST_ANALOG, FIRST_BINARY = 1, 8
"""The first analog and the first binary input without events."""
EVENT_INPUT, STALE_INPUT = 3, 6
"""The binary input whose changes are events of class 1; the analog input that is off line."""
LATCH, LOCAL_OUTPUT, LIMITED_OUTPUT = 2, 5, 2
SETPOINT, LIMITED = "otmcp_setpoint", "otmcp_limited"
"""Names that a launch of an adapter with names of its own has for the analog outputs 0 and 2."""
OPERATE, DIRECT_OPERATE = 4, 5
PARAMETER_ERROR, OBJECT_UNKNOWN = 0x0400, 0x0200
TIMED_OUT, NOT_SUPPORTED, LOCALLY, OUT_OF_RANGE = 1, 4, 7, 12
CONFIRMED_S = 1.0
"""Seconds within which a confirmation that was sent has arrived."""


def at(start: int, count: int = 1) -> dict[str, Any]:
    """Return the inputs of a read."""
    return {"outstation": OUTSTATION, "start": start, "count": count}


def latched(value: object, index: int = LATCH) -> dict[str, Any]:
    """Return the inputs of a command for a binary output."""
    return {"outstation": OUTSTATION, "index": index, "value": value}


def read_of(kind: str, start: int, count: int = 1) -> Witness:
    """Return the check that the outstation was asked for these points."""
    return partial(oracle.read_from_device, kind=kind, start=start, count=count)


async def hold(dnp3: Rig, kind: str, index: int, value: object) -> None:
    """Set a point at the outstation."""
    await dnp3.device.poke(point=oracle.point(kind, index), value=value)


async def hold_analog(run: Repetition, dnp3: Rig, count: int) -> list[int]:
    """Set analog inputs to random values, and return these."""
    values = run.rng.sample(range(-(2**31), 2**31), count)
    for place, value in enumerate(values):
        await hold(dnp3, "analog_input", FIRST_ANALOG + place, value)
    return values


@TASKS.task(
    "D1",
    "normal",
    "Ping the adapter and confirm that the outstation answers.",
    needs="dnp3.ping",
    capability="reading",
    requirements="REC-002 MCP-008",
)
async def ping(run: Repetition, dnp3: Rig) -> None:
    """Ask whether the outstation can be reached.

    Said: success, and that it can be reached.
    Seen: the outstation answers at least one request during the call: for the status of its link, or another.
    Why: a status from memory still says so when the plant is gone.
    """
    reply = await dnp3.call("ping")
    run.succeeds(reply, reachable=True)
    await status_is_known(run, dnp3, oracle.some_exchange, reply)


@ping.after
async def a_slow_outstation_is_reported_as_slow(run: Repetition, dnp3: Rig) -> None:
    """Ask while the outstation answers a tenth of a second late.

    Said: success, and a latency that is no shorter than that.
    """
    await a_delay_shows(run, dnp3, "ping")


@TASKS.task(
    "D2",
    "normal",
    "Read four analog and four binary inputs.",
    needs="dnp3.read_analog dnp3.read_binary",
    capability="reading",
    requirements="RD-001 RD-002 RD-004 MCP-009",
)
async def read_inputs(run: Repetition, dnp3: Rig) -> None:
    """Read four analog and four binary inputs whose values were set at random just before.

    Said: these values.
    Seen: a read of these points, by their indexes or by class 0, and nothing that changes the plant.
    Why: values from memory, or with an index that begins at another number, look right until somebody acts on them.
    """
    values = await hold_analog(run, dnp3, 4)
    states = [bool(run.rng.getrandbits(1)) for _ in range(4)]
    for place, state in enumerate(states):
        await hold(dnp3, "binary_input", FIRST_BINARY + place, state)
    analog = await dnp3.call("read_analog", **at(FIRST_ANALOG, 4))
    binary = await dnp3.call("read_binary", **at(FIRST_BINARY, 4))
    run.succeeds(analog, values=values)
    run.succeeds(binary, values=states)
    journal = await dnp3.journal()
    run.witnessed(
        fresh(
            journal,
            (analog, read_of("analog_input", FIRST_ANALOG, 4)),
            (binary, read_of("binary_input", FIRST_BINARY, 4)),
        ),
        oracle.no_state_changing_request(journal, requirement="MCP-008"),
    )


@read_inputs.after
async def the_process_ends_with_its_stdin(run: Repetition, dnp3: Rig) -> None:
    """End the session.

    Seen: the process ends by itself.
    """
    await ends_when_its_stdin_closes(dnp3)


@TASKS.task(
    "D3",
    "normal",
    "Select and operate a binary output and read it back for verification.",
    needs="dnp3.write_binary",
    capability="writing",
    requirements="WR-001 WR-002 WR-003",
)
async def select_and_operate(run: Repetition, dnp3: Rig) -> None:
    """Latch a binary output to the other state, and read it where the adapter can.

    Said: the state, in both answers.
    Seen: one SELECT and one OPERATE with the same objects and successive sequence numbers; every other point stays as it was.
    Why: an output that is operated without being selected, twice, or at the index beside it is another breaker.
    """
    value = bool(run.rng.getrandbits(1))
    await hold(dnp3, "binary_output", LATCH, not value)
    before = await dnp3.device.image()
    reply = await dnp3.call("write_binary", **latched(value))
    after = await dnp3.device.image()
    run.succeeds(reply, value=value)
    if dnp3.subject.claims("read_alias"):
        read = await dnp3.call("read_alias", name="otmcp_pump")
        run.succeeds(read, value=oracle.held(after, "binary_output", LATCH))
    journal = await dnp3.journal()
    run.witnessed(
        oracle.exactly_one_operation(journal, "binary", LATCH, value),
        oracle.selected_first(journal),
        oracle.only_changed(before, after, {oracle.point("binary_output", LATCH): value}),
    )


@TASKS.task(
    "D4",
    "normal",
    "Attempt a command with writes disabled and expect a guarded rejection.",
    needs="dnp3.write_binary dnp3.read_analog dnp3.guard",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
)
async def guarded_command(run: Repetition, dnp3_ro: Rig) -> None:
    """Latch a binary output through the adapter that was started with writes disabled.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`.
    Seen: no SELECT and nothing else that changes the plant; the restart bit and the clock are every master's to write.
    Why: the write switch is what keeps an assistant's mistake out of the plant.
    """
    before = await dnp3_ro.device.image()
    reply = await dnp3_ro.call("write_binary", **latched(True))
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.witnessed(
        oracle.no_state_changing_request(await dnp3_ro.journal()),
        oracle.only_changed(before, await dnp3_ro.device.image(), {}, otherwise="WR-004"),
    )


@guarded_command.after
async def the_guard_was_put_to_the_test(run: Repetition, dnp3: Rig, dnp3_ro: Rig) -> None:
    """Read with writes disabled, and send the same command with writes enabled: both must work, or the refusal proves nothing. Then
    send it through the adapter that was started with a write switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
    Seen: over the whole life of the read-only sessions, their end included, nothing that changes the plant.
    """
    run.succeeds(await dnp3_ro.call("read_analog", **at(FIRST_ANALOG)))
    run.succeeds(await dnp3.call("write_binary", **latched(True)), value=True)
    run.witnessed(
        oracle.some_exchange(await dnp3_ro.journal()),
        oracle.exactly_one_operation(await dnp3.journal(), "binary", LATCH, True),
    )
    await dnp3_ro.close_session()
    run.witnessed(oracle.nothing_changed_by(await dnp3_ro.follow(StateChanges)))
    await a_meaningless_switch_enables_nothing(run, dnp3_ro, "write_binary", **latched(True))


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
        await hold(dnp3, "binary_input", EVENT_INPUT, value)
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
    value = bool(run.rng.getrandbits(1))
    await hold(dnp3, "binary_output", LATCH, not value)
    before = await dnp3.device.image()
    await dnp3.device.fault(
        *({"function": function, "action": {"status": TIMED_OUT}} for function in (OPERATE, DIRECT_OPERATE))
    )
    reply = await dnp3.call("write_binary", **latched(value))
    await dnp3.device.fault()
    told = {"requirement": "WR-001", "code_requirement": "ERR-002"}
    run.fails(reply, "session_error", "timeout", outcome=("rejected", "unknown"), **told)
    journal = await dnp3.journal()
    run.witnessed(
        oracle.exactly_one_operation(journal, "binary", LATCH, value),
        oracle.refused_with_status(journal, TIMED_OUT),
        oracle.only_changed(before, await dnp3.device.image(), {}, otherwise="WR-001"),
    )


@a_selection_times_out.after
async def the_output_can_be_operated(run: Repetition, dnp3: Rig) -> None:
    """Latch the output while nothing is wrong.

    Said: success.
    Seen: one operation, and the state at the output.
    """
    run.succeeds(await dnp3.call("write_binary", **latched(True)), value=True)
    run.witnessed(
        oracle.exactly_one_operation(await dnp3.journal(), "binary", LATCH, True),
        oracle.holds(await dnp3.device.image(), {oracle.point("binary_output", LATCH): True}),
    )


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
    values = await hold_analog(run, dnp3, 2)
    await hold(dnp3, "binary_input", EVENT_INPUT, value)
    await dnp3.device.fault({"function": 1, "times": 1, "action": {"unsolicited": True}})
    reply = await dnp3.call("read_analog", **at(FIRST_ANALOG, 2))
    await dnp3.device.fault()
    run.succeeds(reply, values=values)
    await dnp3.wait_for(kind="confirm", unsolicited=True, timeout_s=CONFIRMED_S)
    told = reply.outputs.get("events") or []
    if told:
        run.succeeds(reply, events=[event(value)])
    if dnp3.subject.claims("poll"):
        run.succeeds(await polled(dnp3), events=[] if told else [event(value)])
    journal = await dnp3.journal()
    run.witnessed(
        fresh(journal, (reply, read_of("analog_input", FIRST_ANALOG, 2))),
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
    reply = await dnp3.call("read_analog", **at(2, 8))
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
    (value,) = await hold_analog(run, dnp3, 1)
    run.succeeds(await dnp3.call("read_analog", **at(FIRST_ANALOG)), values=[value])
    # The answer to a read of everything that an outstation has is about all of its points.
    await dnp3.device.fault({"function": 1, "group": 30, "action": {"answer_index": 1}})
    reply = await dnp3.call("read_analog", **at(FIRST_ANALOG))
    await dnp3.device.fault()
    if oracle.named(reply.during(await dnp3.journal()), "analog_input", FIRST_ANALOG):
        codes = ("protocol_error", "connection_lost", "timeout")
        run.fails(reply, *codes, requirement="RD-005", code_requirement="ERR-002")
    run.succeeds(await dnp3.call("read_analog", **at(FIRST_ANALOG)), values=[value])


async def _refused(
    run: Repetition, dnp3: Rig, status: int, *codes: str, operation: str = "write_binary", **inputs: Any
) -> None:
    """Send a command that the outstation refuses, or that the adapter knows that it would refuse."""
    before = await dnp3.device.image()
    reply = await dnp3.call(operation, **inputs)
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
    await _refused(run, dnp3, NOT_SUPPORTED, "illegal_address", "unsupported_operation", **latched(True, index=missing))


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
    codes = ("illegal_value", "range_overflow")
    await _refused(run, dnp3, OUT_OF_RANGE, *codes, operation="write_alias", name=LIMITED, value=1e9)


@set_beyond_the_limit.after
async def a_value_within_the_limit_is_accepted(run: Repetition, dnp3: Rig) -> None:
    """Set the analog output to a value within its limit.

    Said: success.
    Seen: one operation, and the value at the output.
    """
    run.succeeds(await dnp3.call("write_alias", name=LIMITED, value=40.5), value=40.5)
    run.witnessed(
        oracle.exactly_one_operation(await dnp3.journal(), "analog", LIMITED_OUTPUT, 40.5),
        oracle.holds(await dnp3.device.image(), {oracle.point("analog_output", LIMITED_OUTPUT): 40.5}),
    )


@TASKS.task(
    "FD4",
    "fault",
    "Write a text to a binary output and expect adapter rejection.",
    needs="dnp3.write_binary",
    capability="refusing",
    requirements="ADR-004 ERR-006",
)
async def write_wrong_type(run: Repetition, dnp3: Rig) -> None:
    """Write the text "off" to a binary output.

    Said: a failure with `type_mismatch` or `invalid_input` and the outcome `not_sent`.
    Seen: no request that changes the plant; every point stays as it was.
    Why: a text is true in many languages, and a breaker that was to open closes.
    """
    before = await dnp3.device.image()
    reply = await dnp3.call("write_binary", **latched("off"))
    run.fails(reply, "type_mismatch", "invalid_input", outcome="not_sent", requirement="ADR-004")
    run.witnessed(
        oracle.no_state_changing_request(await dnp3.journal(), requirement=untold(reply, "ADR-004")),
        oracle.only_changed(before, await dnp3.device.image(), {}, otherwise=untold(reply, "ADR-004")),
    )


@write_wrong_type.after
async def a_state_is_accepted(run: Repetition, dnp3: Rig) -> None:
    """Wait, then switch the output off.

    Said: success.
    Seen: nothing that changes the plant at first; then one operation.
    """
    await dnp3.stays_quiet(QUIET_S, partial(oracle.no_state_changing_request, requirement="ADR-004"))
    run.succeeds(await dnp3.call("write_binary", **latched(False)), value=False)
    run.witnessed(oracle.exactly_one_operation(await dnp3.journal(), "binary", LATCH, False))


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
    reply = await dnp3.call("read_analog", **at(STALE_INPUT))
    if not reply.success:
        run.fails(reply, "bad_quality", "partial_failure", "device_failure", requirement="RD-001")
    else:
        run.judge(reply, oracle.told_off_line(reply.outputs.get("flags"), reply.label))
    run.witnessed(fresh(await dnp3.journal(), (reply, read_of("analog_input", STALE_INPUT))))


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
    await _refused(run, dnp3, LOCALLY, "access_denied", **latched(True, index=LOCAL_OUTPUT))


@TASKS.task(
    "SD1",
    "stress",
    "Four concurrent reads of analog inputs.",
    needs="dnp3.read_analog",
    capability="load",
    requirements="CON-001",
)
async def concurrent_reads(run: Repetition, dnp3: Rig) -> None:
    """Read four analog inputs by four calls at the same time.

    Said: in each answer the value of its own input.
    Seen: for each call a read of its input, during the call.
    Why: an answer that belongs to another call is a wrong value that looks right.
    """
    values = await hold_analog(run, dnp3, 4)
    indexes = range(FIRST_ANALOG, FIRST_ANALOG + 4)
    replies = await run.together(*(dnp3.call("read_analog", **at(index)) for index in indexes))
    for reply, value in zip(replies, values, strict=True):
        run.succeeds(reply, values=[value])
    asked = [(reply, read_of("analog_input", index)) for reply, index in zip(replies, indexes, strict=True)]
    run.witnessed(fresh(await dnp3.journal(), *asked))


@TASKS.task(
    "SD2",
    "stress",
    "Concurrent read and command of an analog output.",
    needs="dnp3.read_alias dnp3.write_alias",
    capability="load",
    requirements="CON-004 WR-003",
)
async def concurrent_read_and_command(run: Repetition, dnp3: Rig) -> None:
    """Read an analog output and set it at the same time.

    Said: the old value or the new one for the read, success for the command.
    Seen: one operation, selected before; the output holds the new value.
    Why: a request between a selection and its operation ends the selection, which shows only under load.
    """
    old, new = drawn(
        dnp3,
        "write_alias",
        lambda: [number + 0.5 for number in run.rng.sample(range(2**20), 2)],
        lambda pair: {"name": SETPOINT, "value": pair[1]},
    )
    await hold(dnp3, "analog_output", 0, old)
    read, reply = await run.together(
        dnp3.call("read_alias", name=SETPOINT), dnp3.call("write_alias", name=SETPOINT, value=new)
    )
    run.succeeds(read)
    run.one_of(read, "value", old, new)
    run.succeeds(reply, value=new)
    journal = await dnp3.journal()
    run.witnessed(
        oracle.exactly_one_operation(journal, "analog", 0, new),
        oracle.selected_first(journal),
        oracle.holds(await dnp3.device.image(), {oracle.point("analog_output", 0): new}),
    )


@TASKS.task(
    "SD3",
    "stress",
    "Fifty reads of analog inputs in a row.",
    needs="dnp3.read_analog",
    capability="load",
    requirements="CON-006",
)
async def rapid_reads(run: Repetition, dnp3: Rig) -> None:
    """Read fifty analog inputs, one call after the other.

    Said: the right value in every answer.
    Seen: for each call a read of its input, during the call.
    Why: leaks, caches and the four bits of a sequence number show in a long series only.
    """
    values = await hold_analog(run, dnp3, 2)
    asked = []
    for number in range(RAPID_CALLS):
        index = FIRST_ANALOG + number % 2
        reply = await dnp3.call("read_analog", **at(index))
        run.succeeds(reply, values=[values[number % 2]])
        asked.append((reply, read_of("analog_input", index)))
    run.witnessed(fresh(await dnp3.journal(), *asked))


@TASKS.task(
    "SD4",
    "stress",
    "Endpoint restart between reads of an analog input.",
    needs="dnp3.any_read dnp3.recovery",
    capability="outages",
    requirements="REC-001 REC-002 RD-004",
    keys="dnp3.recovery",
)
async def restart(run: Repetition, dnp3: Rig) -> None:
    """Read an analog input; again after the outstation was stopped; and again after it was started.

    Said: success; then a failure with `connect_failed`, `connection_lost` or `timeout`; then success in the same
        session.
    Seen: a read after the outstation is back.
    Why: an outage of the line must not need a person who restarts the adapter, and old values must not hide it.
    """
    await survive_a_restart(run, dnp3, read_analog=read_of("analog_input", FIRST_ANALOG))


@restart.after
async def a_failed_command_is_not_delivered_later(run: Repetition, dnp3: Rig) -> None:
    """Send a command while the outstation is away, and read when it is back.

    Said: a failure for the command, success for the read.
    Seen: no command: what was reported as failed is not made up for.
    """
    await a_failed_write_is_not_made_up_for(run, dnp3)


@TASKS.task(
    "R-dnp3",
    "recovery",
    "Recover from a restart of the DNP3 outstation.",
    needs="dnp3.any_read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
    keys="dnp3.recovery",
)
async def recovery(run: Repetition, dnp3: Rig) -> None:
    """Read; again after the outstation was stopped; then, after it was started, in the same session and in a fresh one with
    a new process.

    Said: success; a failure of the connection; success in both sessions.
    Seen: the reads of both sessions, and nothing that changes the plant.
    Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
    """
    await outage(run, dnp3)


@recovery.after
async def the_adapter_starts_without_its_device(run: Repetition, dnp3: Rig) -> None:
    """Start the adapter while its outstation is down, ask, and ask again when it is there.

    Said: a failure of the connection first, success then.
    """
    await start_without_device(run, dnp3)
