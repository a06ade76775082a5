"""The tasks on PROFINET IO.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
device. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from functools import partial

from pytest_otmcp.protocols.exercise import Asked, Contended
from pytest_otmcp.protocols.profinet import calls, oracle
from pytest_otmcp.protocols.profinet.points import (
    DRIVE,
    PUMP,
    SIZES,
    STATION,
    VALVES,
    bytes_of,
    inputs_of,
    outputs_of,
    record_of,
)
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from . import further
from .common import NOTHING_SENT, RAPID_CALLS, a_meaningless_switch_enables_nothing, untold

__all__ = ["TASKS"]

NEIGHBOUR = "kit-neighbour"
LIMITED, READ_ONLY = 1, 2
"""Indexes of a record with numbers up to 1000, and of one that is not written."""
LONGEST_WATCHDOG_S = 1.92
"""Seconds: the largest watchdog of a relation. Whatever a controller has agreed, its outputs must outlive it."""
SHOWN_S = 5
"""Seconds for which a station is to show itself; one Signal lasts three."""


TASKS = further.Further("profinet", witness=oracle.WITNESS, was_read=calls.was_read, one_write=calls.one_write)


def some_inputs(run: Repetition, slot: int = VALVES) -> Asked:
    """Return the read of a slot's inputs, which are set at random."""
    return inputs_of(slot).read(list(run.rng.randbytes(SIZES[slot])))


def some_outputs(run: Repetition) -> Asked:
    """Return the write of outputs. Random ones are not those that a controller repeats, which would be no write."""
    return outputs_of(PUMP).write(bytes_of(run.rng, PUMP))


def some_record(run: Repetition) -> Asked:
    """Return the write of a record that any bytes fit into."""
    return record_of(VALVES).write(bytes_of(run.rng, VALVES))


further.ping(TASKS, "N1", "Ping the adapter and confirm that a station answers.")

further.reads(
    TASKS,
    "N2",
    "Read the inputs of a slot.",
    needs="read_inputs",
    make=lambda run: [some_inputs(run)],
    seen="The inputs are asked for, as a record or in cyclic frames, and the device gets no other outputs.",
    why="A process image from memory looks right until an operator acts on it.",
)

write_outputs = further.reads_back(
    TASKS,
    "N3",
    "Write the outputs of a slot.",
    needs="write_outputs",
    write=some_outputs,
    asked="Write the eight output bytes of slot 2.",
    said="These bytes.",
    seen="A relation with cyclic data, if there was none; one change of the outputs, to these bytes; no other slot gets others.",
    why="An adapter that sends one frame without a relation has written nothing, and the device says nothing of it.",
)


@write_outputs.after
async def the_outputs_are_kept_alive(run: Repetition, profinet: Rig) -> None:
    """Write, and wait for longer than any watchdog of a relation.

    Said: success.
    Seen: the slot still has the outputs.
    Why: what is sent once and not repeated falls at the watchdog.
    """
    asked = some_outputs(run)
    run.succeeds(await further.call(profinet, asked), **asked.outputs)
    await profinet.watch(LONGEST_WATCHDOG_S)
    run.witnessed(oracle.holds(await profinet.device.image(), asked.points))


further.reads_back(
    TASKS,
    "N4",
    "Write a record and read it back for verification.",
    needs="write_record",
    write=some_record,
    read=record_of(VALVES).read_again,
    facet="read_record",
    seen="One Write of the whole record, which the device confirms; everything else in it stays as it was.",
)


