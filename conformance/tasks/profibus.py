"""The tasks on PROFIBUS DP.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
slaves. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from functools import partial

from pytest_otmcp.protocols.profibus import oracle
from pytest_otmcp.protocols.profibus.entries import points
from pytest_otmcp.trial.repetition import Repetition
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

VALVES, DRIVE, OTHERS = 5, 8, 9
"""Stations: two bytes of inputs and of outputs; eight of each; one of each, and another master's."""
STATIONS = (VALVES, DRIVE, OTHERS)
INPUTS = {VALVES: 2, DRIVE: 8, OTHERS: 1}
"""Bytes of inputs of each."""
OUTPUTS = 2
"""Bytes of outputs of the valves."""
KEPT_ALIVE = 1.5
"""For how many times of its watchdog a slave is watched."""
LONGEST_WATCHDOG_S = 5.0
"""Seconds: a slave whose watchdog is longer is watched no longer than that."""


def inputs_of(station: int) -> Witness:
    """Return the check that a slave was asked for its inputs."""
    return partial(oracle.inputs_were_read, station=station)


async def set_inputs(run: Repetition, profibus: Rig, station: int) -> list[int]:
    """Set the inputs of a slave at random, past the protocol; return them."""
    content = run.rng.randbytes(INPUTS[station])
    await profibus.device.poke(station=station, inputs=content.hex())
    return list(content)


def outputs(run: Repetition) -> list[int]:
    """Return outputs for the valves, of which no byte is zero: a slave that has none has zeros. Random ones are not those that a master
    repeats, which would be no write."""
    return [run.rng.randrange(1, 0x100) for _ in range(OUTPUTS)]


@TASKS.task(
    "P1",
    "normal",
    "Ping the adapter and confirm that a slave answers.",
    needs="profibus.ping",
    capability="reading",
    requirements="REC-002 MCP-008",
)
async def ping(run: Repetition, profibus: Rig) -> None:
    """Ask whether the slaves can be reached.

    Said: success, and that they can be reached.
    Seen: a slave answers at least one request during the call.
    Why: a status from memory still says so when the line is cut.
    """
    reply = await profibus.call("ping")
    run.succeeds(reply, reachable=True)
    await status_is_known(run, profibus, oracle.some_exchange, reply)


@ping.after
async def a_slow_slave_is_reported_as_slow(run: Repetition, profibus: Rig) -> None:
    """Ping while the slaves answer a tenth of a second late.

    Said: success, and a latency that is no shorter than that.
    """
    await a_delay_shows(run, profibus, "ping")


@TASKS.task(
    "P2",
    "normal",
    "Read the inputs of a slave.",
    needs="profibus.read_inputs",
    capability="reading",
    requirements="RD-001 RD-002 RD-004 MCP-009",
)
async def read_inputs(run: Repetition, profibus: Rig) -> None:
    """Read the two input bytes of slave 5, which were set at random just before.

    Said: these bytes.
    Seen: the slave is asked for its inputs, and no slave gets other outputs.
    Why: a process image from memory looks right until somebody acts on it.
    """
    values = await set_inputs(run, profibus, VALVES)
    reply = await profibus.call("read_inputs", slave=VALVES)
    run.succeeds(reply, values=values)
    journal = await profibus.journal()
    run.witnessed(
        fresh(journal, (reply, inputs_of(VALVES))),
        oracle.no_state_changing_request(journal, requirement="MCP-008"),
        oracle.holds(await profibus.device.image(), points(VALVES, "input", bytes(values))),
    )


@read_inputs.after
async def the_process_ends_with_its_stdin(run: Repetition, profibus: Rig) -> None:
    """End the session.

    Seen: the process ends by itself.
    """
    await ends_when_its_stdin_closes(profibus)


