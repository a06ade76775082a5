"""The tasks on BACnet/IP.

Each function is one repetition, as in :mod:`.modbus`. Values are halves, which a REAL holds exactly.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from pytest_otmcp.protocols.bacnet import calls, oracle
from pytest_otmcp.protocols.bacnet.points import (
    DEVICE,
    LEVEL,
    PRIORITY,
    SETPOINT,
    SUPPLY,
    VALVE,
    ZONE,
    positive_half,
    setting,
    value_of,
)
from pytest_otmcp.protocols.exercise import Asked, Contended
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from . import further
from .common import CONNECTION_FAULTS, QUIET_S, RAPID_CALLS, a_delay_shows, untold

__all__ = ["TASKS"]

SILENT_DEVICE = 54321
FAN = ("binary-output", 1)
OTHER_PRIORITY = 5
UNKNOWN_OBJECT, VALUE_OUT_OF_RANGE, WRITE_ACCESS_DENIED = (1, 31), (2, 37), (2, 40)


TASKS = further.Further("bacnet", witness=oracle.WITNESS, was_read=calls.was_read, one_write=calls.one_write)


def valve(value: float | None) -> Asked:
    """Return the write of the valve."""
    return value_of(VALVE).write(value)


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
    reply = await bacnet.call("read", **{**value_of(ZONE).reads().inputs, "device": SILENT_DEVICE})
    run.fails(reply, *CONNECTION_FAULTS, "illegal_address", "gateway_target_no_response", requirement="ADR-001")


further.ping(
    TASKS,
    "B1",
    "Ping the adapter and confirm that the BACnet device answers.",
    seen="{device} answers at least one request during the call: a Who-Is or a read.",
    why="A status from memory still says so when the plant is gone, and a datagram that was sent proves nothing.",
    after=a_slow_device_is_reported_as_slow,
)


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
    points = (value_of(ZONE), value_of(SUPPLY), value_of(SETPOINT, slot=PRIORITY))
    numbers = [point.read(positive_half(run.rng)) for point in points]
    state = run.rng.randrange(2)
    fan = value_of(FAN, slot=PRIORITY).read(state)
    await further.set_up(bacnet, *numbers, fan)
    replies = [await further.call(bacnet, asked) for asked in (*numbers, fan)]
    for reply, asked in zip(replies[:3], numbers, strict=True):
        run.succeeds(reply, **asked.outputs)
    # The standard has numbers and names for the states.
    if run.succeeds(replies[3]):
        run.one_of(replies[3], "value", state, ("inactive", "active")[state], bool(state), requirement="RD-001")
    journal = await bacnet.journal()
    run.witnessed(
        TASKS.seen(journal, {}, *zip(replies, (*numbers, fan), strict=True)),
        oracle.no_state_changing_request(journal, requirement="MCP-008"),
    )


further.ends_with_its_stdin(TASKS, read_present_values)


def raised(run: Repetition) -> Asked:
    """Return the command of the valve at priority 8, which then holds it there."""
    asked = valve(40.5 + run.rep)
    return replace(asked, points={**asked.points, oracle.slot(VALVE, PRIORITY): asked.inputs["value"]})


further.reads_back(
    TASKS,
    "B3",
    "Command a valve at priority 8 and read it back.",
    needs="write write.priority read",
    write=raised,
    read=value_of(VALVE).read_again,
    judge=calls.at_its_priority,
    asked="Write an analog output at priority 8, and read it.",
    seen="One write of this REAL at this priority; the slot and the present value hold it, every other slot and object stays as it was.",
    why="A write without its priority takes the plant out of the hands of its operators, or stays without effect.",
)

further.guard(
    TASKS,
    "B4",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="write read",
    write=lambda run: valve(99.5),
    read=lambda run: value_of(ZONE).reads(),
    seen="No service that changes the device, no time synchronization; the device holds what it held.",
)


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
    await bacnet.device.poke(**setting(VALVE, kept + 0.5, OTHER_PRIORITY))
    before = await bacnet.device.image()
    asked = valve(value + 0.5)
    reply = await further.call(bacnet, asked)
    after = await bacnet.device.image()
    if not reply.success:
        run.fails(reply, "verify_failed", outcome="applied", requirement="WR-001")
    elif reply.outputs.get("value") != kept + 0.5:
        run.judge(reply, [oracle.not_effective(reply.outputs.get("value"), kept + 0.5, reply.label)])
    run.witnessed(
        calls.at_its_priority(await bacnet.journal(), {}, asked),
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
    lower = positive_half(run.rng)
    for priority, value in ((16, lower), (PRIORITY, lower + 1)):
        await bacnet.device.poke(**setting(VALVE, value, priority))
    before = await bacnet.device.image()
    asked = valve(None)
    run.succeeds(await further.call(bacnet, asked))
    run.witnessed(
        calls.at_its_priority(await bacnet.journal(), {}, asked),
        oracle.only_changed(
            before,
            await bacnet.device.image(),
            {oracle.present(VALVE): lower, oracle.slot(VALVE, PRIORITY): None},
        ),
    )


missing = further.missing(
    TASKS,
    "FB1",
    "Read an object that the device does not have (analog-input 77).",
    needs="read",
    key="missing_instance",
    make=lambda instance: value_of(("analog-input", int(instance))).reads(),
    reached=calls.reached,
    refused=lambda entries: oracle.refused_with(entries, *UNKNOWN_OBJECT),
    trace=dict(zip(("error_class", "error_code"), UNKNOWN_OBJECT, strict=True)),
    partly=False,
    seen="The read, which the device refuses with unknown-object.",
)


@missing.after
async def an_object_that_is_there_can_be_read(run: Repetition, bacnet: Rig) -> None:
    """Read an object that is there; then while the device answers about another object.

    Said: success, and the value; then no value of the other object as the one that was asked for.
    """
    rule = {"object": "analog-input,1", "action": {"answer_instance": 2}}
    asked = value_of(ZONE).read(positive_half(run.rng))
    await further.another_answers(run, bacnet, asked, rule, "protocol_error", *CONNECTION_FAULTS)


async def _refused(run: Repetition, bacnet: Rig, asked: Asked, code: str, error: tuple[int, int]) -> None:
    """Write what the device refuses, or what the adapter knows that it would refuse."""
    before = await bacnet.device.image()
    reply = await further.call(bacnet, asked)
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
    await _refused(run, bacnet, LEVEL.writes(50.5), "illegal_value", VALUE_OUT_OF_RANGE)


@write_beyond_the_limit.after
async def a_value_within_the_limit_is_accepted(run: Repetition, bacnet: Rig) -> None:
    """Write a value within the limit.

    Said: success.
    Seen: one write, and the value in the object.
    """
    asked = LEVEL.write(7.5)
    run.succeeds(await further.call(bacnet, asked), **asked.outputs)
    await TASKS.sees_and_holds(run, bacnet, asked)


further.refused_by_itself(
    TASKS, "FB3", "Write a text to an analog output.", needs="write", make=lambda run: value_of(VALVE).writes("abc")
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
    await _refused(run, bacnet, value_of(ZONE).writes(1.5), "not_writable", WRITE_ACCESS_DENIED)


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
        asked = value_of(VALVE, priority=priority).writes(30.5)
        await further.not_sent(TASKS, run, bacnet, asked, "invalid_input", "range_overflow", requirement="ADR-002")


@write_at_no_priority.after
async def nothing_follows_a_refusal(run: Repetition, bacnet: Rig) -> None:
    """Wait, then write at a priority that exists.

    Said: success.
    Seen: nothing that changes the plant at first; then one write.
    """
    await bacnet.stays_quiet(QUIET_S, partial(oracle.no_state_changing_request, requirement="ADR-002"))
    asked = value_of(VALVE, priority=10).write(30.5)
    run.succeeds(await further.call(bacnet, asked), **asked.outputs)
    run.witnessed(calls.at_its_priority(await bacnet.journal(), {}, asked))


def four(run: Repetition) -> list[Asked]:
    """Return the reads of four objects."""
    points = (value_of(ZONE), value_of(SUPPLY), value_of(VALVE, slot=1), value_of(SETPOINT, slot=1))
    numbers = run.rng.sample(range(2**20), 4)
    return [point.read(number + 0.5) for point, number in zip(points, numbers, strict=True)]


further.four_at_once(TASKS, "SB1", "Four concurrent reads of present values.", needs="read", make=four)


def contended(run: Repetition) -> Contended:
    """Return a read and a write of the valve."""
    old, new = (number + 0.5 for number in run.rng.sample(range(2**20), 2))
    return value_of(VALVE, slot=PRIORITY).contended(old, new)


further.beside(
    TASKS,
    "SB2",
    "Concurrent read and write of one object.",
    needs="read write write.priority",
    make=contended,
)


def fifty(run: Repetition) -> list[Asked]:
    """Return reads of two objects in turn."""
    pair = [value_of(target).read(positive_half(run.rng)) for target in (ZONE, SUPPLY)]
    return [pair[index % 2] for index in range(RAPID_CALLS)]


further.rapid(TASKS, "SB3", "Fifty reads of present values in a row.", needs="read", make=fifty)

further.restart(
    TASKS,
    "SB4",
    "Endpoint restart between reads of a present value.",
    read=partial(oracle.read_from_device, target=ZONE),
)

further.recovery(TASKS, "Recover from a restart of the BACnet device.")
