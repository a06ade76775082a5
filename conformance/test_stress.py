"""The stress suite: concurrent calls, fifty calls in a row, and an endpoint that goes away in the middle.

Twelve tasks, three adapters each in turn. The restart tasks have three phases and all three are asserted: the read
before works, the read during the outage fails as an envelope within its deadline, the read after works. Afterwards a command is
given during an outage: it has to fail, and must not be delivered when the endpoint is back.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from pytest_otmcp.protocols.modbus import oracle as modbus
from pytest_otmcp.protocols.mqtt import oracle as mqtt
from pytest_otmcp.protocols.opcua import oracle as opcua
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.task import Suite, Task

from .receiving import collect, let_it_read

STRESS = Suite("stress", warm_up=False)

RAPID_CALLS = 50
SETTLING_S = 1.0
"""The paper's window: how long after the endpoint accepts connections again a call may still fail."""

NOTICING_S = 1.0
"""How long a status may still say "connected" after the connection was cut (requirement REC-002: one keep-alive)."""

QUIET_S = 0.25
"""How long the device is watched, once per item, for a command that must not come."""

CONNECTION_FAULTS = ("connect_failed", "connection_lost", "timeout")
UNCERTAIN = ("not_sent", "unknown")
SENSORS = ("Temperature", "Pressure", "FlowRate", "TankLevel")


@STRESS.task(
    "S1",
    "Modbus",
    "Four concurrent register reads.",
    needs="modbus.read_input",
    requirements="CON-001",
)
async def concurrent_register_reads(run: Repetition) -> None:
    values = [run.rng.randrange(0x10000) for _ in range(4)]
    await run.modbus.poke(unit=1, table="input_registers", address=10, values=values)
    replies = await run.together(*(run.modbus.call("read_input", address=10 + i, count=1) for i in range(4)))
    for reply, value in zip(replies, values, strict=True):
        run.succeeds(reply, values=[value])
    run.witnessed(modbus.request_count(await run.modbus.journal(), function=4, count=4))


@STRESS.task(
    "S2",
    "MQTT",
    "Four concurrent reads of received messages.",
    needs="mqtt.receive",
    requirements="CON-001 MQT-004",
)
async def concurrent_message_reads(run: Repetition) -> None:
    nonces = {f"stress/{i}": f"nonce-{run.rng.getrandbits(64):016x}" for i in range(4)}
    if run.mqtt.blocks("messages"):
        await collect(run, {topic: (topic, nonce) for topic, nonce in nonces.items()})
        return
    for topic, nonce in nonces.items():
        await run.mqtt.publish_from_kit(topic, nonce.encode())
    await run.mqtt.wait_for(kind="PUBLISH", direction="out", topic="stress/3", timeout_s=1.0)
    await let_it_read(run, "stress/#")
    replies = await run.together(*(run.mqtt.call("messages", filter=topic) for topic in nonces))
    for reply, (topic, nonce) in zip(replies, nonces.items(), strict=True):
        run.receives(reply, topic, nonce)


@concurrent_message_reads.before
async def the_adapter_listens(run: Repetition) -> None:
    if run.mqtt.blocks("messages"):
        return
    run.succeeds(await run.mqtt.call("subscribe", filter="stress/#", qos=0))


@STRESS.task(
    "S3",
    "OPC UA",
    "Four concurrent node reads.",
    needs="opcua.read",
    requirements="CON-001",
)
async def concurrent_node_reads(run: Repetition) -> None:
    values = {name: round(run.rng.uniform(0.0, 100.0), 6) for name in SENSORS}
    for name, value in values.items():
        await run.opcua.poke(node=name, value=value)
    replies = await run.together(*(run.opcua.call("read", node=f"ns=2;s={name}") for name in values))
    for reply, value in zip(replies, values.values(), strict=True):
        run.succeeds(reply, value=value, status="Good")
    journal = await run.opcua.journal()
    run.witnessed(*(opcua.read_from_device(journal, f"ns=2;s={name}") for name in values))