@TASKS.task(
    "P3",
    "normal",
    "Write the outputs of a slave.",
    needs="profibus.write_outputs",
    capability="writing",
    requirements="WR-001 WR-002 WR-003",
)
async def write_outputs(run: Repetition, profibus: Rig) -> None:
    """Write the two output bytes of slave 5.

    Said: these bytes.
    Seen: the slave is parameterised and configured, if it was not; one change of its outputs, to these bytes; no other slave gets others.
    Why: a slave that was not parameterised takes no outputs, whatever was sent; one that gets another number of bytes drops them all.
    """
    values = outputs(run)
    before = await profibus.device.image()
    reply = await profibus.call("write_outputs", slave=VALVES, data=values)
    after = await profibus.device.image()
    run.succeeds(reply, values=values)
    run.witnessed(
        oracle.exactly_one_write(await profibus.journal(), station=VALVES, outputs=bytes(values)),
        oracle.only_changed(before, after, points(VALVES, "output", bytes(values))),
    )


@write_outputs.after
async def the_outputs_are_kept_alive(run: Repetition, profibus: Rig) -> None:
    """Write, and wait for longer than the slave's watchdog.

    Said: success.
    Seen: the slave still has the outputs.
    Why: what is written once and not repeated falls at the watchdog.
    """
    values = outputs(run)
    run.succeeds(await profibus.call("write_outputs", slave=VALVES, data=values), values=values)
    watchdog_s = oracle.watchdog_s(await profibus.device.image(), VALVES)
    await profibus.watch(KEPT_ALIVE * min(watchdog_s or 0.0, LONGEST_WATCHDOG_S))
    run.witnessed(oracle.holds(await profibus.device.image(), points(VALVES, "output", bytes(values))))


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
    values = await set_inputs(run, profibus_ro, VALVES)
    before = await profibus_ro.device.image()
    reply = await profibus_ro.call("write_outputs", slave=VALVES, data=outputs(run))
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.succeeds(await profibus_ro.call("read_inputs", slave=VALVES), values=values)
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
    values = outputs(run)
    run.succeeds(await profibus.call("write_outputs", slave=VALVES, data=values), values=values)
    run.witnessed(
        oracle.some_exchange(await profibus_ro.journal()),
        oracle.exactly_one_write(await profibus.journal(), station=VALVES, outputs=bytes(values)),
    )
    await profibus_ro.close_session()
    run.witnessed(oracle.nothing_driven_by(await profibus_ro.follow(oracle.Drives)))
    await a_meaningless_switch_enables_nothing(run, profibus_ro, "write_outputs", slave=VALVES, data=values)


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
    values = outputs(run)
    run.succeeds(await profibus.call("write_outputs", slave=VALVES, data=values), values=values)
    image = await profibus.device.image()
    run.witnessed(
        oracle.holds(image, points(VALVES, "output", bytes(values))),
        oracle.has_watchdog(image, VALVES),
    )


@outputs_depend_on_their_master.after
async def outputs_fall_with_their_master(run: Repetition, profibus: Rig) -> None:
    """Write outputs, and end the session.

    Said: success.
    Seen: the slave clears its outputs, because it was told to (Global_Control) or because of its watchdog.
    Why: outputs that nobody answers for any more must not stay on.
    """
    values = outputs(run)
    run.succeeds(await profibus.call("write_outputs", slave=VALVES, data=values), values=values)
    watchdog_s = oracle.watchdog_s(await profibus.device.image(), VALVES)
    await profibus.fresh_session()
    if watchdog_s is not None and oracle.cleared(await profibus.device.image(), VALVES, requirement="MCP-009"):
        # A second more than it takes: the machine may be busy.
        await profibus.wait_for(timeout_s=watchdog_s + 1.0, kind="watchdog", station=VALVES)
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
    values = await set_inputs(run, profibus, VALVES)
    run.succeeds(await profibus.call("read_inputs", slave=VALVES), values=values)
    await profibus.device.fault({"station": VALVES, "action": {"answer_station": DRIVE}})
    mixed = await profibus.call("read_inputs", slave=VALVES)
    await profibus.device.fault()
    run.fails(mixed, "protocol_error", "timeout", "connection_lost", requirement="RD-005", code_requirement="ERR-002")
    run.succeeds(await profibus.call("read_inputs", slave=VALVES), values=values)


