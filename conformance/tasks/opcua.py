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

from .common import (
    CONNECTION_FAULTS,
    QUIET_S,
    RAPID_CALLS,
    SETTLING_S,
    UNCERTAIN,
    a_delay_shows,
    outage,
    start_without_device,
    survive_a_restart,
)

__all__ = ["TASKS"]

TASKS = Tasks()

TEMPERATURE = "ns=2;s=Temperature"
VALVE = "ns=2;s=ValvePosition"
SENSORS = ("Temperature", "Pressure", "FlowRate", "TankLevel")


@TASKS.task(
    "O1",
    "normal",
    "Read the temperature sensor variable from the OPC UA mock plant.",
    needs="opcua.read",
    capability="reading",
    requirements="RD-001 RD-004 OUA-002",
)
async def read_temperature(run: Repetition, opcua: Rig) -> None:
    value = round(run.rng.uniform(-50.0, 150.0), 6)
    await opcua.poke(node="Temperature", value=value)
    reply = await opcua.call("read", node="ns=2;s=Temperature")
    run.succeeds(reply, value=value, status="Good")
    journal = await opcua.journal()
    run.witnessed(
        oracle.read_from_device(journal, "ns=2;s=Temperature"),
        oracle.no_state_changing_service(journal),
        oracle.image_holds(await opcua.image(), "ns=2;s=Temperature", value),
    )


@read_temperature.after
async def a_slow_device_is_reported_as_slow(run: Repetition, opcua: Rig) -> None:
    await a_delay_shows(run, opcua, "read", node=TEMPERATURE)


@TASKS.task(
    "O2",
    "normal",
    "Browse the actuator subtree in the mock plant.",
    needs="opcua.browse",
    capability="reading",
    requirements="OUA-006",
)
async def browse_actuators(run: Repetition, opcua: Rig) -> None:
    image = await opcua.image()
    actuators = oracle.children_of(image, "Actuators")
    reply = await opcua.call("browse", node=oracle.folder_id(image, "Actuators"))
    run.succeeds(reply)
    run.witnessed(
        oracle.names_and_ids_agree(reply.outputs.get("node_ids"), reply.outputs.get("browse_names"), actuators),
        oracle.browsed(await opcua.journal(), oracle.folder_id(image, "Actuators")),
    )


@TASKS.task(
    "O3",
    "normal",
    "Write the valve-position variable and confirm the new value.",
    needs="opcua.write opcua.read",
    capability="writing",
    guards="opcua",
    requirements="WR-004 WR-001 WR-002 WR-003",
)
async def write_valve_position(run: Repetition, opcua: Rig) -> None:
    value = 25.0 + run.rep
    valve = "ns=2;s=ValvePosition"
    before = await opcua.image()
    written = await opcua.call("write", node=valve, value=value)
    after = await opcua.image()
    read = await opcua.call("read", node=valve)
    run.succeeds(written, value=value)
    run.succeeds(read, value=value, status="Good")
    await opcua.tick(2)
    run.witnessed(
        oracle.exactly_one_write(await opcua.journal(), valve, value),
        oracle.only_changed(before, after, {valve: value}),
        oracle.image_holds(await opcua.image(), valve, value),
    )


@write_valve_position.after
async def nothing_is_written_with_writes_disabled(run: Repetition, opcua_ro: Rig | None) -> None:
    if opcua_ro is None:
        return
    before = await opcua_ro.image()
    run.fails(
        await opcua_ro.call("write", node="ns=2;s=ValvePosition", value=99.5), "writes_disabled", outcome="not_sent"
    )
    run.succeeds(await opcua_ro.call("read", node="ns=2;s=ValvePosition"))
    await opcua_ro.close_session()
    run.witnessed(
        oracle.read_from_device(await opcua_ro.journal(), "ns=2;s=ValvePosition"),
        oracle.nothing_changed_by(await opcua_ro.follow(StateChanges)),
        oracle.only_changed(before, await opcua_ro.image(), {}),
    )


@TASKS.task(
    "O4",
    "normal",
    "Enumerate the mock plant variables through the adapter.",
    needs="opcua.variables",
    capability="reading",
    requirements="OUA-006",
)
async def enumerate_variables(run: Repetition, opcua: Rig) -> None:
    reply = await opcua.call("variables")
    run.succeeds(reply)
    run.witnessed(
        oracle.complete_enumeration(reply.outputs.get("node_ids"), await opcua.image()),
        oracle.some_service(await opcua.journal()),
    )


@TASKS.task(
    "FO1",
    "fault",
    "Read non-existent node (ns=2;i=99999) and expect a structured read-failed error.",
    needs="opcua.read",
    capability="refusing",
    requirements="ERR-003 ENV-007",
)
async def read_missing_node(run: Repetition, opcua: Rig) -> None:
    missing = opcua.probe("missing_node")
    reply = await opcua.call("read", node=missing)
    run.fails(reply, "illegal_address", trace={"status_code": {"symbol": "BadNodeIdUnknown"}})
    journal = await opcua.journal()
    run.witnessed(
        oracle.exactly_one_service(journal, "Read", node=missing),
        oracle.result_status(journal, "Read", "BadNodeIdUnknown"),
    )


