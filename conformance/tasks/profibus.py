"""The tasks on PROFIBUS DP.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
slaves. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from functools import partial

from pytest_otmcp.protocols.exercise import Asked, Contended
from pytest_otmcp.protocols.profibus import calls, oracle
from pytest_otmcp.protocols.profibus.points import DRIVE, OTHERS, SIZES, VALVES, bytes_of, inputs_of, outputs_of
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from . import further
from .common import NOTHING_SENT, RAPID_CALLS, a_meaningless_switch_enables_nothing, untold

__all__ = ["TASKS"]

STATIONS = (VALVES, DRIVE, OTHERS)
KEPT_ALIVE = 1.5
"""For how many times of its watchdog a slave is watched."""
LONGEST_WATCHDOG_S = 5.0
"""Seconds: a slave whose watchdog is longer is watched no longer than that."""


TASKS = further.Further("profibus", witness=oracle.WITNESS, was_read=calls.was_read, one_write=calls.one_write)


def some_inputs(run: Repetition, station: int = VALVES) -> Asked:
    """Return the read of a slave's inputs, which are set at random."""
    return inputs_of(station).read(list(run.rng.randbytes(SIZES[station])))


def some_outputs(run: Repetition) -> Asked:
    """Return the write of outputs of the valves. Random ones are not those that a master repeats, which would be no write."""
    return outputs_of(VALVES).write(bytes_of(run.rng, VALVES))


further.ping(TASKS, "P1", "Ping the adapter and confirm that a slave answers.")

further.reads(
    TASKS,
    "P2",
    "Read the inputs of a slave.",
    needs="read_inputs",
    make=lambda run: [some_inputs(run)],
    seen="The slave is asked for its inputs, and no slave gets other outputs.",
    why="A process image from memory looks right until an operator acts on it.",
)

write_outputs = further.reads_back(
    TASKS,
    "P3",
    "Write the outputs of a slave.",
    needs="write_outputs",
    write=some_outputs,
    asked="Write the two output bytes of slave 5.",
    said="These bytes.",
    seen="The slave is parameterised and configured, if it was not; one change of its outputs, to these bytes; no other slave gets others.",
    why="A slave that was not parameterised takes no outputs, whatever was sent; one that gets another number of bytes drops them all.",
)


@write_outputs.after
async def the_outputs_are_kept_alive(run: Repetition, profibus: Rig) -> None:
    """Write, and wait for longer than the slave's watchdog.

    Said: success.
    Seen: the slave still has the outputs.
    Why: what is written once and not repeated falls at the watchdog.
    """
    asked = some_outputs(run)
    run.succeeds(await further.call(profibus, asked), **asked.outputs)
    watchdog_s = oracle.watchdog_s(await profibus.device.image(), VALVES)
    await profibus.watch(KEPT_ALIVE * min(watchdog_s or 0.0, LONGEST_WATCHDOG_S))
    run.witnessed(oracle.holds(await profibus.device.image(), asked.points))


@TASKS.task(
    "P4",
    "normal",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="profibus.write_outputs profibus.read_inputs profibus.guard",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
)
async def guarded_write(run: Repetition, profibus_ro: Rig) -> None:
    """Write outputs through the adapter that was started with writes disabled, and read inputs.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`; then the inputs.
    Seen: no Set_Prm, no Chk_Cfg, no Data_Exchange, no Global_Control and no Set_Slave_Add; the slaves hold what they held.
    Why: who reads inputs by exchanging data owns the slave, and drives its outputs to zero.
    """
    read = some_inputs(run)
    await further.set_up(profibus_ro, read)
    before = await profibus_ro.device.image()
    reply = await further.call(profibus_ro, some_outputs(run))
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.succeeds(await further.call(profibus_ro, read), **read.outputs)
    run.witnessed(
        oracle.nothing_driven(await profibus_ro.journal()),
        oracle.only_changed(before, await profibus_ro.device.image(), {}, otherwise="WR-004"),
    )


@guarded_write.after
async def the_guard_was_put_to_the_test(run: Repetition, profibus: Rig, profibus_ro: Rig) -> None:
    """Read with writes disabled, and write the same with writes enabled: both must work, or the refusal proves nothing. Then write through
    the adapter that was started with a write switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
    Seen: over the whole life of the read-only sessions, their end included, nothing that drives a slave.
    """
    run.succeeds(await profibus_ro.call("read_inputs", slave=VALVES))
    asked = some_outputs(run)
    run.succeeds(await further.call(profibus, asked), **asked.outputs)
    run.witnessed(
        oracle.some_exchange(await profibus_ro.journal()),
        calls.one_write(await profibus.journal(), {}, asked),
    )
    await profibus_ro.close_session()
    run.witnessed(oracle.nothing_driven_by(await profibus_ro.follow(oracle.Drives)))
    await a_meaningless_switch_enables_nothing(run, profibus_ro, asked.operation, **asked.inputs)


