"""The tasks on BACnet/IP.

Each function is one repetition, as in :mod:`.modbus`. Values are halves, which a REAL holds exactly.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from pytest_otmcp.protocols.bacnet import oracle
from pytest_otmcp.protocols.bacnet.entries import Target
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

from .common import (
    CONNECTION_FAULTS,
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

DEVICE = 12345
SILENT_DEVICE = 54321
ZONE, SUPPLY = ("analog-input", 1), ("analog-input", 2)
VALVE, SETPOINT, LEVEL, FAN = ("analog-output", 1), ("analog-value", 2), ("analog-value", 9), ("binary-output", 1)
PRIORITY, OTHER_PRIORITY = 8, 5
UNKNOWN_OBJECT, VALUE_OUT_OF_RANGE, WRITE_ACCESS_DENIED = (1, 31), (2, 37), (2, 40)


def at(target: Target) -> dict[str, Any]:
    """Return the inputs that name an object."""
    return {"device": DEVICE, "type": target[0], "instance": target[1]}


def written(target: Target, value: float | None, priority: int = PRIORITY) -> dict[str, Any]:
    """Return the inputs of a write."""
    return {**at(target), "value": value, "priority": priority}


def read_of(target: Target) -> Witness:
    """Return the check that the device was asked for this object's present value."""
    return partial(oracle.read_from_device, target=target)


def half(run: Repetition) -> float:
    """Return a random value that a REAL holds exactly."""
    return run.rng.randrange(2**20) + 0.5


async def hold(rig: Rig, target: Target, value: float | None, priority: int | None = None) -> None:
    """Set a present value at the device, or a slot of its priority array."""
    slot = {} if priority is None else {"priority": priority}
    await rig.device.poke(object=f"{target[0]},{target[1]}", value=value, **slot)


@TASKS.task(
    "B1",
    "normal",
    "Ping the adapter and confirm that the BACnet device answers.",
    needs="bacnet.ping",
    capability="reading",
    requirements="REC-002 MCP-008",
)
async def ping(run: Repetition, bacnet: Rig) -> None:
    """Ask whether the device can be reached.

    Said: success, and that it can be reached.
    Seen: the device answers at least one request during the call: a Who-Is or a read.
    Why: a status from memory still says so when the plant is gone, and a datagram that was sent proves nothing.
    """
    reply = await bacnet.call("ping")
    run.succeeds(reply, reachable=True)
    await status_is_known(run, bacnet, oracle.some_exchange, reply)


@ping.after
async def a_slow_device_is_reported_as_slow(run: Repetition, bacnet: Rig) -> None:
    """Ping while the device answers a tenth of a second late; then find devices, and read from one that is not there.

    Said: success, and a latency that is no shorter than that; the one device; a failure.
    Seen: no request to the device for what another device was asked for.
    """
    await a_delay_shows(run, bacnet, "ping")
    if bacnet.subject.claims("discover"):
        found = await bacnet.call("discover")
        if run.succeeds(found):
            run.judge(found, oracle.invented(found.outputs.get("devices"), DEVICE))
    reply = await bacnet.call("read", **{**at(ZONE), "device": SILENT_DEVICE})
    run.fails(reply, *CONNECTION_FAULTS, "illegal_address", "gateway_target_no_response", requirement="ADR-001")


@TASKS.task(
    "B2",
    "normal",
    "Read present values of four objects.",
    needs="bacnet.read",
    capability="reading",
    requirements="RD-001 RD-002 RD-004 MCP-009",
)
async def read_present_values(run: Repetition, bacnet: Rig) -> None:
    """Read two analog inputs, an analog value and a binary output whose values were set at random just before.

    Said: these four values.
    Seen: a read of each of these present values, and nothing that changes the plant.
    Why: values from memory or from a neighbour look right until somebody acts on them.
    """
    zone, supply, setpoint = (half(run) for _ in range(3))
    fan = run.rng.randrange(2)
    for target, value in ((ZONE, zone), (SUPPLY, supply)):
        await hold(bacnet, target, value)
    await hold(bacnet, SETPOINT, setpoint, PRIORITY)
    await hold(bacnet, FAN, fan, PRIORITY)
    replies = [(await bacnet.call("read", **at(target)), target) for target in (ZONE, SUPPLY, SETPOINT, FAN)]
    for (reply, _), value in zip(replies[:3], (zone, supply, setpoint), strict=True):
        run.succeeds(reply, value=value)
    # The standard has numbers and names for the states.
    if run.succeeds(replies[3][0]):
        run.one_of(replies[3][0], "value", fan, ("inactive", "active")[fan], bool(fan), requirement="RD-001")
    journal = await bacnet.journal()
    run.witnessed(
        fresh(journal, *((reply, read_of(target)) for reply, target in replies)),
        oracle.no_state_changing_request(journal, requirement="MCP-008"),
    )