async def _not_sent(run: Repetition, profibus: Rig, data: list[int], *codes: str, requirement: str) -> None:
    before = await profibus.device.image()
    reply = await profibus.call("write_outputs", slave=VALVES, data=data)
    run.fails(reply, *codes, outcome="not_sent", requirement=requirement)
    run.witnessed(
        oracle.no_state_changing_request(await profibus.journal(), requirement=untold(reply, requirement)),
        oracle.only_changed(before, await profibus.device.image(), {}, otherwise=untold(reply, requirement)),
    )


@TASKS.task(
    "FP2",
    "fault",
    "Write three bytes to a slave with two bytes of outputs and expect adapter rejection.",
    needs="profibus.write_outputs",
    capability="refusing",
    requirements="ADR-004 ERR-006",
)
async def write_wrong_length(run: Repetition, profibus: Rig) -> None:
    """Write three bytes to slave 5.

    Said: a failure with `limit_exceeded`, `type_mismatch`, `range_overflow` or `invalid_input`, and the outcome `not_sent`.
    Seen: no other outputs; the slave holds what it held.
    Why: a slave that gets another number of bytes than was configured leaves data exchange, and all of its outputs fall.
    """
    data = [*outputs(run), 1]
    codes = ("limit_exceeded", "type_mismatch", "range_overflow", "invalid_input")
    await _not_sent(run, profibus, data, *codes, requirement="ADR-004")


@TASKS.task(
    "FP3",
    "fault",
    "Write the value 300 to an output byte and expect adapter rejection.",
    needs="profibus.write_outputs",
    capability="refusing",
    requirements="ADR-003 ERR-006",
)
async def write_overflow(run: Repetition, profibus: Rig) -> None:
    """Write 300 to one of the output bytes of slave 5.

    Said: a failure with `range_overflow` and the outcome `not_sent`.
    Seen: no other outputs; the slave holds what it held.
    Why: 300 cut down to 8 bits is 44, a value that nobody asked for.
    """
    await _not_sent(run, profibus, [300, *outputs(run)[1:]], "range_overflow", requirement="ADR-003")


