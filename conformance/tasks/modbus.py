"""The tasks on Modbus.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
device. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from pytest_otmcp.protocols.modbus import oracle
from pytest_otmcp.protocols.modbus.entries import points
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

from ..commanded import carried_out, guarded, some_command
from ..within import exercise
from .by_name import reads_by_name, told_at_once, told_in_turn
from .common import (
    NOTHING_SENT,
    QUIET_S,
    RAPID_CALLS,
    Witness,
    a_delay_shows,
    a_failed_write_is_not_made_up_for,
    a_meaningless_switch_enables_nothing,
    allowed_first,
    drawn,
    ends_when_its_stdin_closes,
    fresh,
    outage,
    start_without_device,
    status_is_known,
    survive_a_restart,
    untold,
)
from .refusals import (
    a_busy_device_is_no_success,
    a_fraction_is_not_cut_off,
    malformed_answers_are_survived,
    no_register_follows_the_last,
)

__all__ = ["TASKS"]

TASKS = Tasks()

FIRST: Mapping[str, Any] = {"address": 1, "count": 1}
"""The read of the register that is written."""
READ_COILS, READ_DISCRETE_INPUTS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS = 1, 2, 3, 4
ILLEGAL_DATA_ADDRESS = 2


TABLES = {
    "read_input": ("input_registers", READ_INPUT_REGISTERS),
    "read_holding": ("holding_registers", READ_HOLDING_REGISTERS),
    "read_discrete_inputs": ("discrete_inputs", READ_DISCRETE_INPUTS),
    "read_coils": ("coils", READ_COILS),
}
"""The operations that read cells, each with its table and its function, in the order in which one of them is chosen."""


def cells(operation: str, address: int, count: int = 1) -> Witness:
    """Return the check that the device was asked for these cells."""
    return partial(oracle.read_from_device, function=TABLES[operation][1], address=address, count=count)


SENSOR_BLOCK = cells("read_input", 0, 4)


async def set_cells(run: Repetition, modbus: Rig, count: int, address: int = 0) -> tuple[str, list[int | bool]]:
    """Set cells at random where the adapter can read some; return the operation that reads them, and the values."""
    operation = next(name for name in TABLES if modbus.subject.claims(name))
    table, function = TABLES[operation]
    bits = function in (READ_COILS, READ_DISCRETE_INPUTS)
    values = [run.rng.random() < 0.5 if bits else run.rng.randrange(0x10000) for _ in range(count)]
    await modbus.device.poke(unit=1, table=table, address=address, values=values)
    return operation, values


@TASKS.task(
    "M1",
    "normal",
    "Ping the adapter and confirm the TCP mock is reachable.",
    needs="modbus.ping",
    capability="reading",
    requirements="REC-002 MCP-008",
)
async def ping(run: Repetition, modbus: Rig) -> None:
    """Ask whether the device can be reached.

    Said: success, and that it can be reached.
    Seen: the device answers at least one request during the call.
    Why: a status from memory still says so when the plant is gone, and an accepted connection alone when the device hangs.
    """
    reply = await modbus.call("ping")
    run.succeeds(reply, reachable=True)
    await status_is_known(run, modbus, oracle.some_exchange, reply)


@ping.after
async def a_slow_device_is_reported_as_slow(run: Repetition, modbus: Rig) -> None:
    """Ping while the device answers a tenth of a second late.

    Said: success, and a latency that is no shorter than that.
    """
    await a_delay_shows(run, modbus, "ping")


@TASKS.task(
    "M2",
    "normal",
    "Read a four-register sensor block from the Modbus mock.",
    needs="modbus.read_cells",
    capability="reading",
    requirements="RD-001 RD-002 RD-004 MCP-009",
)
async def read_sensor_block(run: Repetition, modbus: Rig) -> None:
    """Read four input registers whose values were set at random just before; where the adapter reads none, four holding registers,
    discrete inputs or coils; or call named readings four times, where the subject reads by these alone.

    Said: these four values.
    Seen: a read of these registers, and nothing that changes the plant.
    Why: values from memory, from another table or from a neighbour look right until somebody acts on them.
    """
    if reads_by_name(modbus, *TABLES):
        await told_in_turn(run, modbus, 4)
        return
    operation, values = await set_cells(run, modbus, 4)
    reply = await modbus.call(operation, address=0, count=4)
    run.succeeds(reply, values=values)
    journal = await modbus.journal()
    run.witnessed(
        fresh(journal, (reply, cells(operation, 0, 4))),
        oracle.no_state_changing_request(journal, requirement="MCP-008"),
        oracle.image_holds(await modbus.device.image(), TABLES[operation][0], 0, values),
    )


@read_sensor_block.after
async def the_process_ends_with_its_stdin(run: Repetition, modbus: Rig) -> None:
    """End the session.

    Seen: the process ends by itself.
    """
    await ends_when_its_stdin_closes(modbus)


@TASKS.task(
    "M3",
    "normal",
    "Write a holding register and read it back for verification.",
    needs="modbus.write_holding modbus.read_holding",
    capability="writing",
    requirements="WR-001 WR-002 WR-003",
)
async def write_and_read_back(run: Repetition, modbus: Rig) -> None:
    """Write a holding register, and read it where the adapter reads such registers; or call a named command, where the subject writes by
    these alone.

    Said: the value that was written, in both answers.
    Seen: one write of this value to this register; every other register stays as it was.
    Why: an adapter that says "written" may have written twice, beside the register, or not at all.
    """
    if modbus.by_command_alone("write_holding"):
        await carried_out(run, modbus, some_command(run, modbus))
        return
    value = 40 + run.rep
    # Guard cells on both sides: a write to, or a read from, a neighbouring register cannot pass.
    await modbus.device.poke(unit=1, table="holding_registers", address=0, values=[0xFFFF - value])
    await modbus.device.poke(unit=1, table="holding_registers", address=2, values=[0xFFFF - value])
    before = await modbus.device.image()
    written = await modbus.call("write_holding", address=1, value=value)
    after = await modbus.device.image()
    read = await modbus.call("read_holding", **FIRST) if modbus.can_ask("read_holding", FIRST) else None
    run.succeeds(written, value=value)
    journal = await modbus.journal()
    if read is not None:
        # What the device holds now may not be the value, which is the fault of the write; the read has to tell it.
        run.succeeds(read, values=[oracle.held(after, "holding_registers", 1)])
        run.witnessed(oracle.read_where_asked(journal, function=READ_HOLDING_REGISTERS, address=1))
    run.witnessed(
        oracle.exactly_one_write(journal, "holding_registers", address=1, values=[value]),
        oracle.only_changed(before, after, points("holding_registers", 1, [value])),
    )


@TASKS.task(
    "M4",
    "normal",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="modbus.write_holding modbus.read_holding modbus.guard",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
)
async def guarded_write(run: Repetition, modbus_ro: Rig) -> None:
    """Write a register, or call a named command where the subject writes by these alone, through the adapter that was started with
    writes disabled.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`.
    Seen: no request that changes the plant; the device holds what it held.
    Why: the write switch is what keeps an assistant's mistake out of the plant.
    """
    if modbus_ro.by_command_alone("write_holding"):
        await guarded(run, modbus_ro, some_command(run, modbus_ro))
        return
    before = await modbus_ro.device.image()
    reply = await modbus_ro.call("write_holding", address=1, value=999)
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.witnessed(
        oracle.no_state_changing_request(await modbus_ro.journal()),
        oracle.only_changed(before, await modbus_ro.device.image(), {}, otherwise="WR-004"),
    )


@guarded_write.after
async def the_guard_was_put_to_the_test(run: Repetition, modbus: Rig, modbus_ro: Rig) -> None:
    """Read with writes disabled, and write the same value with writes enabled: both must work, or the refusal proves
    nothing. Then write through the adapter that was started with a write switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
    Seen: over the whole life of the read-only sessions, their end included, nothing that changes the plant.
    """
    if modbus.by_command_alone("write_holding"):
        await the_guard_of_commands_was_put_to_the_test(run, modbus, modbus_ro)
        return
    # The refusal only proves the guard if the read-only session reaches its device and the same call works without the guard.
    run.succeeds(await some_read(run, modbus_ro))
    written = await modbus.call("write_holding", address=1, value=999)
    run.succeeds(written, value=999)
    run.witnessed(
        oracle.some_exchange(await modbus_ro.journal()),
        oracle.exactly_one_write(await modbus.journal(), "holding_registers", address=1, values=[999]),
    )
    # This device's journal holds the whole life of the read-only session, its closing included, and nothing else.
    await modbus_ro.close_session()
    run.witnessed(oracle.nothing_changed_by(await modbus_ro.follow(StateChanges)))
    await a_meaningless_switch_enables_nothing(run, modbus_ro, "write_holding", address=1, value=999)


async def some_read(run: Repetition, modbus: Rig) -> Reply:
    """Read a holding register; where the adapter cannot, call a named reading."""
    if modbus.can_ask("read_holding", FIRST):
        return await modbus.call("read_holding", **FIRST)
    asked = exercise(modbus).read(run.rng)
    return await modbus.call(asked.operation, **asked.inputs)


async def the_guard_of_commands_was_put_to_the_test(run: Repetition, modbus: Rig, modbus_ro: Rig) -> None:
    """Do the same with a named command, and with a named reading where the subject reads by these alone."""
    asked = some_command(run, modbus)
    run.succeeds(await some_read(run, modbus_ro))
    run.witnessed(oracle.some_exchange(await modbus_ro.journal()))
    await carried_out(run, modbus, asked)
    await modbus_ro.close_session()
    run.witnessed(oracle.nothing_changed_by(await modbus_ro.follow(StateChanges)))
    await a_meaningless_switch_enables_nothing(run, modbus_ro, asked.operation, **asked.inputs)


@TASKS.task(
    "FM1",
    "fault",
    "Read invalid register address (9999) and expect a structured protocol error.",
    needs="modbus.read_holding",
    capability="refusing",
    requirements="ERR-002 ENV-007 RD-005 RD-007",
    keys="modbus.probes.missing_address",
)
async def read_missing_register(run: Repetition, modbus: Rig) -> None:
    """Read a register that the device does not have.

    Said: a failure with `illegal_address`, and the device's exception code in the trace. An adapter that refuses by a
        register map of its own may also say `invalid_input`; nothing was sent then.
    Seen: the read, which the device refuses with an exception; or no read of anything else that it refuses.
    Why: an assistant that gets a zero for an address that does not exist believes the zero.
    """
    missing = modbus.subject.probe("missing_address")
    reply = await modbus.call("read_holding", address=missing, count=1)
    seen = reply.during(await modbus.journal())
    if not oracle.reached(seen, function=READ_HOLDING_REGISTERS, address=missing, count=1):
        # A register map of its own refuses as well as the device does.
        run.fails(reply, "illegal_address", "invalid_input", outcome=NOTHING_SENT, requirement="ERR-002")
        run.witnessed(oracle.refused_nothing_else(seen, function=READ_HOLDING_REGISTERS, address=missing, count=1))
        return
    run.fails(reply, "illegal_address", trace={"exception_code": ILLEGAL_DATA_ADDRESS}, requirement="ERR-002")
    run.witnessed(oracle.refused_with(seen, ILLEGAL_DATA_ADDRESS))


@read_missing_register.after
async def a_register_that_is_there_can_be_read(run: Repetition, modbus: Rig) -> None:
    """Read a register that is there: a refusal proves something only if the same call works elsewhere. Then read two registers
    of which only the first has an address, one while the device is busy, four of which the device sends two, and one while it
    sends no frame at all.

    Said: success, and the value; then failures: `illegal_address`, `invalid_input` or `limit_exceeded`; `device_busy`; and twice
        `protocol_error`, `connect_failed`, `connection_lost` or `timeout`, or the value where the adapter asked again. Then a read works.
    Seen: the register holds it.
    """
    value = run.rng.randrange(0x10000)
    await modbus.device.poke(unit=1, table="holding_registers", address=40, values=[value])
    run.succeeds(await modbus.call("read_holding", address=40, count=1), values=[value])
    await no_register_follows_the_last(run, modbus)
    await a_busy_device_is_no_success(run, modbus)
    await malformed_answers_are_survived(run, modbus)


@TASKS.task(
    "FM2",
    "fault",
    "Write overflow value (70000 > uint16 max) and expect adapter rejection.",
    needs="modbus.write_holding",
    capability="refusing",
    requirements="ADR-003 ADR-004 ERR-006",
)
async def write_overflow(run: Repetition, modbus: Rig) -> None:
    """Write 70000 to a register of 16 bits.

    Said: a failure with `range_overflow` and the outcome `not_sent`.
    Seen: no request that changes the plant; the device holds what it held.
    Why: 70000 cut down to 16 bits is 4464, a value that nobody asked for.
    """
    before = await modbus.device.image()
    reply = await modbus.call("write_holding", address=1, value=70000)
    journal = await modbus.journal()
    after = await modbus.device.image()
    if reply.success:
        run.judge(reply, oracle.stored_otherwise(after, "holding_registers", 1, 70000, told=reply.outputs.get("value")))
        return
    run.fails(reply, "range_overflow", outcome="not_sent", requirement="ADR-003")
    run.witnessed(
        oracle.no_state_changing_request(journal, requirement=untold(reply, "ADR-003")),
        oracle.only_changed(before, after, {}, otherwise=untold(reply, "ADR-003")),
    )


@write_overflow.after
async def the_largest_value_is_accepted(run: Repetition, modbus: Rig) -> None:
    """Write 65535, which fits, or what the tool's own schema allows; then 40.7, which a register cannot hold.

    Said: success; for 40.7 a failure with `type_mismatch`, `invalid_input` or `range_overflow` and the outcome `not_sent`.
    Seen: one write, and the value in the register.
    """
    await modbus.stays_quiet(QUIET_S, partial(oracle.no_state_changing_request, requirement="ADR-003"))
    fits = allowed_first(modbus, "write_holding", (65535, 100, 1), lambda value: {"address": 1, "value": value})
    run.succeeds(await modbus.call("write_holding", address=1, value=fits), value=fits)
    run.witnessed(
        oracle.exactly_one_write(await modbus.journal(), "holding_registers", address=1, values=[fits]),
        oracle.image_holds(await modbus.device.image(), "holding_registers", 1, [fits]),
    )
    await a_fraction_is_not_cut_off(run, modbus)


@TASKS.task(
    "S1",
    "stress",
    "Four concurrent register reads.",
    needs="modbus.read_cells",
    capability="load",
    position=1,
    requirements="CON-001",
)
async def concurrent_register_reads(run: Repetition, modbus: Rig) -> None:
    """Read four registers, or bits where the adapter reads no registers, by four calls at the same time; or call named readings, where the
    subject reads by these alone.

    Said: in each answer the value of its own register.
    Seen: for each call a read that covers its register, during the call.
    Why: an answer that belongs to another call is a wrong value that looks right.
    """
    if reads_by_name(modbus, *TABLES):
        await told_at_once(run, modbus, 4)
        return
    operation, values = await set_cells(run, modbus, 4, address=10)
    replies = await run.together(*(modbus.call(operation, address=10 + i, count=1) for i in range(4)))
    for reply, value in zip(replies, values, strict=True):
        run.succeeds(reply, values=[value])
    asked = [(reply, cells(operation, 10 + i)) for i, reply in enumerate(replies)]
    run.witnessed(fresh(await modbus.journal(), *asked))


@TASKS.task(
    "S4",
    "stress",
    "Concurrent register read and write.",
    needs="modbus.read_holding modbus.write_holding",
    capability="load",
    position=4,
    requirements="CON-004 WR-003",
)
async def concurrent_register_read_and_write(run: Repetition, modbus: Rig) -> None:
    """Read a register and write it at the same time.

    Said: the old value or the new one for the read, success for the write.
    Seen: one write; the register holds the new value.
    Why: a mixture of two values, or a lost write, shows only under load.
    """
    old, new = drawn(
        modbus,
        "write_holding",
        lambda: run.rng.sample(range(0x10000), 2),
        lambda pair: {"address": 20, "value": pair[1]},
    )
    await modbus.device.poke(unit=1, table="holding_registers", address=20, values=[old])
    read, written = await run.together(
        modbus.call("read_holding", address=20, count=1),
        modbus.call("write_holding", address=20, value=new),
    )
    run.succeeds(read)
    run.one_of(read, "values", [old], [new])
    run.succeeds(written, value=new)
    run.witnessed(
        oracle.exactly_one_write(await modbus.journal(), "holding_registers", address=20, values=[new]),
        oracle.image_holds(await modbus.device.image(), "holding_registers", 20, [new]),
    )


@TASKS.task(
    "S7",
    "stress",
    "Fifty register reads in a row.",
    needs="modbus.read_cells",
    capability="load",
    position=7,
    requirements="CON-006",
)
async def rapid_register_reads(run: Repetition, modbus: Rig) -> None:
    """Read fifty registers, or bits where the adapter reads no registers, one call after the other; or call named readings, where the
    subject reads by these alone.

    Said: the right value in every answer.
    Seen: for each call a read that covers its register, during the call.
    Why: leaks, caches and connections that are used up show in a long series only.
    """
    if reads_by_name(modbus, *TABLES):
        await told_in_turn(run, modbus, RAPID_CALLS)
        return
    operation, values = await set_cells(run, modbus, RAPID_CALLS)
    asked = []
    for address, value in enumerate(values):
        reply = await modbus.call(operation, address=address, count=1)
        run.succeeds(reply, values=[value])
        asked.append((reply, cells(operation, address)))
    run.witnessed(fresh(await modbus.journal(), *asked))


@TASKS.task(
    "S10",
    "stress",
    "Endpoint restart between register reads.",
    needs="modbus.any_read modbus.recovery",
    capability="outages",
    position=10,
    requirements="REC-001 REC-002 RD-004",
    keys="modbus.recovery",
)
async def modbus_restart(run: Repetition, modbus: Rig) -> None:
    """Read four registers, or whatever else the adapter reads; again after the device was stopped; and again after it was started.

    Said: success; then a failure with `connect_failed`, `connection_lost` or `timeout`; then success in the same
        session.
    Seen: a read after the device is back.
    Why: an outage of the line must not need a person who restarts the adapter, and old values must not hide it.
    """
    await survive_a_restart(run, modbus, read_input=SENSOR_BLOCK)


@modbus_restart.after
async def a_failed_register_write_is_not_delivered_later(run: Repetition, modbus: Rig) -> None:
    """Write while the device is away, and read when it is back.

    Said: a failure for the write, success for the read.
    Seen: no write: what was reported as failed is not made up for.
    """
    await a_failed_write_is_not_made_up_for(run, modbus)


@TASKS.task(
    "R-modbus",
    "recovery",
    "Recover from a restart of the Modbus device.",
    needs="modbus.any_read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
    keys="modbus.recovery",
)
async def recovery(run: Repetition, modbus: Rig) -> None:
    """Read; again after the device was stopped; then, after it was started, in the same session and in a fresh one with
    a new process.

    Said: success; a failure of the connection; success in both sessions.
    Seen: the reads of both sessions, and nothing that changes the plant.
    Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
    """
    await outage(run, modbus)


@recovery.after
async def the_adapter_starts_without_its_device(run: Repetition, modbus: Rig) -> None:
    """Start the adapter while its device is down, ask, and ask again when it is there.

    Said: a failure of the connection first, success then.
    """
    await start_without_device(run, modbus)