@STRESS.task(
    "S4",
    "Modbus",
    "Concurrent register read and write.",
    needs="modbus.read_holding modbus.write_holding",
    requirements="CON-004 WR-003",
)
async def concurrent_register_read_and_write(run: Repetition) -> None:
    old, new = run.rng.sample(range(0x10000), 2)
    await run.modbus.poke(unit=1, table="holding_registers", address=20, values=[old])
    read, written = await run.together(
        run.modbus.call("read_holding", address=20, count=1),
        run.modbus.call("write_holding", address=20, value=new),
    )
    run.succeeds(read)
    run.one_of(read, "values", [old], [new])
    run.succeeds(written, value=new)
    run.witnessed(
        modbus.exactly_one_write(await run.modbus.journal(), "holding_registers", address=20, values=[new]),
        modbus.image_holds(await run.modbus.image(), "holding_registers", 20, [new]),
    )


@STRESS.task(
    "S5",
    "MQTT",
    "Concurrent broker inspection and publish.",
    needs="mqtt.info mqtt.publish",
    requirements="CON-004 WR-003",
)
async def concurrent_info_and_publish(run: Repetition) -> None:
    payload = json.dumps({"pump_speed": 50 + run.rep, "nonce": run.rng.getrandbits(32)})
    info, message = await run.together(
        run.mqtt.call("info"),
        run.mqtt.call("publish", topic="control/pump", payload=payload, qos=0),
    )
    run.succeeds(info, connected=True)
    run.succeeds(message, topic="control/pump")
    await run.mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/pump", timeout_s=1.0)
    qos = run.mqtt.if_taken("publish", "qos", 0)
    journal = await run.mqtt.journal()
    run.witnessed(mqtt.published_once(journal, topic="control/pump", payload=payload.encode(), qos=qos))


@STRESS.task(
    "S6",
    "OPC UA",
    "Concurrent node read and write.",
    needs="opcua.read opcua.write",
    requirements="CON-004 WR-003",
)
async def concurrent_node_read_and_write(run: Repetition) -> None:
    old, new = (round(run.rng.uniform(0.0, 100.0), 6) for _ in range(2))
    speed = "ns=2;s=FanSpeed"
    await run.opcua.poke(node="FanSpeed", value=old)
    read, written = await run.together(
        run.opcua.call("read", node=speed), run.opcua.call("write", node=speed, value=new)
    )
    run.succeeds(read, status="Good")
    run.one_of(read, "value", old, new)
    run.succeeds(written, value=new)
    run.witnessed(
        opcua.exactly_one_write(await run.opcua.journal(), speed, new),
        opcua.image_holds(await run.opcua.image(), speed, new),
    )


@STRESS.task(
    "S7",
    "Modbus",
    "Fifty register reads in a row.",
    needs="modbus.read_input",
    requirements="CON-006",
)
async def rapid_register_reads(run: Repetition) -> None:
    values = [run.rng.randrange(0x10000) for _ in range(RAPID_CALLS)]
    await run.modbus.poke(unit=1, table="input_registers", address=0, values=values)
    for address, value in enumerate(values):
        run.succeeds(await run.modbus.call("read_input", address=address, count=1), values=[value])
    run.witnessed(modbus.request_count(await run.modbus.journal(), function=4, count=RAPID_CALLS))


@STRESS.task(
    "S8",
    "MQTT",
    "Fifty broker inspections in a row.",
    needs="mqtt.info",
    requirements="CON-006",
)
async def rapid_broker_inspections(run: Repetition) -> None:
    for _ in range(RAPID_CALLS):
        run.succeeds(await run.mqtt.call("info"), connected=True)
    run.witnessed(mqtt.exchange(await run.mqtt.journal(), at_least=RAPID_CALLS))


@STRESS.task(
    "S9",
    "OPC UA",
    "Fifty node reads in a row.",
    needs="opcua.read",
    requirements="CON-006",
)
async def rapid_node_reads(run: Repetition) -> None:
    for index in range(RAPID_CALLS):
        name = SENSORS[index % len(SENSORS)]
        value = round(run.rng.uniform(0.0, 100.0), 6)
        if index < len(SENSORS):
            await run.opcua.poke(node=name, value=value)
            run.notes[name] = value
        run.succeeds(await run.opcua.call("read", node=f"ns=2;s={name}"), value=run.notes[name], status="Good")
    run.witnessed(opcua.read_from_device(await run.opcua.journal(), None, at_least=RAPID_CALLS))


