"""The normal suite: sixteen tasks that any adapter for a plant must get right, judged at the device.

Each function below is one repetition. It says what the assistant asks for, what the envelope must say, and what the
device must have seen. Values are different in every repetition, so that no cached or crossed answer can pass.
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

NORMAL = Suite("normal")

READ_INPUT_REGISTERS = 4
WRITE_SINGLE_REGISTER = 6


@NORMAL.task(
    "M1",
    "Modbus",
    "Ping the adapter and confirm the TCP mock is reachable.",
    needs="modbus.ping",
    requirements="REC-002 MCP-008",
)
async def ping(run: Repetition) -> None:
    reply = await run.modbus.call("ping")
    run.succeeds(reply, reachable=True)
    run.witnessed(modbus.some_exchange(await run.modbus.journal()))


@NORMAL.task(
    "M2",
    "Modbus",
    "Read a four-register sensor block from the Modbus mock.",
    needs="modbus.read_input",
    requirements="RD-001 RD-002 RD-004",
)
async def read_sensor_block(run: Repetition) -> None:
    values = [run.rng.randrange(0x10000) for _ in range(4)]
    await run.modbus.poke(unit=1, table="input_registers", address=0, values=values)
    reply = await run.modbus.call("read_input", address=0, count=4)
    run.succeeds(reply, values=values)
    journal = await run.modbus.journal()
    run.witnessed(
        modbus.exactly_one_request(journal, function=READ_INPUT_REGISTERS, address=0, quantity=4),
        modbus.no_state_changing_request(journal),
        modbus.image_holds(await run.modbus.image(), "input_registers", 0, values),
    )


@NORMAL.task(
    "M3",
    "Modbus",
    "Write a holding register and read it back for verification.",
    needs="modbus.write_holding modbus.read_holding",
    requirements="WR-001 WR-002 WR-003",
)
async def write_and_read_back(run: Repetition) -> None:
    value = 40 + run.rep
    # Guard cells on both sides: what was written to, or is read from, a neighbour cannot pass.
    await run.modbus.poke(unit=1, table="holding_registers", address=0, values=[0xFFFF - value])
    await run.modbus.poke(unit=1, table="holding_registers", address=2, values=[0xFFFF - value])
    before = await run.modbus.image()
    written = await run.modbus.call("write_holding", address=1, value=value)
    after = await run.modbus.image()
    read = await run.modbus.call("read_holding", address=1, count=1)
    run.succeeds(written, value=value)
    run.succeeds(read, values=[value])
    run.witnessed(
        modbus.exactly_one_write(await run.modbus.journal(), "holding_registers", address=1, values=[value]),
        modbus.only_changed(before, after, {("1", "holding_registers", 1): value}),
    )


@NORMAL.task(
    "M4",
    "Modbus",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="modbus.write_holding modbus.read_holding modbus.guard",
    requirements="WR-004 ERR-006",
)
async def guarded_write(run: Repetition) -> None:
    before = await run.modbus_ro.image()
    reply = await run.modbus_ro.call("write_holding", address=1, value=999)
    run.fails(reply, "writes_disabled", outcome="not_sent")
    run.witnessed(
        modbus.no_state_changing_request(await run.modbus_ro.journal()),
        modbus.only_changed(before, await run.modbus_ro.image(), {}),
    )


@guarded_write.after
async def the_guard_was_put_to_the_test(run: Repetition) -> None:
    # A denial proves something only if the read-only session reaches its device and the same call works elsewhere.
    read = await run.modbus_ro.call("read_holding", address=1, count=1)
    run.succeeds(read)
    written = await run.modbus.call("write_holding", address=1, value=999)
    run.succeeds(written, value=999)
    run.witnessed(
        modbus.some_exchange(await run.modbus_ro.journal()),
        modbus.exactly_one_write(await run.modbus.journal(), "holding_registers", address=1, values=[999]),
    )
    # The whole life of the read-only session, its closing included, is on this device's journal and nobody else's.
    await run.modbus_ro.close_session()
    run.witnessed(modbus.no_state_changing_request(await run.modbus_ro.session_journal()))


@NORMAL.task(
    "Q1",
    "MQTT",
    "Inspect broker connectivity through the MCP adapter.",
    needs="mqtt.info",
    requirements="REC-002",
)
async def broker_info(run: Repetition) -> None:
    reply = await run.mqtt.call("info")
    run.succeeds(reply, connected=True)
    run.witnessed(mqtt.exchange(await run.mqtt.journal()))


@NORMAL.task(
    "Q2",
    "MQTT",
    "Subscribe to the mock sensor topic namespace.",
    needs="mqtt.receive",
    requirements="MQT-002 MQT-004",
)
async def subscribe_to_sensors(run: Repetition) -> None:
    if run.mqtt.blocks("messages"):
        nonce = f"nonce-{run.rng.getrandbits(64):016x}"
        await collect(run, {"sensors/#": ("sensors/temperature", nonce)})
        return
    reply = await run.mqtt.call("subscribe", filter="sensors/#", qos=0)
    run.succeeds(reply, granted_qos=0)
    qos = run.mqtt.if_taken("subscribe", "qos", 0)
    # An adapter that holds the subscription already need not ask for it again.
    run.witnessed(mqtt.subscribed(await run.mqtt.session_journal(), filter="sensors/#", qos=qos))
    topic, payload = "sensors/temperature", f"nonce-{run.rng.getrandbits(64):016x}".encode()
    await run.mqtt.publish_from_kit(topic, payload)
    await run.mqtt.wait_for(kind="PUBLISH", direction="out", topic=topic, timeout_s=1.0)
    run.witnessed(mqtt.delivered(await run.mqtt.journal(), topic=topic, payload=payload))


@subscribe_to_sensors.after
async def a_received_message_can_be_read(run: Repetition) -> None:
    if run.mqtt.blocks("messages"):
        return
    nonce = f"nonce-{run.rng.getrandbits(64):016x}"
    run.succeeds(await run.mqtt.call("messages", filter="sensors/#"))
    await run.mqtt.publish_from_kit("sensors/pressure", nonce.encode())
    await run.mqtt.wait_for(kind="PUBLISH", direction="out", topic="sensors/pressure", timeout_s=1.0)
    await let_it_read(run, "sensors/#")
    run.receives(await run.mqtt.call("messages", filter="sensors/pressure"), "sensors/pressure", nonce)


@NORMAL.task(
    "Q3",
    "MQTT",
    "Publish a standard MQTT control payload.",
    needs="mqtt.publish",
    guards="mqtt",
    requirements="MQT-001 MQT-003 WR-003 WR-004",
)
async def publish_control(run: Repetition) -> None:
    payload = json.dumps({"pump_speed": 50 + run.rep})
    reply = await run.mqtt.call("publish", topic="control/pump", payload=payload, qos=0)
    run.succeeds(reply, topic="control/pump", delivery="unacknowledged")
    await run.mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/pump", timeout_s=1.0)
    qos = run.mqtt.if_taken("publish", "qos", 0)
    journal = await run.mqtt.journal()
    run.witnessed(mqtt.published_once(journal, topic="control/pump", payload=payload.encode(), qos=qos))


@publish_control.after
async def nothing_is_published_with_writes_disabled(run: Repetition) -> None:
    await guarded_publish(run, "publish", topic="control/pump", payload="guarded", qos=0)


async def guarded_publish(run: Repetition, operation: str, **inputs: Any) -> None:
    if not run.mqtt.claims("guard"):
        return
    guarded = run.guarded("mqtt")
    run.fails(await guarded.call(operation, **inputs), "writes_disabled", outcome="not_sent")
    # A denial proves something only if the session reaches its broker; the same call works in the task itself.
    if guarded.claims("info"):
        run.succeeds(await guarded.call("info"))
        run.witnessed(mqtt.exchange(await guarded.journal()))
    await guarded.close_session()
    run.witnessed(mqtt.no_packet(await guarded.session_journal(), "PUBLISH", direction="in"))


@NORMAL.task(
    "Q4",
    "MQTT",
    "Publish a Sparkplug B DDATA update for the mock device.",
    needs="mqtt.device_birth mqtt.device_data",
    guards="mqtt",
    requirements="WR-004 SPB-001 SPB-002 SPB-003 SPB-004",
)
async def publish_device_data(run: Repetition) -> None:
    value = 20.0 + run.rep
    metrics = [{"name": "temperature", "value": value}]
    reply = await run.mqtt.call("device_data", device="device-1", metrics=metrics)
    run.succeeds(reply, metric_count=1)
    await run.mqtt.wait_for(kind="PUBLISH", direction="in", timeout_s=1.0)
    run.witnessed(
        mqtt.ddata_metric(await run.mqtt.journal(), device="device-1", name="temperature", value=value),
        mqtt.sparkplug_sequence(await run.mqtt.session_journal()),
    )


@publish_device_data.before
async def the_device_is_born(run: Repetition) -> None:
    metrics = [{"name": "temperature", "datatype": "Double", "value": 20.0}]
    run.succeeds(await run.mqtt.call("device_birth", device="device-1", metrics=metrics))


@publish_device_data.after
async def no_device_is_born_with_writes_disabled(run: Repetition) -> None:
    metrics = [{"name": "temperature", "datatype": "Double", "value": 20.0}]
    await guarded_publish(run, "device_birth", device="device-1", metrics=metrics)


@NORMAL.task(
    "O1",
    "OPC UA",
    "Read the temperature sensor variable from the OPC UA mock plant.",
    needs="opcua.read",
    requirements="RD-001 RD-004 OUA-002",
)
async def read_temperature(run: Repetition) -> None:
    value = round(run.rng.uniform(-50.0, 150.0), 6)
    await run.opcua.poke(node="Temperature", value=value)
    reply = await run.opcua.call("read", node="ns=2;s=Temperature")
    run.succeeds(reply, value=value, status="Good")
    journal = await run.opcua.journal()
    run.witnessed(
        opcua.read_from_device(journal, "ns=2;s=Temperature"),
        opcua.no_state_changing_service(journal),
        opcua.image_holds(await run.opcua.image(), "ns=2;s=Temperature", value),
    )


@NORMAL.task(
    "O2",
    "OPC UA",
    "Browse the actuator subtree in the mock plant.",
    needs="opcua.browse",
    requirements="OUA-006",
)
async def browse_actuators(run: Repetition) -> None:
    image = await run.opcua.image()
    actuators = opcua.children_of(image, "Actuators")
    reply = await run.opcua.call("browse", node=opcua.folder_id(image, "Actuators"))
    run.succeeds(reply)
    run.witnessed(
        opcua.names_and_ids_agree(reply.outputs.get("node_ids"), reply.outputs.get("browse_names"), actuators),
        opcua.browsed(await run.opcua.journal(), opcua.folder_id(image, "Actuators")),
    )


@NORMAL.task(
    "O3",
    "OPC UA",
    "Write the valve-position variable and confirm the new value.",
    needs="opcua.write opcua.read",
    guards="opcua",
    requirements="WR-004 WR-001 WR-002 WR-003",
)
async def write_valve_position(run: Repetition) -> None:
    value = 25.0 + run.rep
    valve = "ns=2;s=ValvePosition"
    before = await run.opcua.image()
    written = await run.opcua.call("write", node=valve, value=value)
    after = await run.opcua.image()
    read = await run.opcua.call("read", node=valve)
    run.succeeds(written, value=value)
    run.succeeds(read, value=value, status="Good")
    await run.opcua.tick(2)
    run.witnessed(
        opcua.exactly_one_write(await run.opcua.journal(), valve, value),
        opcua.only_changed(before, after, {valve: value}),
        opcua.image_holds(await run.opcua.image(), valve, value),
    )


@write_valve_position.after
async def nothing_is_written_with_writes_disabled(run: Repetition) -> None:
    if not run.opcua.claims("guard"):
        return
    guarded = run.guarded("opcua")
    before = await guarded.image()
    run.fails(
        await guarded.call("write", node="ns=2;s=ValvePosition", value=99.5), "writes_disabled", outcome="not_sent"
    )
    run.succeeds(await guarded.call("read", node="ns=2;s=ValvePosition"))
    await guarded.close_session()
    run.witnessed(
        opcua.read_from_device(await guarded.journal(), "ns=2;s=ValvePosition"),
        opcua.no_state_changing_service(await guarded.session_journal()),
        opcua.only_changed(before, await guarded.image(), {}),
    )


@NORMAL.task(
    "O4",
    "OPC UA",
    "Enumerate the mock plant variables through the adapter.",
    needs="opcua.variables",
    requirements="OUA-006",
)
async def enumerate_variables(run: Repetition) -> None:
    reply = await run.opcua.call("variables")
    run.succeeds(reply)
    run.witnessed(
        opcua.complete_enumeration(reply.outputs.get("node_ids"), await run.opcua.image()),
        opcua.some_service(await run.opcua.journal()),
    )


async def snapshot(run: Repetition, *, parallel: bool) -> None:
    registers = [run.rng.randrange(0x10000) for _ in range(4)]
    temperature, pressure = (round(run.rng.uniform(0.0, 100.0), 6) for _ in range(2))
    await run.modbus.poke(unit=1, table="input_registers", address=0, values=registers)
    await run.opcua.poke(node="Temperature", value=temperature)
    await run.opcua.poke(node="Pressure", value=pressure)
    calls = (
        run.modbus.call("read_input", address=0, count=4),
        run.opcua.call("read_many", nodes=["ns=2;s=Temperature", "ns=2;s=Pressure"]),
        run.mqtt.call("info"),
    )
    block, nodes, info = await (run.together if parallel else run.in_order)(*calls)
    run.succeeds(block, values=registers)
    run.succeeds(nodes, values=[temperature, pressure])
    run.succeeds(info, connected=True)
    run.witnessed(
        modbus.exactly_one_request(await run.modbus.journal(), function=READ_INPUT_REGISTERS, address=0, quantity=4),
        opcua.read_from_device(await run.opcua.journal(), "ns=2;s=Temperature"),
        opcua.read_from_device(await run.opcua.journal(), "ns=2;s=Pressure"),
        mqtt.exchange(await run.mqtt.journal()),
    )


async def control_sequence(run: Repetition, *, parallel: bool) -> None:
    pump = "ns=2;s=PumpEnabled"
    payload = json.dumps({"command": "start", "repetition": run.rep, "nonce": run.rng.getrandbits(32)})
    # Away from the values to be written, so that a write that never happened cannot pass.
    await run.modbus.poke(unit=1, table="holding_registers", address=3, values=[0])
    await run.opcua.poke(node="PumpEnabled", value=False)
    calls = (
        run.modbus.call("write_holding", address=3, value=60),
        run.opcua.call("write", node=pump, value=True),
        run.mqtt.call("publish", topic="control/line", payload=payload, qos=0),
    )
    register, node, message = await (run.together if parallel else run.in_order)(*calls)
    run.succeeds(register, value=60)
    run.succeeds(node, value=True)
    run.succeeds(message, topic="control/line")
    qos = run.mqtt.if_taken("publish", "qos", 0)
    await run.mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/line", timeout_s=1.0)
    run.witnessed(
        modbus.exactly_one_write(await run.modbus.journal(), "holding_registers", address=3, values=[60]),
        modbus.image_holds(await run.modbus.image(), "holding_registers", 3, [60]),
        opcua.exactly_one_write(await run.opcua.journal(), pump, True),
        opcua.image_holds(await run.opcua.image(), pump, True),
        mqtt.published_once(await run.mqtt.journal(), topic="control/line", payload=payload.encode(), qos=qos),
    )


@NORMAL.task(
    "X1",
    "Cross-protocol",
    "Collect a multi-adapter state snapshot across Modbus, OPC UA, and MQTT.",
    needs="modbus.read_input opcua.read_many mqtt.info",
    requirements="RD-001",
)
async def sequential_snapshot(run: Repetition) -> None:
    await snapshot(run, parallel=False)


@NORMAL.task(
    "X2",
    "Cross-protocol",
    "Execute a coordinated multi-adapter control sequence.",
    needs="modbus.write_holding opcua.write mqtt.publish",
    requirements="WR-001 WR-003 MQT-001",
)
async def sequential_control(run: Repetition) -> None:
    await control_sequence(run, parallel=False)


@NORMAL.task(
    "X1p",
    "Cross-protocol",
    "Parallel multi-adapter state snapshot across Modbus, OPC UA, and MQTT.",
    needs="modbus.read_input opcua.read_many mqtt.info",
    requirements="RD-001 CON-001",
)
async def parallel_snapshot(run: Repetition) -> None:
    await snapshot(run, parallel=True)


@NORMAL.task(
    "X2p",
    "Cross-protocol",
    "Parallel coordinated multi-adapter control sequence.",
    needs="modbus.write_holding opcua.write mqtt.publish",
    requirements="WR-001 WR-003 MQT-001",
)
async def parallel_control(run: Repetition) -> None:
    await control_sequence(run, parallel=True)


@pytest.mark.parametrize("task", NORMAL, ids=lambda task: task.id)
def test_normal(task: Task, otmcp_trial: Callable[[Task], None]) -> None:
    otmcp_trial(task)