@TASKS.task(
    "N5",
    "normal",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="profinet.write_outputs profinet.read_inputs profinet.guard",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
)
async def guarded_write(run: Repetition, profinet_ro: Rig) -> None:
    """Write outputs, and a record where the adapter can, through the adapter that was started with writes disabled, and read inputs.

    Said: refusals with `writes_disabled` and the outcome `not_sent`; then the inputs.
    Seen: no relation with cyclic data, no cyclic outputs, no Write and no DCP Set; the device holds what it held.
    Why: who reads inputs by cyclic data becomes the device's controller, and drives its outputs to zero.
    """
    read = some_inputs(run)
    await further.set_up(profinet_ro, read)
    before = await profinet_ro.device.image()
    for asked in (some_outputs(run), some_record(run)):
        if profinet_ro.subject.claims(asked.operation):
            reply = await further.call(profinet_ro, asked)
            run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.succeeds(await further.call(profinet_ro, read), **read.outputs)
    run.witnessed(
        oracle.nothing_driven(await profinet_ro.journal()),
        oracle.only_changed(before, await profinet_ro.device.image(), {}, otherwise="WR-004"),
    )


@guarded_write.after
async def the_guard_was_put_to_the_test(run: Repetition, profinet: Rig, profinet_ro: Rig) -> None:
    """Read with writes disabled, and write the same with writes enabled: both must work, or the refusal proves nothing. Then write through
    the adapter that was started with a write switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
    Seen: over the whole life of the read-only sessions, their end included, nothing that drives the device.
    """
    read, asked = inputs_of(VALVES).reads(), some_outputs(run)
    run.succeeds(await further.call(profinet_ro, read))
    run.succeeds(await further.call(profinet, asked), **asked.outputs)
    run.witnessed(
        oracle.some_exchange(await profinet_ro.journal()),
        calls.one_write(await profinet.journal(), {}, asked),
    )
    await profinet_ro.close_session()
    run.witnessed(oracle.nothing_driven_by(await profinet_ro.follow(oracle.Drives)))
    await a_meaningless_switch_enables_nothing(run, profinet_ro, asked.operation, **asked.inputs)


@TASKS.task(
    "N6",
    "normal",
    "Write outputs that fall with their controller.",
    needs="profinet.write_outputs",
    capability="writing",
    requirements="WR-001 MCP-009",
)
async def outputs_depend_on_their_controller(run: Repetition, profinet: Rig) -> None:
    """Write outputs.

    Said: success.
    Seen: the slot has them, and the device has a controller.
    Why: outputs that nobody keeps alive fall a moment later.
    """
    asked = some_outputs(run)
    run.succeeds(await further.call(profinet, asked), **asked.outputs)
    image = await profinet.device.image()
    run.witnessed(oracle.holds(image, asked.points), oracle.has_controller(image))


@outputs_depend_on_their_controller.after
async def outputs_fall_with_their_controller(run: Repetition, profinet: Rig) -> None:
    """Write outputs, and end the session.

    Said: success.
    Seen: the outputs of the device are cleared, because its relation was released, or at the watchdog.
    Why: outputs that nobody answers for any more must not stay on.
    """
    asked = some_outputs(run)
    run.succeeds(await further.call(profinet, asked), **asked.outputs)
    await profinet.fresh_session()
    if oracle.cleared(await profinet.device.image(), requirement="MCP-009"):
        await further.watchdog(profinet, LONGEST_WATCHDOG_S)
    run.witnessed(oracle.cleared(await profinet.device.image(), requirement="MCP-009"))


@TASKS.task(
    "N7",
    "normal",
    "Find the stations of the network.",
    needs="profinet.discover",
    capability="reading",
    requirements="RD-001 RD-004",
)
async def discover(run: Repetition, profinet: Rig) -> None:
    """Look for stations; in every other repetition one of the two is off the network.

    Said: the names of those that are there, and no more.
    Seen: each of these was asked during the call, and answered.
    Why: a list from a configuration shows stations that are not there, and misses those that are.
    """
    there = [STATION, NEIGHBOUR] if run.rep % 2 else [STATION]
    image = await profinet.device.image()
    await profinet.device.poke(station=NEIGHBOUR, present=NEIGHBOUR in there)
    reply = await profinet.call("discover")
    await profinet.device.poke(station=NEIGHBOUR, present=True)
    run.succeeds(reply, names=there)
    seen = reply.during(await profinet.journal())
    run.witnessed(*(oracle.station_answered(seen, oracle.mac_of(image, name)) for name in there))