@read_present_values.after
async def the_process_ends_with_its_stdin(run: Repetition, bacnet: Rig) -> None:
    """End the session.

    Seen: the process ends by itself.
    """
    await ends_when_its_stdin_closes(bacnet)


@TASKS.task(
    "B3",
    "normal",
    "Command a valve at priority 8 and read it back.",
    needs="bacnet.write bacnet.write.priority bacnet.read",
    capability="writing",
    requirements="WR-001 WR-002 WR-003",
)
async def command_and_read_back(run: Repetition, bacnet: Rig) -> None:
    """Write an analog output at priority 8, and read it.

    Said: the value, in both answers.
    Seen: one write of this REAL at this priority; the slot and the present value hold it, every other slot and object stays as it was.
    Why: a write without its priority takes the plant out of the hands of its operators, or stays without effect.
    """
    value = 40.5 + run.rep
    before = await bacnet.device.image()
    reply = await bacnet.call("write", **written(VALVE, value))
    after = await bacnet.device.image()
    read = await bacnet.call("read", **at(VALVE))
    run.succeeds(reply, value=value)
    run.succeeds(read, value=oracle.held(after, VALVE))
    journal = await bacnet.journal()
    run.witnessed(
        oracle.exactly_one_write(journal, VALVE, "real", value, priority=PRIORITY),
        oracle.only_changed(before, after, {oracle.present(VALVE): value, oracle.slot(VALVE, PRIORITY): value}),
    )


@TASKS.task(
    "B4",
    "normal",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="bacnet.write bacnet.read bacnet.guard",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
)
async def guarded_write(run: Repetition, bacnet_ro: Rig) -> None:
    """Write an analog output through the adapter that was started with writes disabled.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`.
    Seen: no service that changes the device, no time synchronization; the device holds what it held.
    Why: the write switch is what keeps an assistant's mistake out of the plant.
    """
    before = await bacnet_ro.device.image()
    reply = await bacnet_ro.call("write", **written(VALVE, 99.5))
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.witnessed(
        oracle.no_state_changing_request(await bacnet_ro.journal()),
        oracle.only_changed(before, await bacnet_ro.device.image(), {}, otherwise="WR-004"),
    )


@guarded_write.after
async def the_guard_was_put_to_the_test(run: Repetition, bacnet: Rig, bacnet_ro: Rig) -> None:
    """Read with writes disabled, and write the same value with writes enabled: both must work, or the refusal proves
    nothing. Then write through the adapter that was started with a write switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
    Seen: over the whole life of the read-only sessions, their end included, nothing that changes the plant.
    """
    run.succeeds(await bacnet_ro.call("read", **at(ZONE)))
    run.succeeds(await bacnet.call("write", **written(VALVE, 99.5)), value=99.5)
    run.witnessed(
        oracle.some_exchange(await bacnet_ro.journal()),
        oracle.exactly_one_write(await bacnet.journal(), VALVE, "real", 99.5),
    )
    await bacnet_ro.close_session()
    run.witnessed(oracle.nothing_changed_by(await bacnet_ro.follow(StateChanges)))
    await a_meaningless_switch_enables_nothing(run, bacnet_ro, "write", **written(VALVE, 99.5))


@TASKS.task(
    "B5",
    "normal",
    "Command a valve that a higher priority holds.",
    needs="bacnet.write bacnet.write.priority",
    capability="writing",
    requirements="WR-001 WR-003",
)
async def a_higher_priority_wins(run: Repetition, bacnet: Rig) -> None:
    """Write an analog output at priority 8 while somebody else holds priority 5.

    Said: a failure with `verify_failed`, or success with the value that is in effect: never that the written value is.
    Seen: one write, which the device acknowledges; slot 8 holds the value, the present value stays.
    Why: the device says yes and nothing moves; an assistant that believes it goes on with a plant that is not there.
    """
    kept, value = run.rng.sample(range(1000), 2)
    await hold(bacnet, VALVE, kept + 0.5, OTHER_PRIORITY)
    before = await bacnet.device.image()
    reply = await bacnet.call("write", **written(VALVE, value + 0.5))
    after = await bacnet.device.image()
    if not reply.success:
        run.fails(reply, "verify_failed", outcome="applied", requirement="WR-001")
    elif reply.outputs.get("value") != kept + 0.5:
        run.judge(reply, [oracle.not_effective(reply.outputs.get("value"), kept + 0.5, reply.label)])
    run.witnessed(
        oracle.exactly_one_write(await bacnet.journal(), VALVE, "real", value + 0.5, priority=PRIORITY),
        oracle.only_changed(before, after, {oracle.slot(VALVE, PRIORITY): value + 0.5}),
    )


