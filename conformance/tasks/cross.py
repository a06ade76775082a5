"""The tasks on several protocols at once: snapshots and coordinated commands.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
devices. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

import json

from pytest_otmcp.protocols.modbus import oracle as modbus_oracle
from pytest_otmcp.protocols.mqtt import oracle as mqtt_oracle
from pytest_otmcp.protocols.opcua import oracle as opcua_oracle
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

from .common import NOTHING_SENT, fresh, status_is_known
from .modbus import SENSOR_BLOCK
from .opcua import reading

__all__ = ["TASKS"]

TASKS = Tasks()


async def snapshot(run: Repetition, modbus: Rig, mqtt: Rig, opcua: Rig, *, parallel: bool) -> None:
    registers = [run.rng.randrange(0x10000) for _ in range(4)]
    temperature, pressure = (round(run.rng.uniform(0.0, 100.0), 6) for _ in range(2))
    await modbus.device.poke(unit=1, table="input_registers", address=0, values=registers)
    await opcua.device.poke(node="Temperature", value=temperature)
    await opcua.device.poke(node="Pressure", value=pressure)
    calls = (
        modbus.call("read_input", address=0, count=4),
        opcua.call("read_many", nodes=["ns=2;s=Temperature", "ns=2;s=Pressure"]),
        mqtt.call("info"),
    )
    block, nodes, info = await (run.together if parallel else run.in_order)(*calls)
    run.succeeds(block, values=registers)
    run.succeeds(nodes, values=[temperature, pressure])
    run.succeeds(info, connected=True)
    both = await opcua.journal()
    run.witnessed(
        fresh(await modbus.journal(), (block, SENSOR_BLOCK)),
        fresh(both, (nodes, reading("ns=2;s=Temperature")), (nodes, reading("ns=2;s=Pressure"))),
    )
    await status_is_known(run, mqtt, mqtt_oracle.exchange, info)


async def control_sequence(run: Repetition, modbus: Rig, mqtt: Rig, opcua: Rig, *, parallel: bool) -> None:
    pump = "ns=2;s=PumpEnabled"
    payload = json.dumps({"command": "start", "repetition": run.rep, "nonce": run.rng.getrandbits(32)})
    # The old values differ from those to be written, so that a write that never happened cannot pass.
    await modbus.device.poke(unit=1, table="holding_registers", address=3, values=[0])
    await opcua.device.poke(node="PumpEnabled", value=False)
    calls = (
        modbus.call("write_holding", address=3, value=60),
        opcua.call("write", node=pump, value=True),
        mqtt.call("publish", topic="control/line", payload=payload, qos=0),
    )
    register, node, message = await (run.together if parallel else run.in_order)(*calls)
    run.succeeds(register, value=60)
    run.succeeds(node, value=True)
    run.succeeds(message, topic="control/line")
    qos = mqtt.subject.expected_if_accepted("publish", "qos", 0)
    await mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/line", timeout_s=1.0)
    run.witnessed(
        modbus_oracle.exactly_one_write(await modbus.journal(), "holding_registers", address=3, values=[60]),
        modbus_oracle.image_holds(await modbus.device.image(), "holding_registers", 3, [60]),
        opcua_oracle.exactly_one_write(await opcua.journal(), pump, True),
        opcua_oracle.image_holds(await opcua.device.image(), pump, True),
        mqtt_oracle.published_once(
            await mqtt.journal(),
            topic="control/line",
            payload=payload.encode(),
            qos=qos,
            declared=mqtt.subject.declared,
        ),
    )


@TASKS.task(
    "X1",
    "normal",
    "Collect a multi-adapter state snapshot across Modbus, OPC UA, and MQTT.",
    needs="modbus.read_input opcua.read_many mqtt.info",
    capability="reading",
    requirements="RD-001",
)
async def sequential_snapshot(run: Repetition, modbus: Rig, mqtt: Rig, opcua: Rig) -> None:
    """Read four registers and two variables, and ask for the state of the connection to the broker, one call after the
    other.

    Said: the values that were set at random just before, and connected.
    Seen: the reads of registers and variables, and an exchange with the broker.
    Why: a picture of the plant is worth nothing when a part of it is old.
    """
    await snapshot(run, modbus, mqtt, opcua, parallel=False)


@TASKS.task(
    "X2",
    "normal",
    "Execute a coordinated multi-adapter control sequence.",
    needs="modbus.write_holding opcua.write mqtt.publish",
    capability="writing",
    requirements="WR-001 WR-003 MQT-001",
)
async def sequential_control(run: Repetition, modbus: Rig, mqtt: Rig, opcua: Rig) -> None:
    """Write a register and a variable, and publish a command, one call after the other.

    Said: success with the values and the topic.
    Seen: each write once, and in the device; the message once.
    Why: a sequence of which one step is missing or doubled leaves the plant in a state that nobody planned.
    """
    await control_sequence(run, modbus, mqtt, opcua, parallel=False)


@TASKS.task(
    "X1p",
    "normal",
    "Parallel multi-adapter state snapshot across Modbus, OPC UA, and MQTT.",
    needs="modbus.read_input opcua.read_many mqtt.info",
    capability="load",
    requirements="RD-001 CON-001",
)
async def parallel_snapshot(run: Repetition, modbus: Rig, mqtt: Rig, opcua: Rig) -> None:
    """Read four registers and two variables, and ask for the state of the connection to the broker, all at the same
    time.

    Said: the values that were set at random just before, and connected.
    Seen: the reads of registers and variables, and an exchange with the broker.
    Why: adapters that wait for one another, or mix their answers up, show only under load.
    """
    await snapshot(run, modbus, mqtt, opcua, parallel=True)


@TASKS.task(
    "X2p",
    "normal",
    "Parallel coordinated multi-adapter control sequence.",
    needs="modbus.write_holding opcua.write mqtt.publish",
    capability="load",
    requirements="WR-001 WR-003 MQT-001",
)
async def parallel_control(run: Repetition, modbus: Rig, mqtt: Rig, opcua: Rig) -> None:
    """Write a register and a variable, and publish a command, all at the same time.

    Said: success with the values and the topic.
    Seen: each write once, and in the device; the message once.
    Why: a lost or doubled step shows only under load.
    """
    await control_sequence(run, modbus, mqtt, opcua, parallel=True)


@TASKS.task(
    "FX1",
    "fault",
    "3-step cross-protocol sequence with one deliberate bad OPC UA read; expect 2/3 succeed.",
    needs="modbus.read_input opcua.read mqtt.publish",
    capability="refusing",
    requirements="ERR-003 RD-001 MQT-001",
    keys="opcua.probes.missing_node",
)
async def one_bad_step_of_three(run: Repetition, modbus: Rig, mqtt: Rig, opcua: Rig) -> None:
    """Read four registers, read a node that the server does not have, and publish a command.

    Said: success for the first and the third step, a failure with `illegal_address` for the second.
    Seen: the reads, and the message once.
    Why: one failing step must neither spoil the others nor be hidden by them.
    """
    registers = [run.rng.randrange(0x10000) for _ in range(4)]
    payload = json.dumps({"pump_speed": 50 + run.rep})
    await modbus.device.poke(unit=1, table="input_registers", address=0, values=registers)
    missing_node = opcua.subject.probe("missing_node")
    block = await modbus.call("read_input", address=0, count=4)
    missing = await opcua.call("read", node=missing_node)
    message = await mqtt.call("publish", topic="control/pump", payload=payload, qos=0)
    run.succeeds(block, values=registers)
    asked = missing.during(await opcua.journal())
    if opcua_oracle.reached(asked, missing_node):
        run.fails(missing, "illegal_address", requirement="ERR-003")
        run.witnessed(opcua_oracle.refused_with(asked, missing_node, "BadNodeIdUnknown"))
    else:
        run.fails(missing, "illegal_address", "invalid_input", outcome=NOTHING_SENT, requirement="ERR-003")
    run.succeeds(message, topic="control/pump")
    qos = mqtt.subject.expected_if_accepted("publish", "qos", 0)
    await mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/pump", timeout_s=1.0)
    run.witnessed(
        fresh(await modbus.journal(), (block, SENSOR_BLOCK)),
        mqtt_oracle.published_once(
            await mqtt.journal(),
            topic="control/pump",
            payload=payload.encode(),
            qos=qos,
            declared=mqtt.subject.declared,
        ),
    )