@TASKS.task(
    "N8",
    "normal",
    "Give a station a name.",
    needs="profinet.set_name",
    capability="writing",
    requirements="WR-001 WR-003",
)
async def set_name(run: Repetition, profinet: Rig) -> None:
    """Give the neighbour another name.

    Said: success.
    Seen: one DCP Set; the station has the name.
    Why: a device that has lost its name is not found by its controller, and one with another's name answers in its place.
    """
    name = f"kit-{run.rng.randrange(10**6)}"
    mac = oracle.mac_of(await profinet.device.image(), NEIGHBOUR)
    reply = await profinet.call("set_name", mac=mac, name=name)
    after = await profinet.device.image()
    await profinet.device.poke(station=oracle.name_of(after, mac), name=NEIGHBOUR)
    run.succeeds(reply, name=name)
    run.witnessed(oracle.named_once(await profinet.journal(), mac, name), oracle.has_name(after, mac, name))


@TASKS.task(
    "N9",
    "normal",
    "Let a station show itself.",
    needs="profinet.identify",
    capability="reading",
    requirements="RD-004 MCP-008",
)
async def identify(run: Repetition, profinet: Rig) -> None:
    """Let the neighbour blink for five seconds.

    Said: success.
    Seen: a DCP Signal during the call, and nothing that changes the device.
    Why: a person who looks for a cabinet by its blinking light opens another one.
    """
    mac = oracle.mac_of(await profinet.device.image(), NEIGHBOUR)
    reply = await profinet.call("identify", mac=mac, seconds=SHOWN_S)
    run.succeeds(reply)
    journal = await profinet.journal()
    run.witnessed(
        oracle.signalled(reply.during(journal), mac),
        oracle.no_state_changing_request(journal, requirement="MCP-008"),
    )


@TASKS.task(
    "FN1",
    "fault",
    "Read the inputs of a slot that does not exist and expect a structured error.",
    needs="profinet.read_inputs",
    capability="refusing",
    requirements="ERR-002 ENV-007 RD-005",
    keys="profinet.probes.missing_slot",
)
async def read_missing_slot(run: Repetition, profinet: Rig) -> None:
    """Read the inputs of a slot that the device does not have.

    Said: a failure with `illegal_address`. An adapter that refuses by a list of its own may also say `invalid_input config_error`;
        nothing was sent then.
    Seen: the read, which the device refuses with B2, or none.
    Why: an assistant that gets zeros from a slot that does not exist believes the zeros.
    """
    missing = profinet.subject.probe("missing_slot")
    reply = await profinet.call("read_inputs", station=STATION, slot=missing, subslot=1)
    seen = reply.during(await profinet.journal())
    if oracle.reached(seen, (missing, 1)):
        run.fails(reply, "illegal_address", requirement="ERR-002")
        run.witnessed(oracle.refused_with(seen, "b2"))
    else:
        run.fails(
            reply, "illegal_address", "invalid_input", "config_error", outcome=NOTHING_SENT, requirement="ERR-002"
        )


@read_missing_slot.after
async def a_slot_that_is_there_can_be_read(run: Repetition, profinet: Rig) -> None:
    """Read the inputs of a slot that is there; then while the device answers as if it were another; then the slot again.

    Said: success and the inputs; then no inputs of the other one as those that were asked for; then success again.
    """
    rule = {"service": "read", "slot": VALVES, "action": {"answer_slot": DRIVE}}
    codes = ("protocol_error", "timeout", "connection_lost")
    # One that reads cyclic frames does not see what is wrong in a record.
    await further.another_answers(
        run, profinet, some_inputs(run), rule, *codes, must_fail=lambda seen: oracle.reached(seen, (VALVES, 1))
    )