@TASKS.task(
    "FO2",
    "fault",
    "Write wrong type (string to float node) and expect a structured write-failed error.",
    needs="opcua.write",
    capability="refusing",
    requirements="ADR-004",
)
async def write_wrong_type(run: Repetition, opcua: Rig) -> None:
    before = await opcua.image()
    reply = await opcua.call("write", node=VALVE, value="fully open")
    run.fails(reply, "type_mismatch", outcome=("not_sent", "rejected"))
    run.witnessed(
        oracle.only_changed(before, await opcua.image(), {}),
        oracle.accepted_writes(await opcua.journal(), 0),
    )


@write_wrong_type.after
async def a_number_is_accepted(run: Repetition, opcua: Rig) -> None:
    await opcua.stays_quiet(QUIET_S, lambda journal: oracle.accepted_writes(journal, 0))
    run.succeeds(await opcua.call("write", node=VALVE, value=31.25), value=31.25)
    run.witnessed(
        oracle.accepted_writes(await opcua.journal(), 1),
        oracle.image_holds(await opcua.image(), VALVE, 31.25),
    )


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
    values = {name: round(run.rng.uniform(0.0, 100.0), 6) for name in SENSORS}
    for name, value in values.items():
        await opcua.poke(node=name, value=value)
    replies = await run.together(*(opcua.call("read", node=f"ns=2;s={name}") for name in values))
    for reply, value in zip(replies, values.values(), strict=True):
        run.succeeds(reply, value=value, status="Good")
    journal = await opcua.journal()
    run.witnessed(*(oracle.read_from_device(journal, f"ns=2;s={name}") for name in values))


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
    old, new = (round(run.rng.uniform(0.0, 100.0), 6) for _ in range(2))
    speed = "ns=2;s=FanSpeed"
    await opcua.poke(node="FanSpeed", value=old)
    read, written = await run.together(opcua.call("read", node=speed), opcua.call("write", node=speed, value=new))
    run.succeeds(read, status="Good")
    run.one_of(read, "value", old, new)
    run.succeeds(written, value=new)
    run.witnessed(
        oracle.exactly_one_write(await opcua.journal(), speed, new),
        oracle.image_holds(await opcua.image(), speed, new),
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
    for index in range(RAPID_CALLS):
        name = SENSORS[index % len(SENSORS)]
        value = round(run.rng.uniform(0.0, 100.0), 6)
        if index < len(SENSORS):
            await opcua.poke(node=name, value=value)
            run.notes[name] = value
        run.succeeds(await opcua.call("read", node=f"ns=2;s={name}"), value=run.notes[name], status="Good")
    run.witnessed(oracle.read_from_device(await opcua.journal(), None, at_least=RAPID_CALLS))


@TASKS.task(
    "S12",
    "stress",
    "Server restart between node reads.",
    needs="opcua.read opcua.recovery",
    capability="outages",
    position=12,
    requirements="REC-001 REC-002 RD-004",
)
async def opcua_restart(run: Repetition, opcua: Rig) -> None:
    await survive_a_restart(run, opcua, "read", node="ns=2;s=Temperature")
    run.witnessed(oracle.read_from_device(await opcua.journal(), "ns=2;s=Temperature"))


@opcua_restart.after
async def a_failed_node_write_is_not_delivered_later(run: Repetition, opcua: Rig) -> None:
    if not opcua.claims("write"):
        return
    await opcua.stop_device()
    reply = await opcua.call("write", node="ns=2;s=FanSpeed", value=round(run.rng.uniform(0.0, 100.0), 6))
    run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN)
    await opcua.start_device()
    read = await opcua.call_until_success("read", window_s=SETTLING_S, node="ns=2;s=Temperature")
    run.succeeds(read[-1])
    await opcua.stays_quiet(QUIET_S, oracle.no_state_changing_service)
    run.succeeds(await opcua.call("read", node="ns=2;s=Temperature"))
    run.witnessed(oracle.no_state_changing_service(await opcua.journal()))


@TASKS.task(
    "R-opcua",
    "recovery",
    "Recover from a restart of the OPC UA server.",
    needs="opcua.read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
)
async def recovery(run: Repetition, opcua: Rig) -> None:
    witness = partial(oracle.read_from_device, node=TEMPERATURE)
    await outage(run, opcua, "read", witness, node=TEMPERATURE)


@recovery.after
async def the_adapter_starts_without_its_device(run: Repetition, opcua: Rig) -> None:
    await start_without_device(run, opcua, "read", node=TEMPERATURE)