@TASKS.task(
    "P5",
    "normal",
    "Write outputs that fall with their master.",
    needs="profibus.write_outputs",
    capability="writing",
    requirements="WR-001 MCP-009",
)
async def outputs_depend_on_their_master(run: Repetition, profibus: Rig) -> None:
    """Write outputs.

    Said: success.
    Seen: the slave has them, and a watchdog.
    Why: without a watchdog outputs stay on for ever when their master has died.
    """
    asked = some_outputs(run)
    run.succeeds(await further.call(profibus, asked), **asked.outputs)
    image = await profibus.device.image()
    run.witnessed(
        oracle.holds(image, asked.points),
        oracle.has_watchdog(image, VALVES),
    )


@outputs_depend_on_their_master.after
async def outputs_fall_with_their_master(run: Repetition, profibus: Rig) -> None:
    """Write outputs, and end the session.

    Said: success.
    Seen: the slave clears its outputs, because it was told to (Global_Control) or because of its watchdog.
    Why: outputs that nobody answers for any more must not stay on.
    """
    asked = some_outputs(run)
    run.succeeds(await further.call(profibus, asked), **asked.outputs)
    watchdog_s = oracle.watchdog_s(await profibus.device.image(), VALVES)
    await profibus.fresh_session()
    if watchdog_s is not None and oracle.cleared(await profibus.device.image(), VALVES, requirement="MCP-009"):
        await further.watchdog(profibus, watchdog_s, station=VALVES)
    run.witnessed(oracle.cleared(await profibus.device.image(), VALVES, requirement="MCP-009"))


@TASKS.task(
    "P6",
    "normal",
    "Find the stations of the line.",
    needs="profibus.scan_bus",
    capability="reading",
    requirements="RD-001 RD-004",
)
async def scan_bus(run: Repetition, profibus: Rig) -> None:
    """Look for stations while one of the three is off the line.

    Said: the addresses of the two others, and no more.
    Seen: each of these was asked during the call, and answered.
    Why: a list from a configuration shows stations that are not there, and misses those that are.
    """
    absent = run.rng.choice(STATIONS)
    there = [station for station in STATIONS if station != absent]
    await profibus.device.poke(station=absent, present=False)
    reply = await profibus.call("scan_bus")
    await profibus.device.poke(station=absent, present=True)
    run.succeeds(reply, addresses=there)
    seen = reply.during(await profibus.journal())
    run.witnessed(*(oracle.answered_by(seen, station) for station in there))


@TASKS.task(
    "FP1",
    "fault",
    "Read the inputs of a station that does not exist and expect a structured error.",
    needs="profibus.read_inputs",
    capability="refusing",
    requirements="ERR-002 ENV-007 RD-005",
    keys="profibus.probes.missing_station",
)
async def read_missing_station(run: Repetition, profibus: Rig) -> None:
    """Read the inputs of an address at which there is no station.

    Said: a failure with `timeout`. An adapter that refuses by a list of its own may also say `illegal_address`, `invalid_input` or
        `config_error`; nothing was sent then.
    Seen: the request, which nobody answers, or none.
    Why: an assistant that gets zeros from a station that does not exist believes the zeros.
    """
    missing = profibus.subject.probe("missing_station")
    reply = await profibus.call("read_inputs", slave=missing)
    if oracle.reached(reply.during(await profibus.journal()), missing):
        run.fails(reply, "timeout", requirement="ERR-002")
    else:
        codes = ("illegal_address", "invalid_input", "config_error")
        run.fails(reply, *codes, outcome=NOTHING_SENT, requirement="ERR-002")


@read_missing_station.after
async def a_station_that_is_there_can_be_read(run: Repetition, profibus: Rig) -> None:
    """Read the inputs of a station that is there; then while it answers as if it were another.

    Said: success and the inputs; then no inputs of the other one as those that were asked for; then success again.
    """
    rule = {"station": VALVES, "action": {"answer_station": DRIVE}}
    await further.another_answers(run, profibus, some_inputs(run), rule, "protocol_error", "timeout", "connection_lost")


further.refused_by_itself(
    TASKS,
    "FP2",
    "Write three bytes to a slave with two bytes of outputs and expect adapter rejection.",
    needs="write_outputs",
    make=lambda run: outputs_of(VALVES).writes([*bytes_of(run.rng, VALVES), 1]),
    codes="limit_exceeded type_mismatch range_overflow invalid_input",
    why="A slave that gets another number of bytes than was configured leaves data exchange, and all of its outputs fall.",
)