def refused_record(id: str, title: str, *, make: further.Of[Asked], codes: str, status: str, why: str) -> None:
    """Declare the item that writes a record which the device refuses."""

    @TASKS.item(
        id,
        "fault",
        title,
        needs="write_record",
        capability="refusing",
        requirements="ERR-002 ERR-006",
        told={"said": f"A failure with {' or '.join(f'`{code}`' for code in codes.split())}.", "why": why},
    )
    async def steps(run: Repetition, at: Rig) -> None:
        """Write a record that {device} refuses.

        Said: a failure with the code of the error.
        Seen: the Write, which {device} refuses, or none; {device} holds what it held.
        Why: as the item says.
        """
        before = await at.device.image()
        reply = await further.call(at, make(run))
        seen = reply.during(await at.journal())
        run.fails(reply, *codes.split(), outcome=("rejected", "not_sent"), requirement="ERR-002")
        if oracle.written(seen):
            run.witnessed(oracle.refused_with(seen, status))
        run.witnessed(oracle.only_changed(before, await at.device.image(), {}, otherwise=untold(reply, "ERR-002")))


refused_record(
    "FN2",
    "Write a record that does not exist and expect a structured error.",
    make=lambda run: record_of(DRIVE, 77, size=2).writes([0, run.rng.randrange(256)]),
    codes="illegal_address",
    status="b0",
    why="A parameter that went nowhere is missed when the drive runs.",
)

refused_record(
    "FN3",
    "Write a value beyond a record's range and expect the device's refusal.",
    make=lambda run: record_of(DRIVE, LIMITED, size=2).writes(list(run.rng.randrange(1001, 2**16).to_bytes(2))),
    codes="illegal_value range_overflow",
    status="b7",
    why="A setpoint that the device refuses was told as set.",
)

refused_record(
    "FN4",
    "Write four bytes into a record of two and expect the device's refusal.",
    make=lambda run: record_of(DRIVE, LIMITED, size=4).writes(list(run.rng.randbytes(4))),
    codes="type_mismatch limit_exceeded invalid_input",
    status="b1",
    why="What is cut down to fit is another value.",
)

refused_record(
    "FN5",
    "Write a record that is only read and expect the device's refusal.",
    make=lambda run: record_of(DRIVE, READ_ONLY, size=4).writes(list(run.rng.randbytes(4))),
    codes="access_denied not_writable",
    status="b6",
    why="Who believes that a measured value was set does not look at it again.",
)

further.refused_by_itself(
    TASKS,
    "FN6",
    "Write three bytes to a slot with eight bytes of outputs and expect adapter rejection.",
    needs="write_outputs",
    make=lambda run: outputs_of(PUMP).writes([1, 2, 3]),
    codes="limit_exceeded type_mismatch range_overflow invalid_input",
    why="Outputs of another length than the modules have make a frame in which all others have moved.",
)

further.overflow(
    TASKS,
    "FN7",
    "Write the value 300 to an output byte and expect adapter rejection.",
    needs="write_outputs",
    make=lambda run: outputs_of(PUMP).writes([300, *bytes_of(run.rng, PUMP)[1:]]),
    fits=lambda run, at: outputs_of(PUMP).write([0xFF, *bytes_of(run.rng, PUMP)[1:]]),
    requirements="ADR-003 ERR-006",
    why="300 cut down to 8 bits is 44, a value that nobody asked for.",
)