@write_overflow.after
async def the_largest_value_is_accepted(run: Repetition, profibus: Rig) -> None:
    """Write 255, which fits.

    Said: success.
    Seen: one change of outputs, and the value in the slave.
    """
    await profibus.stays_quiet(QUIET_S, partial(oracle.no_state_changing_request, requirement="ADR-003"))
    values = [0xFF, *outputs(run)[1:]]
    run.succeeds(await profibus.call("write_outputs", slave=VALVES, data=values), values=values)
    run.witnessed(
        oracle.exactly_one_write(await profibus.journal(), station=VALVES, outputs=bytes(values)),
        oracle.holds(await profibus.device.image(), points(VALVES, "output", bytes(values))),
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
    values = outputs(run)
    reply = await profibus.call("write_outputs", slave=VALVES, data=values)
    after = await profibus.device.image()
    await profibus.device.poke(station=VALVES, ident=oracle.IDENT[VALVES])
    run.fails(reply, "config_error", outcome=("not_sent", "rejected"), requirement="ERR-002")
    run.witnessed(
        oracle.no_outputs_sent(
            reply.during(await profibus.journal()), VALVES, bytes(values), requirement=untold(reply, "ERR-002")
        ),
        oracle.only_changed(before, after, {}, otherwise=untold(reply, "ERR-002")),
    )


@TASKS.task(
    "SP1",
    "stress",
    "Four concurrent reads of inputs.",
    needs="profibus.read_inputs",
    capability="load",
    requirements="CON-001",
)
async def concurrent_reads(run: Repetition, profibus: Rig) -> None:
    """Read the inputs of the three slaves, of one of them twice, by four calls at the same time.

    Said: in each answer the inputs of its own slave.
    Seen: for each call a request for these inputs, during the call.
    Why: a telegram has no number: an answer that belongs to another call is a wrong value that looks right.
    """
    values = {station: await set_inputs(run, profibus, station) for station in STATIONS}
    stations = (*STATIONS, VALVES)
    replies = await run.together(*(profibus.call("read_inputs", slave=station) for station in stations))
    for reply, station in zip(replies, stations, strict=True):
        run.succeeds(reply, values=values[station])
    asked = [(reply, inputs_of(station)) for reply, station in zip(replies, stations, strict=True)]
    run.witnessed(fresh(await profibus.journal(), *asked))


@TASKS.task(
    "SP2",
    "stress",
    "Concurrent read of the inputs and write of the outputs of a slave.",
    needs="profibus.read_inputs profibus.write_outputs",
    capability="load",
    requirements="CON-004 WR-003",
)
async def concurrent_read_and_write(run: Repetition, profibus: Rig) -> None:
    """Read the inputs of a slave and write its outputs at the same time.

    Said: the inputs for the read, success for the write.
    Seen: one change of the outputs; the slave has the new ones.
    Why: two telegrams that cross on the line, or a lost write, show only under load.
    """
    held, new = await set_inputs(run, profibus, VALVES), outputs(run)
    read, written = await run.together(
        profibus.call("read_inputs", slave=VALVES), profibus.call("write_outputs", slave=VALVES, data=new)
    )
    run.succeeds(read, values=held)
    run.succeeds(written, values=new)
    run.witnessed(
        oracle.exactly_one_write(await profibus.journal(), station=VALVES, outputs=bytes(new)),
        oracle.holds(await profibus.device.image(), points(VALVES, "output", bytes(new))),
    )


@TASKS.task(
    "SP3",
    "stress",
    "Fifty reads of inputs in a row.",
    needs="profibus.read_inputs",
    capability="load",
    requirements="CON-006",
)
async def rapid_reads(run: Repetition, profibus: Rig) -> None:
    """Read the inputs of a slave by fifty calls, one after the other; before each of them they change.

    Said: the right inputs in every answer.
    Seen: for each call a request for the inputs, during the call.
    Why: leaks, caches and lines that fall out of step show in a long series only.
    """
    asked = []
    for _ in range(RAPID_CALLS):
        values = await set_inputs(run, profibus, DRIVE)
        reply = await profibus.call("read_inputs", slave=DRIVE)
        run.succeeds(reply, values=values)
        asked.append((reply, inputs_of(DRIVE)))
    run.witnessed(fresh(await profibus.journal(), *asked))


@TASKS.task(
    "SP4",
    "stress",
    "Restart of the slaves between reads of inputs.",
    needs="profibus.any_read profibus.recovery",
    capability="outages",
    requirements="REC-001 REC-002 RD-004",
    keys="profibus.recovery",
)
async def restart(run: Repetition, profibus: Rig) -> None:
    """Read inputs; again after the slaves were switched off; and again after they were switched on.

    Said: success; then a failure with `connection_lost` or `timeout`; then success in the same session.
    Seen: a read after the slaves are back.
    Why: an outage of the line must not need a person who restarts the adapter, and old values must not hide it.
    """
    await survive_a_restart(run, profibus, read_inputs=inputs_of(VALVES))


@restart.after
async def a_failed_write_is_not_delivered_later(run: Repetition, profibus: Rig) -> None:
    """Write while the slaves are away, and read when they are back.

    Said: a failure for the write, success for the read.
    Seen: no other outputs: what was reported as failed is not made up for.
    """
    await a_failed_write_is_not_made_up_for(run, profibus)


@TASKS.task(
    "R-profibus",
    "recovery",
    "Recover from a restart of the PROFIBUS slaves.",
    needs="profibus.any_read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
    keys="profibus.recovery",
)
async def recovery(run: Repetition, profibus: Rig) -> None:
    """Read; again after the slaves were switched off; then, after they were switched on, in the same session and in a fresh one with
    a new process.

    Said: success; a failure of the connection; success in both sessions.
    Seen: the reads of both sessions, and nothing that changes the plant.
    Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
    """
    await outage(run, profibus)


@recovery.after
async def the_adapter_starts_without_its_slaves(run: Repetition, profibus: Rig) -> None:
    """Start the adapter while its slaves are switched off, ask, and ask again when they are there.

    Said: a failure of the connection first, success then.
    """
    await start_without_device(run, profibus)