@TASKS.task(
    "B6",
    "normal",
    "Relinquish a command.",
    needs="bacnet.write bacnet.write.priority",
    capability="writing",
    requirements="WR-001 WR-002 WR-003",
)
async def relinquish(run: Repetition, bacnet: Rig) -> None:
    """Write null at priority 8 to an analog output that is held there.

    Said: success.
    Seen: one write of NULL at this priority; the slot is empty, the present value is that of the next slot.
    Why: a command that nobody gives up overrides the plant's own control for ever.
    """
    lower = half(run)
    await hold(bacnet, VALVE, lower, 16)
    await hold(bacnet, VALVE, lower + 1, PRIORITY)
    before = await bacnet.device.image()
    run.succeeds(await bacnet.call("write", **written(VALVE, None)))
    run.witnessed(
        oracle.exactly_one_write(await bacnet.journal(), VALVE, "null", None, priority=PRIORITY),
        oracle.only_changed(
            before,
            await bacnet.device.image(),
            {oracle.present(VALVE): lower, oracle.slot(VALVE, PRIORITY): None},
        ),
    )


@TASKS.task(
    "FB1",
    "fault",
    "Read an object that the device does not have (analog-input 77).",
    needs="bacnet.read",
    capability="refusing",
    requirements="ERR-002 ENV-007 RD-005",
    keys="bacnet.probes.missing_instance",
)
async def read_missing_object(run: Repetition, bacnet: Rig) -> None:
    """Read an analog input that the device does not have.

    Said: a failure with `illegal_address`, and the device's error in the trace. An adapter that refuses by a list of objects of its
        own may also say `invalid_input`; nothing was sent then.
    Seen: the read, which the device refuses with unknown-object.
    Why: an assistant that gets a zero for an object that does not exist believes the zero.
    """
    target = ("analog-input", int(str(bacnet.subject.probe("missing_instance"))))
    reply = await bacnet.call("read", **at(target))
    seen = reply.during(await bacnet.journal())
    if not oracle.reached(seen, target):
        run.fails(reply, "illegal_address", "invalid_input", outcome=NOTHING_SENT, requirement="ERR-002")
        return
    error_class, error_code = UNKNOWN_OBJECT
    trace = {"error_class": error_class, "error_code": error_code}
    run.fails(reply, "illegal_address", trace=trace, requirement="ERR-002")
    run.witnessed(oracle.refused_with(seen, error_class, error_code))


@read_missing_object.after
async def an_object_that_is_there_can_be_read(run: Repetition, bacnet: Rig) -> None:
    """Read an object that is there; then while the device answers about another object.

    Said: success, and the value; then no value of the other object as the one that was asked for.
    """
    value = half(run)
    await hold(bacnet, ZONE, value)
    run.succeeds(await bacnet.call("read", **at(ZONE)), value=value)
    await bacnet.device.fault({"object": "analog-input,1", "action": {"answer_instance": 2}})
    reply = await bacnet.call("read", **at(ZONE))
    await bacnet.device.fault()
    run.fails(reply, "protocol_error", *CONNECTION_FAULTS, requirement="RD-005", code_requirement="ERR-002")
    run.succeeds(await bacnet.call("read", **at(ZONE)), value=value)


async def _refused(
    run: Repetition, bacnet: Rig, target: Target, value: float, code: str, error: tuple[int, int]
) -> None:
    """Write what the device refuses, or what the adapter knows that it would refuse."""
    before = await bacnet.device.image()
    reply = await bacnet.call("write", **written(target, value))
    journal = await bacnet.journal()
    if oracle.no_state_changing_request(journal):
        run.fails(reply, code, outcome="rejected", requirement="ERR-002")
        run.witnessed(oracle.refused_with(journal, *error))
    else:
        run.fails(reply, code, "range_overflow", "invalid_input", outcome="not_sent", requirement="ERR-002")
    run.witnessed(oracle.only_changed(before, await bacnet.device.image(), {}, otherwise=untold(reply, "ERR-002")))