async def survives_a_restart(run: Repetition, protocol: str, operation: str, **inputs: Any) -> None:
    at = run.at(protocol)
    run.succeeds(await at.call(operation, **inputs))
    await at.stop_device()
    run.fails(await at.call_until_failure(operation, window_s=NOTICING_S, **inputs), *CONNECTION_FAULTS)
    await at.start_device()
    run.succeeds((await at.call_until_success(operation, window_s=SETTLING_S, **inputs))[-1])


@STRESS.task(
    "S10",
    "Modbus",
    "Endpoint restart between register reads.",
    needs="modbus.read_input modbus.recovery",
    requirements="REC-001 REC-002 RD-004",
)
async def modbus_restart(run: Repetition) -> None:
    await survives_a_restart(run, "modbus", "read_input", address=0, count=4)
    run.witnessed(modbus.exactly_one_request(await run.modbus.journal(), function=4, address=0, quantity=4))


@modbus_restart.after
async def a_failed_register_write_is_not_made_up_for(run: Repetition) -> None:
    if not run.modbus.claims("write_holding"):
        return
    await run.modbus.stop_device()
    reply = await run.modbus.call("write_holding", address=30, value=run.rng.randrange(1, 0x10000))
    run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN)
    await run.modbus.start_device()
    # When it answers again it has its connection back: what it had kept for later would have been sent by now.
    run.succeeds((await run.modbus.call_until_success("read_input", window_s=SETTLING_S, address=0, count=4))[-1])
    await run.modbus.stays_quiet(QUIET_S, modbus.no_state_changing_request)
    # One more answer: adapter and device did run in that time.
    run.succeeds(await run.modbus.call("read_input", address=0, count=4))
    run.witnessed(modbus.no_state_changing_request(await run.modbus.journal()))


@STRESS.task(
    "S11",
    "MQTT",
    "Broker restart between broker inspections.",
    needs="mqtt.info mqtt.recovery",
    requirements="REC-001 REC-002",
)
async def broker_restart(run: Repetition) -> None:
    await survives_a_restart(run, "mqtt", "info")
    run.witnessed(mqtt.exchange(await run.mqtt.journal()))


@broker_restart.after
async def a_failed_publish_is_not_made_up_for(run: Repetition) -> None:
    if not run.mqtt.claims("publish"):
        return
    payload = f"nonce-{run.rng.getrandbits(64):016x}"
    await run.mqtt.stop_device()
    reply = await run.mqtt.call("publish", topic="control/pump", payload=payload, qos=1)
    run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN)
    await run.mqtt.start_device()
    run.succeeds((await run.mqtt.call_until_success("info", window_s=SETTLING_S))[-1])
    await run.mqtt.stays_quiet(QUIET_S, lambda journal: mqtt.never_published(journal, payload.encode()))
    run.succeeds(await run.mqtt.call("info"))
    run.witnessed(mqtt.never_published(await run.mqtt.journal(), payload.encode()))


@STRESS.task(
    "S12",
    "OPC UA",
    "Server restart between node reads.",
    needs="opcua.read opcua.recovery",
    requirements="REC-001 REC-002 RD-004",
)
async def opcua_restart(run: Repetition) -> None:
    await survives_a_restart(run, "opcua", "read", node="ns=2;s=Temperature")
    run.witnessed(opcua.read_from_device(await run.opcua.journal(), "ns=2;s=Temperature"))


@opcua_restart.after
async def a_failed_node_write_is_not_made_up_for(run: Repetition) -> None:
    if not run.opcua.claims("write"):
        return
    await run.opcua.stop_device()
    reply = await run.opcua.call("write", node="ns=2;s=FanSpeed", value=round(run.rng.uniform(0.0, 100.0), 6))
    run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN)
    await run.opcua.start_device()
    read = await run.opcua.call_until_success("read", window_s=SETTLING_S, node="ns=2;s=Temperature")
    run.succeeds(read[-1])
    await run.opcua.stays_quiet(QUIET_S, opcua.no_state_changing_service)
    run.succeeds(await run.opcua.call("read", node="ns=2;s=Temperature"))
    run.witnessed(opcua.no_state_changing_service(await run.opcua.journal()))


@pytest.mark.parametrize("task", STRESS, ids=lambda task: task.id)
def test_stress(task: Task, otmcp_trial: Callable[[Task], None]) -> None:
    otmcp_trial(task)