@TASKS.task(
    "FN8",
    "fault",
    "Write outputs of a device of another controller and expect access denied.",
    needs="profinet.write_outputs",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def write_to_anothers_device(run: Repetition, profinet: Rig) -> None:
    """Write outputs while another controller has the device.

    Said: a failure with `access_denied device_busy`.
    Seen: no change of the outputs.
    Why: a device with two controllers does what the last one said, and the other one does not know.
    """
    await profinet.device.poke(controller=True)
    before = await profinet.device.image()
    asked = some_outputs(run)
    reply = await further.call(profinet, asked)
    after = await profinet.device.image()
    await profinet.device.poke(controller=False)
    run.fails(reply, "access_denied", "device_busy", requirement="ERR-002")
    run.witnessed(oracle.only_changed(before, after, {}, otherwise=untold(reply, "ERR-002")))


@TASKS.task(
    "FN9",
    "fault",
    "Write outputs of a device with other modules than the configuration says.",
    needs="profinet.write_outputs",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def write_to_other_modules(run: Repetition, profinet: Rig) -> None:
    """Write outputs while there is another module in the slot.

    Said: a failure with `config_error`.
    Seen: no outputs for it.
    Why: a module that was exchanged for one of another kind does something else with the same bytes.
    """
    module = oracle.module_in(await profinet.device.image(), PUMP)
    await profinet.device.poke(slot=PUMP, module=f"{run.rng.randrange(0x1000, 2**32):08x}")
    # A relation that is there was made with the right modules.
    await profinet.device.poke(controller=False)
    before = await profinet.device.image()
    asked = some_outputs(run)
    reply = await further.call(profinet, asked)
    after = await profinet.device.image()
    await profinet.device.poke(slot=PUMP, module=module)
    run.fails(reply, "config_error", outcome=("not_sent", "rejected"), requirement="ERR-002")
    run.witnessed(oracle.only_changed(before, after, {}, otherwise=untold(reply, "ERR-002")))


@TASKS.task(
    "FN10",
    "fault",
    "Give a station a name that none can have and expect adapter rejection.",
    needs="profinet.set_name",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def set_an_illegal_name(run: Repetition, profinet: Rig) -> None:
    """Give the neighbour a name with a capital letter and an underscore.

    Said: a failure with `invalid_input illegal_value`.
    Seen: no name that the station takes.
    Why: an adapter that makes another name of it leaves a station that nobody finds.
    """
    before = await profinet.device.image()
    mac = oracle.mac_of(before, NEIGHBOUR)
    reply = await profinet.call("set_name", mac=mac, name=f"Kit_{run.rng.randrange(100)}")
    after = await profinet.device.image()
    await profinet.device.poke(station=oracle.name_of(after, mac), name=NEIGHBOUR)
    run.fails(reply, "invalid_input", "illegal_value", outcome=("not_sent", "rejected"), requirement="ERR-002")
    run.witnessed(oracle.has_name(after, mac, NEIGHBOUR, requirement=untold(reply, "ERR-002")))


def four(run: Repetition) -> list[Asked]:
    """Return the reads of both slots with inputs, each twice: what comes must be told apart by the numbers of calls."""
    return [*(both := [some_inputs(run, slot) for slot in (DRIVE, VALVES)]), *both]


further.four_at_once(
    TASKS,
    "SN1",
    "Four concurrent reads of inputs.",
    needs="read_inputs",
    make=four,
    why="An answer that belongs to another call is a wrong value that looks right.",
)


def inputs_and_outputs(run: Repetition) -> Contended:
    """Return a read of inputs beside a write of outputs: they may cross on the cable."""
    read, write = some_inputs(run), some_outputs(run)
    return Contended(old=None, new=(), pokes=read.pokes, read=read, output="values", writes=(write,))


further.beside(
    TASKS,
    "SN2",
    "Concurrent read of inputs and write of outputs.",
    needs="read_inputs write_outputs",
    make=inputs_and_outputs,
    asked="Read the inputs of a slot and write the outputs of another at the same time.",
    said="The inputs for the read, success for the write.",
    why="A lost write, or inputs of another moment, show only under load.",
)

further.rapid(
    TASKS,
    "SN3",
    "Fifty reads of inputs in a row.",
    needs="read_inputs",
    make=lambda run: [some_inputs(run, DRIVE) for _ in range(RAPID_CALLS)],
    why="Leaks, caches and numbers of calls that are used up show in a long series only.",
)

further.restart(
    TASKS,
    "SN4",
    "Restart of the device between reads of inputs.",
    read_inputs=partial(oracle.inputs_were_read, place=(VALVES, 1)),
)

further.recovery(TASKS, "Recover from a restart of the PROFINET device.")