further.overflow(
    TASKS,
    "FP3",
    "Write the value 300 to an output byte and expect adapter rejection.",
    needs="write_outputs",
    make=lambda run: outputs_of(VALVES).writes([300, *bytes_of(run.rng, VALVES)[1:]]),
    fits=lambda run, at: outputs_of(VALVES).write([0xFF, *bytes_of(run.rng, VALVES)[1:]]),
    requirements="ADR-003 ERR-006",
    why="300 cut down to 8 bits is 44, a value that nobody asked for.",
)


@TASKS.task(
    "FP4",
    "fault",
    "Write to a slave of another master and expect access denied.",
    needs="profibus.write_outputs",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def write_to_anothers_slave(run: Repetition, profibus: Rig) -> None:
    """Write the output of slave 9, which another master has parameterised and drives.

    Said: a failure with `access_denied` and the outcome `not_sent` or `rejected`. An adapter whose configuration does not have the slave
        may also say `illegal_address` or `config_error`; nothing was sent then.
    Seen: no change of its output.
    Why: a slave with two masters does what the last one said, and the other one does not know.
    """
    before = await profibus.device.image()
    reply = await profibus.call("write_outputs", slave=OTHERS, data=[run.rng.randrange(1, 0x100)])
    if oracle.reached(reply.during(await profibus.journal()), OTHERS):
        run.fails(reply, "access_denied", outcome=("not_sent", "rejected"), requirement="ERR-002")
    else:
        codes = ("access_denied", "illegal_address", "config_error")
        run.fails(reply, *codes, outcome="not_sent", requirement="ERR-002")
    run.witnessed(oracle.only_changed(before, await profibus.device.image(), {}, otherwise=untold(reply, "ERR-002")))


@TASKS.task(
    "FP5",
    "fault",
    "Write to a slave with another ident number than the configuration says.",
    needs="profibus.write_outputs",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def write_to_another_device(run: Repetition, profibus: Rig) -> None:
    """Write the outputs of slave 5 while there is another device at its address.

    Said: a failure with `config_error`.
    Seen: no outputs for it.
    Why: a device that was exchanged for one of another kind does something else with the same bytes.
    """
    await profibus.device.poke(station=VALVES, ident=f"{run.rng.randrange(0x8000):04x}")
    before = await profibus.device.image()
    asked = some_outputs(run)
    reply = await further.call(profibus, asked)
    after = await profibus.device.image()
    await profibus.device.poke(station=VALVES, ident=oracle.IDENT[VALVES])
    run.fails(reply, "config_error", outcome=("not_sent", "rejected"), requirement="ERR-002")
    run.witnessed(
        oracle.no_outputs_sent(
            reply.during(await profibus.journal()),
            VALVES,
            bytes(asked.inputs["data"]),
            requirement=untold(reply, "ERR-002"),
        ),
        oracle.only_changed(before, after, {}, otherwise=untold(reply, "ERR-002")),
    )


def four(run: Repetition) -> list[Asked]:
    """Return the reads of the three slaves, of one of them twice. A telegram has no number that tells their answers apart."""
    three = [some_inputs(run, station) for station in STATIONS]
    return [*three, three[0]]


further.four_at_once(
    TASKS,
    "SP1",
    "Four concurrent reads of inputs.",
    needs="read_inputs",
    make=four,
    why="A telegram has no number: an answer that belongs to another call is a wrong value that looks right.",
)


def inputs_and_outputs(run: Repetition) -> Contended:
    """Return a read of inputs beside a write of outputs: two telegrams may cross on the line."""
    read, write = some_inputs(run), some_outputs(run)
    return Contended(old=None, new=(), pokes=read.pokes, read=read, output="values", writes=(write,))


further.beside(
    TASKS,
    "SP2",
    "Concurrent read of the inputs and write of the outputs of a slave.",
    needs="read_inputs write_outputs",
    make=inputs_and_outputs,
    asked="Read the inputs of a slave and write its outputs at the same time.",
    said="The inputs for the read, success for the write.",
    why="Two telegrams that cross on the line, or a lost write, show only under load.",
)

further.rapid(
    TASKS,
    "SP3",
    "Fifty reads of inputs in a row.",
    needs="read_inputs",
    make=lambda run: [some_inputs(run, DRIVE) for _ in range(RAPID_CALLS)],
    why="Leaks, caches and lines that fall out of step show in a long series only.",
)

further.restart(
    TASKS,
    "SP4",
    "Restart of the slaves between reads of inputs.",
    read_inputs=partial(oracle.inputs_were_read, station=VALVES),
)

further.recovery(TASKS, "Recover from a restart of the PROFIBUS slaves.")