@TASKS.task(
    "FB2",
    "fault",
    "Write 50 to an analog value that is limited to 0 to 10.",
    needs="bacnet.write",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def write_beyond_the_limit(run: Repetition, bacnet: Rig) -> None:
    """Write a value that the device refuses.

    Said: a failure with `illegal_value` and the outcome `rejected`; `range_overflow` or `invalid_input` where nothing was sent.
    Seen: the write, which the device refuses with value-out-of-range, or none; the device holds what it held.
    Why: a refused setpoint that is told as written is worse than none.
    """
    await _refused(run, bacnet, LEVEL, 50.5, "illegal_value", VALUE_OUT_OF_RANGE)


@write_beyond_the_limit.after
async def a_value_within_the_limit_is_accepted(run: Repetition, bacnet: Rig) -> None:
    """Write a value within the limit.

    Said: success.
    Seen: one write, and the value in the object.
    """
    run.succeeds(await bacnet.call("write", **written(LEVEL, 7.5)), value=7.5)
    run.witnessed(
        oracle.exactly_one_write(await bacnet.journal(), LEVEL, "real", 7.5),
        oracle.holds(await bacnet.device.image(), {oracle.present(LEVEL): 7.5}),
    )


async def _not_sent(run: Repetition, bacnet: Rig, *codes: str, requirement: str, **inputs: Any) -> None:
    before = await bacnet.device.image()
    reply = await bacnet.call("write", **inputs)
    run.fails(reply, *codes, outcome="not_sent", requirement=requirement)
    run.witnessed(
        oracle.no_state_changing_request(await bacnet.journal(), requirement=untold(reply, requirement)),
        oracle.only_changed(before, await bacnet.device.image(), {}, otherwise=untold(reply, requirement)),
    )


@TASKS.task(
    "FB3",
    "fault",
    "Write a text to an analog output.",
    needs="bacnet.write",
    capability="refusing",
    requirements="ADR-004 ERR-006",
)
async def write_a_text(run: Repetition, bacnet: Rig) -> None:
    """Write "abc" to an analog output.

    Said: a failure with `type_mismatch` or `invalid_input` and the outcome `not_sent`.
    Seen: no request that changes the plant; the device holds what it held.
    Why: a text that becomes a number is a number that nobody asked for.
    """
    await _not_sent(
        run,
        bacnet,
        "type_mismatch",
        "invalid_input",
        requirement="ADR-004",
        **{**written(VALVE, 0.0), "value": "abc"},
    )


@TASKS.task(
    "FB4",
    "fault",
    "Write to an analog input.",
    needs="bacnet.write",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def write_an_input(run: Repetition, bacnet: Rig) -> None:
    """Write the present value of an analog input.

    Said: a failure with `not_writable`; `rejected` where the device refused it, `not_sent` otherwise.
    Seen: the write, which the device refuses with write-access-denied, or none; the device holds what it held.
    Why: a sensor that can be overwritten is no sensor.
    """
    await _refused(run, bacnet, ZONE, 1.5, "not_writable", WRITE_ACCESS_DENIED)


@TASKS.task(
    "FB5",
    "fault",
    "Write at a priority that does not exist, and at the reserved one.",
    needs="bacnet.write bacnet.write.priority",
    capability="refusing",
    requirements="ADR-002 ERR-006",
)
async def write_at_no_priority(run: Repetition, bacnet: Rig) -> None:
    """Write at priority 17, and at priority 6, which is reserved for minimum on and off times.

    Said: failures with `invalid_input` or `range_overflow` and the outcome `not_sent`.
    Seen: no request that changes the plant; the device holds what it held.
    Why: a priority that is silently replaced by another one is a command at a place where nobody looks for it.
    """
    for priority in (17, 6):
        inputs = written(VALVE, 30.5, priority)
        await _not_sent(run, bacnet, "invalid_input", "range_overflow", requirement="ADR-002", **inputs)


@write_at_no_priority.after
async def nothing_follows_a_refusal(run: Repetition, bacnet: Rig) -> None:
    """Wait, then write at a priority that exists.

    Said: success.
    Seen: nothing that changes the plant at first; then one write.
    """
    await bacnet.stays_quiet(QUIET_S, partial(oracle.no_state_changing_request, requirement="ADR-002"))
    run.succeeds(await bacnet.call("write", **written(VALVE, 30.5, 10)), value=30.5)
    run.witnessed(oracle.exactly_one_write(await bacnet.journal(), VALVE, "real", 30.5, priority=10))


@TASKS.task(
    "SB1",
    "stress",
    "Four concurrent reads of present values.",
    needs="bacnet.read",
    capability="load",
    requirements="CON-001",
)
async def concurrent_reads(run: Repetition, bacnet: Rig) -> None:
    """Read four objects by four calls at the same time.

    Said: in each answer the value of its own object.
    Seen: for each call a read of its object, during the call.
    Why: an answer that belongs to another call is a wrong value that looks right.
    """
    targets = (ZONE, SUPPLY, VALVE, SETPOINT)
    values = [float(number) + 0.5 for number in run.rng.sample(range(2**20), 4)]
    for target, value in zip(targets, values, strict=True):
        await hold(bacnet, target, value, 1 if target in (VALVE, SETPOINT) else None)
    replies = await run.together(*(bacnet.call("read", **at(target)) for target in targets))
    for reply, value in zip(replies, values, strict=True):
        run.succeeds(reply, value=value)
    run.witnessed(fresh(await bacnet.journal(), *zip(replies, map(read_of, targets), strict=True)))


@TASKS.task(
    "SB2",
    "stress",
    "Concurrent read and write of one object.",
    needs="bacnet.read bacnet.write bacnet.write.priority",
    capability="load",
    requirements="CON-004 WR-003",
)
async def concurrent_read_and_write(run: Repetition, bacnet: Rig) -> None:
    """Read an object and write it at the same time.

    Said: the old value or the new one for the read, success for the write.
    Seen: one write; the object holds the new value.
    Why: a mixture of two values, or a lost write, shows only under load.
    """
    old, new = drawn(
        bacnet,
        "write",
        lambda: [float(number) + 0.5 for number in run.rng.sample(range(2**20), 2)],
        lambda pair: written(VALVE, pair[1]),
    )
    await hold(bacnet, VALVE, old, PRIORITY)
    read, reply = await run.together(bacnet.call("read", **at(VALVE)), bacnet.call("write", **written(VALVE, new)))
    run.succeeds(read)
    run.one_of(read, "value", old, new)
    run.succeeds(reply, value=new)
    run.witnessed(
        oracle.exactly_one_write(await bacnet.journal(), VALVE, "real", new, priority=PRIORITY),
        oracle.holds(await bacnet.device.image(), {oracle.present(VALVE): new}),
    )


@TASKS.task(
    "SB3",
    "stress",
    "Fifty reads of present values in a row.",
    needs="bacnet.read",
    capability="load",
    requirements="CON-006",
)
async def rapid_reads(run: Repetition, bacnet: Rig) -> None:
    """Read fifty present values, one call after the other.

    Said: the right value in every answer.
    Seen: for each call a read of its object, during the call.
    Why: leaks, caches and identifiers that are used up show in a long series only.
    """
    targets = [(ZONE, SUPPLY)[index % 2] for index in range(RAPID_CALLS)]
    asked = []
    values = [half(run) for _ in range(2)]
    for target, value in zip((ZONE, SUPPLY), values, strict=True):
        await hold(bacnet, target, value)
    for index, target in enumerate(targets):
        reply = await bacnet.call("read", **at(target))
        run.succeeds(reply, value=values[index % 2])
        asked.append((reply, read_of(target)))
    run.witnessed(fresh(await bacnet.journal(), *asked))


@TASKS.task(
    "SB4",
    "stress",
    "Endpoint restart between reads of a present value.",
    needs="bacnet.any_read bacnet.recovery",
    capability="outages",
    requirements="REC-001 REC-002 RD-004",
    keys="bacnet.recovery",
)
async def restart(run: Repetition, bacnet: Rig) -> None:
    """Read a present value; again after the device was stopped; and again after it was started.

    Said: success; then a failure with `connect_failed`, `connection_lost` or `timeout`; then success in the same
        session.
    Seen: a read after the device is back.
    Why: an outage of the line must not need a person who restarts the adapter, and old values must not hide it.
    """
    await survive_a_restart(run, bacnet, read=read_of(ZONE))


@restart.after
async def a_failed_command_is_not_delivered_later(run: Repetition, bacnet: Rig) -> None:
    """Write while the device is away, and read when it is back.

    Said: a failure for the write, success for the read.
    Seen: no write: what was reported as failed is not made up for.
    """
    await a_failed_write_is_not_made_up_for(run, bacnet)


@TASKS.task(
    "R-bacnet",
    "recovery",
    "Recover from a restart of the BACnet device.",
    needs="bacnet.any_read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
    keys="bacnet.recovery",
)
async def recovery(run: Repetition, bacnet: Rig) -> None:
    """Read; again after the device was stopped; then, after it was started, in the same session and in a fresh one with
    a new process.

    Said: success; a failure of the connection; success in both sessions.
    Seen: the reads of both sessions, and nothing that changes the plant.
    Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
    """
    await outage(run, bacnet)


@recovery.after
async def the_adapter_starts_without_its_device(run: Repetition, bacnet: Rig) -> None:
    """Start the adapter while its device is down, ask, and ask again when it is there.

    Said: a failure of the connection first, success then.
    """
    await start_without_device(run, bacnet)
