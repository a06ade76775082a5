"""The tasks on OPC UA.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
server. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from functools import partial

from pytest_otmcp.protocols.opcua import oracle
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

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
    ends_when_its_stdin_closes,
    fresh,
    outage,
    start_without_device,
    survive_a_restart,
)
from .refusals import a_bad_value_is_no_success, a_long_browse_is_complete, the_text_false_is_not_true

__all__ = ["TASKS"]

TASKS = Tasks()

TEMPERATURE = "ns=2;s=Temperature"
VALVE = "ns=2;s=ValvePosition"
SENSORS = ("Temperature", "Pressure", "FlowRate", "TankLevel")


def reading(node: str) -> Witness:
    """Return the check that the server was asked for the node's value."""
    return partial(oracle.read_from_device, node=node)


@TASKS.task(
    "O1",
    "normal",
    "Read the temperature sensor variable from the OPC UA mock plant.",
    needs="opcua.read",
    capability="reading",
    requirements="RD-001 RD-004 OUA-002 MCP-009",
)
async def read_temperature(run: Repetition, opcua: Rig) -> None:
    """Read a variable whose value was set at random just before. Where the adapter reads by named readings alone, call one.

    Said: this value, with the status Good.
    Seen: a read of this variable, and nothing that changes the plant.
    Why: a value from memory looks right until somebody acts on it.
    """
    if reads_by_name(opcua, "read"):
        await told_in_turn(run, opcua, 1)
        return
    value = round(run.rng.uniform(-50.0, 150.0), 6)
    await opcua.device.poke(node="Temperature", value=value)
    reply = await opcua.call("read", node="ns=2;s=Temperature")
    run.succeeds(reply, value=value, status="Good")
    journal = await opcua.journal()
    run.witnessed(
        fresh(journal, (reply, reading(TEMPERATURE))),
        oracle.no_state_changing_service(journal, requirement="MCP-008"),
        oracle.image_holds(await opcua.device.image(), "ns=2;s=Temperature", value),
    )


@read_temperature.after
async def a_slow_device_is_reported_as_slow(run: Repetition, opcua: Rig) -> None:
    """Read while the server answers a tenth of a second late; then end the session.

    Said: success, and a latency that is no shorter than that.
    Seen: the process ends by itself.
    """
    asked = exercise(opcua).read(run.rng)
    inputs = asked.inputs if reads_by_name(opcua, "read") else {"node": TEMPERATURE}
    await a_delay_shows(run, opcua, asked.operation, **inputs)
    await ends_when_its_stdin_closes(opcua)


@TASKS.task(
    "O2",
    "normal",
    "Browse the actuator subtree in the mock plant.",
    needs="opcua.browse",
    capability="reading",
    requirements="OUA-006",
)
async def browse_actuators(run: Repetition, opcua: Rig) -> None:
    """Browse a folder.

    Said: every node in it, each with its own name.
    Seen: a Browse of the folder.
    Why: a name that stands beside another node's id makes an assistant move the wrong valve.
    """
    image = await opcua.device.image()
    actuators = oracle.children_of(image, "Actuators")
    reply = await opcua.call("browse", node=oracle.folder_id(image, "Actuators"))
    run.succeeds(reply)
    folder = partial(oracle.browsed, node=oracle.folder_id(image, "Actuators"))
    run.witnessed(
        oracle.names_and_ids_agree(reply.outputs.get("node_ids"), reply.outputs.get("browse_names"), actuators),
        fresh(await opcua.journal(), (reply, folder)),
    )


@browse_actuators.after
async def a_long_list_comes_in_parts(run: Repetition, opcua: Rig) -> None:
    """Browse the folder while the server sends three references in one answer.

    Said: every node in it, each with its own name.
    """
    await a_long_browse_is_complete(run, opcua)


@TASKS.task(
    "O3",
    "normal",
    "Write the valve-position variable and confirm the new value.",
    needs="opcua.write opcua.read",
    capability="writing",
    guards="opcua",
    requirements="WR-004 WR-005 WR-001 WR-002 WR-003",
)
async def write_valve_position(run: Repetition, opcua: Rig) -> None:
    """Write a variable, and read it.

    Said: the value that was written, in both answers.
    Seen: one write of this value, and of nothing but the value; every other variable stays as it was, and the value is
        still there two seconds of plant time later.
    Why: an adapter that says "written" may have written twice, another type, or not at all.
    """
    value = 25.0 + run.rep
    valve = "ns=2;s=ValvePosition"
    before = await opcua.device.image()
    written = await opcua.call("write", node=valve, value=value)
    after = await opcua.device.image()
    read = await opcua.call("read", node=valve)
    run.succeeds(written, value=value)
    # What the server holds now may not be the value, which is the fault of the write; the read has to tell it.
    run.succeeds(read, value=oracle.held(after, valve), status="Good")
    await opcua.device.tick(2)
    run.witnessed(
        oracle.exactly_one_write(await opcua.journal(), valve, value),
        oracle.only_changed(before, after, {valve: value}),
        oracle.image_holds(await opcua.device.image(), valve, value),
    )


@write_valve_position.after
async def nothing_is_written_with_writes_disabled(run: Repetition, opcua_ro: Rig | None) -> None:
    """Write, and read, through the adapter that was started with writes disabled; write through one that was started with a write
    switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`; success for the read; the refusal again, unless the adapter
        refuses to start so.
    Seen: the read, and over the whole life of that session nothing that changes the plant.
    """
    if opcua_ro is None:
        return
    before = await opcua_ro.device.image()
    refused = await opcua_ro.call("write", node="ns=2;s=ValvePosition", value=99.5)
    run.fails(refused, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.succeeds(await opcua_ro.call("read", node="ns=2;s=ValvePosition"))
    await opcua_ro.close_session()
    run.witnessed(
        oracle.read_from_device(await opcua_ro.journal(), "ns=2;s=ValvePosition"),
        oracle.nothing_changed_by(await opcua_ro.follow(StateChanges)),
        oracle.only_changed(before, await opcua_ro.device.image(), {}, otherwise="WR-004"),
    )
    await a_meaningless_switch_enables_nothing(run, opcua_ro, "write", node="ns=2;s=ValvePosition", value=99.5)


@TASKS.task(
    "O4",
    "normal",
    "Enumerate the mock plant variables through the adapter.",
    needs="opcua.variables",
    capability="reading",
    requirements="OUA-006",
)
async def enumerate_variables(run: Repetition, opcua: Rig) -> None:
    """Ask for all variables of the plant.

    Said: every variable, once.
    Seen: at least one request.
    Why: a list that ends after its first page hides the rest of the plant.
    """
    reply = await opcua.call("variables")
    run.succeeds(reply)
    run.witnessed(
        oracle.complete_enumeration(reply.outputs.get("node_ids"), await opcua.device.image()),
        fresh(await opcua.journal(), (reply, oracle.some_service)),
    )


@TASKS.task(
    "FO1",
    "fault",
    "Read non-existent node (ns=2;i=99999) and expect a structured read-failed error.",
    needs="opcua.read",
    capability="refusing",
    requirements="ERR-003 ENV-007 OUA-002",
    keys="opcua.probes.missing_node",
)
async def read_missing_node(run: Repetition, opcua: Rig) -> None:
    """Read a node that the server does not have.

    Said: a failure with `illegal_address`, and the server's status code in the trace. An adapter that refuses by a list
        of nodes of its own may also say `invalid_input`; nothing was sent then.
    Seen: a request for the node, which the server refuses with BadNodeIdUnknown; or none.
    Why: an assistant that gets an empty value for a node that does not exist believes it.
    """
    missing = opcua.subject.probe("missing_node")
    reply = await opcua.call("read", node=missing)
    seen = reply.during(await opcua.journal())
    if not oracle.reached(seen, missing):
        # A list of nodes of its own refuses as well as the server does.
        run.fails(reply, "illegal_address", "invalid_input", outcome=NOTHING_SENT, requirement="ERR-003")
        return
    unknown = {"status_code": {"symbol": "BadNodeIdUnknown"}}
    run.fails(reply, "illegal_address", trace=unknown, requirement="ERR-003")
    run.witnessed(oracle.refused_with(seen, missing, "BadNodeIdUnknown"))


@read_missing_node.after
async def a_node_that_is_there_can_be_read(run: Repetition, opcua: Rig) -> None:
    """Read a variable that is there: a refusal proves something only if the same call works elsewhere. Then read it while its
    sensor has failed.

    Said: success, and the value; then a failure with `bad_quality` or `device_failure`.
    Seen: the variable holds it.
    """
    value = round(run.rng.uniform(-50.0, 150.0), 6)
    await opcua.device.poke(node="Temperature", value=value)
    run.succeeds(await opcua.call("read", node=TEMPERATURE), value=value, status="Good")
    await a_bad_value_is_no_success(run, opcua)


@TASKS.task(
    "FO2",
    "fault",
    "Write wrong type (string to float node) and expect a structured write-failed error.",
    needs="opcua.write",
    capability="refusing",
    requirements="ADR-004",
)
async def write_wrong_type(run: Repetition, opcua: Rig) -> None:
    """Write a text to a variable that holds a floating-point number.

    Said: a failure with `type_mismatch`, or with `invalid_input` by a tool whose schema takes numbers alone; the outcome is `not_sent` or
        `rejected`.
    Seen: no write that the server accepted; the server holds what it held.
    Why: a text that is turned into a number in silence is a value that nobody asked for.
    """
    before = await opcua.device.image()
    reply = await opcua.call("write", node=VALVE, value="fully open")
    run.fails(reply, "type_mismatch", "invalid_input", outcome=("not_sent", "rejected"), requirement="ADR-004")
    run.witnessed(
        oracle.only_changed(before, await opcua.device.image(), {}, otherwise="ADR-004"),
        oracle.accepted_writes(await opcua.journal(), 0, requirement="ADR-004"),
    )


@write_wrong_type.after
async def a_number_is_accepted(run: Repetition, opcua: Rig) -> None:
    """Write a number; then the text "false" to a variable that is true or false.

    Said: success; for the text a failure with `type_mismatch` or `invalid_input`, unless the variable is false then.
    Seen: one write that the server accepted, and the value in the variable; the other variable is not true.
    """
    await opcua.stays_quiet(QUIET_S, lambda journal: oracle.accepted_writes(journal, 0, requirement="ADR-004"))
    run.succeeds(await opcua.call("write", node=VALVE, value=31.25), value=31.25)
    run.witnessed(
        oracle.accepted_writes(await opcua.journal(), 1, requirement="OUA-001"),
        oracle.image_holds(await opcua.device.image(), VALVE, 31.25),
    )
    await the_text_false_is_not_true(run, opcua)


@TASKS.task(
    "S3",
    "stress",
    "Four concurrent node reads.",
    needs="opcua.read",
    capability="load",
    position=3,
    requirements="CON-001",
)
async def concurrent_node_reads(run: Repetition, opcua: Rig) -> None:
    """Read four variables by four calls at the same time, or call named readings.

    Said: in each answer the value of its own variable.
    Seen: a read of each variable.
    Why: an answer that belongs to another call is a wrong value that looks right.
    """
    if reads_by_name(opcua, "read"):
        await told_at_once(run, opcua, 4)
        return
    values = {name: round(run.rng.uniform(0.0, 100.0), 6) for name in SENSORS}
    for name, value in values.items():
        await opcua.device.poke(node=name, value=value)
    replies = await run.together(*(opcua.call("read", node=f"ns=2;s={name}") for name in values))
    for reply, value in zip(replies, values.values(), strict=True):
        run.succeeds(reply, value=value, status="Good")
    nodes = [reading(f"ns=2;s={name}") for name in values]
    run.witnessed(fresh(await opcua.journal(), *zip(replies, nodes, strict=True)))


@TASKS.task(
    "S6",
    "stress",
    "Concurrent node read and write.",
    needs="opcua.read opcua.write",
    capability="load",
    position=6,
    requirements="CON-004 WR-003",
)
async def concurrent_node_read_and_write(run: Repetition, opcua: Rig) -> None:
    """Read a variable and write it at the same time.

    Said: the old value or the new one for the read, success for the write.
    Seen: one write; the variable holds the new value.
    Why: a mixture of two values, or a lost write, shows only under load.
    """
    old, new = (round(run.rng.uniform(0.0, 100.0), 6) for _ in range(2))
    speed = "ns=2;s=FanSpeed"
    await opcua.device.poke(node="FanSpeed", value=old)
    read, written = await run.together(opcua.call("read", node=speed), opcua.call("write", node=speed, value=new))
    run.succeeds(read, status="Good")
    run.one_of(read, "value", old, new)
    run.succeeds(written, value=new)
    run.witnessed(
        oracle.exactly_one_write(await opcua.journal(), speed, new),
        oracle.image_holds(await opcua.device.image(), speed, new),
    )


@TASKS.task(
    "S9",
    "stress",
    "Fifty node reads in a row.",
    needs="opcua.read",
    capability="load",
    position=9,
    requirements="CON-006",
)
async def rapid_node_reads(run: Repetition, opcua: Rig) -> None:
    """Read variables fifty times, or call named readings, one call after the other.

    Said: the right value in every answer.
    Seen: for each call a read of its variable, during the call.
    Why: leaks, caches and sessions that are used up show in a long series only.
    """
    if reads_by_name(opcua, "read"):
        await told_in_turn(run, opcua, RAPID_CALLS)
        return
    asked = []
    for index in range(RAPID_CALLS):
        name = SENSORS[index % len(SENSORS)]
        value = round(run.rng.uniform(0.0, 100.0), 6)
        if index < len(SENSORS):
            await opcua.device.poke(node=name, value=value)
            run.notes[name] = value
        reply = await opcua.call("read", node=f"ns=2;s={name}")
        run.succeeds(reply, value=run.notes[name], status="Good")
        asked.append((reply, reading(f"ns=2;s={name}")))
    run.witnessed(fresh(await opcua.journal(), *asked))


@TASKS.task(
    "S12",
    "stress",
    "Server restart between node reads.",
    needs="opcua.any_read opcua.recovery",
    capability="outages",
    position=12,
    requirements="REC-001 REC-002 RD-004",
    keys="opcua.recovery",
)
async def opcua_restart(run: Repetition, opcua: Rig) -> None:
    """Read a variable; again after the server was stopped; and again after it was started.

    Said: success; then a failure with `connect_failed`, `connection_lost` or `timeout`; then success in the same
        session.
    Seen: a read after the server is back.
    Why: an outage of the line must not need a person who restarts the adapter, and old values must not hide it.
    """
    await survive_a_restart(run, opcua, read=reading(TEMPERATURE))


@opcua_restart.after
async def a_failed_node_write_is_not_delivered_later(run: Repetition, opcua: Rig) -> None:
    """Write while the server is away, and read when it is back.

    Said: a failure for the write, success for the read.
    Seen: no write: what was reported as failed is not made up for.
    """
    await a_failed_write_is_not_made_up_for(run, opcua)


@TASKS.task(
    "R-opcua",
    "recovery",
    "Recover from a restart of the OPC UA server.",
    needs="opcua.any_read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
    keys="opcua.recovery",
)
async def recovery(run: Repetition, opcua: Rig) -> None:
    """Read; again after the server was stopped; then, after it was started, in the same session and in a fresh one with
    a new process.

    Said: success; a failure of the connection; success in both sessions.
    Seen: the reads of both sessions, and nothing that changes the plant.
    Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
    """
    await outage(run, opcua, read=reading(TEMPERATURE))


@recovery.after
async def the_adapter_starts_without_its_device(run: Repetition, opcua: Rig) -> None:
    """Start the adapter while its server is down, ask, and ask again when it is there.

    Said: a failure of the connection first, success then.
    """
    await start_without_device(run, opcua)
