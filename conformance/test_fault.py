"""The fault suite: seven requests that must be refused, in words an assistant can act on, with nothing changed.

A well-formed error is the point. An adapter that is dead, lacks the tool, prints a traceback or answers with nothing
does not pass: the envelope must name the fault, and the device must show that it was met, or never reached.
"""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from pytest_otmcp.protocols.modbus import oracle as modbus
from pytest_otmcp.protocols.mqtt import oracle as mqtt
from pytest_otmcp.protocols.opcua import oracle as opcua
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.task import Suite, Task

FAULT = Suite("fault")

ILLEGAL_DATA_ADDRESS = 2
VALVE = "ns=2;s=ValvePosition"
QUIET_S = 0.25
"""How long the device is watched, once per item, for a request that must not come."""


@FAULT.task(
    "FM1",
    "Modbus",
    "Read invalid register address (9999) and expect a structured protocol error.",
    needs="modbus.read_holding",
    requirements="ERR-002 ENV-007",
)
async def read_missing_register(run: Repetition) -> None:
    missing = run.modbus.probe("missing_address")
    reply = await run.modbus.call("read_holding", address=missing, count=1)
    run.fails(reply, "illegal_address", trace={"exception_code": ILLEGAL_DATA_ADDRESS})
    journal = await run.modbus.journal()
    run.witnessed(
        modbus.exactly_one_request(journal, function=3, address=missing, quantity=1),
        modbus.exception_sent(journal, ILLEGAL_DATA_ADDRESS),
    )


@FAULT.task(
    "FM2",
    "Modbus",
    "Write overflow value (70000 > uint16 max) and expect adapter rejection.",
    needs="modbus.write_holding",
    requirements="ADR-003 ERR-006",
)
async def write_overflow(run: Repetition) -> None:
    before = await run.modbus.image()
    reply = await run.modbus.call("write_holding", address=1, value=70000)
    run.fails(reply, "range_overflow", outcome="not_sent")
    run.witnessed(
        modbus.no_state_changing_request(await run.modbus.journal()),
        modbus.only_changed(before, await run.modbus.image(), {}),
    )


@write_overflow.after
async def the_largest_value_is_accepted(run: Repetition) -> None:
    await run.modbus.stays_quiet(QUIET_S, modbus.no_state_changing_request)
    run.succeeds(await run.modbus.call("write_holding", address=1, value=65535), value=65535)
    run.witnessed(
        modbus.exactly_one_write(await run.modbus.journal(), "holding_registers", address=1, values=[65535]),
        modbus.image_holds(await run.modbus.image(), "holding_registers", 1, [65535]),
    )


@FAULT.task(
    "FQ1",
    "MQTT",
    "Publish to empty topic string and expect a structured invalid-input error.",
    needs="mqtt.publish",
    requirements="ADR-006 ERR-006",
)
async def publish_to_nowhere(run: Repetition) -> None:
    reply = await run.mqtt.call("publish", topic="", payload=json.dumps({"pump_speed": 50}), qos=0)
    run.fails(reply, "invalid_input", outcome="not_sent")
    journal = await run.mqtt.journal()
    run.witnessed(mqtt.no_packet(journal, "PUBLISH", direction="in"), mqtt.session_stays_up(journal))


@publish_to_nowhere.after
async def a_proper_topic_is_accepted(run: Repetition) -> None:
    await run.mqtt.stays_quiet(QUIET_S, lambda journal: mqtt.no_packet(journal, "PUBLISH", direction="in"))
    run.succeeds(await run.mqtt.call("publish", topic="control/pump", payload="control", qos=0))
    await run.mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/pump", timeout_s=1.0)
    qos = run.mqtt.if_taken("publish", "qos", 0)
    journal = await run.mqtt.journal()
    run.witnessed(mqtt.published_once(journal, topic="control/pump", payload=b"control", qos=qos))


@FAULT.task(
    "FQ2",
    "MQTT",
    "Subscribe with invalid QoS (5) and expect a structured invalid-input error.",
    needs="mqtt.subscribe mqtt.subscribe.qos",
    requirements="ADR-007",
)
async def subscribe_with_qos_5(run: Repetition) -> None:
    reply = await run.mqtt.call("subscribe", filter="sensors/#", qos=run.mqtt.probe("bad_qos"))
    run.fails(reply, "invalid_input")
    journal = await run.mqtt.journal()
    run.witnessed(mqtt.no_packet(journal, "SUBSCRIBE", direction="in"), mqtt.session_stays_up(journal))


@subscribe_with_qos_5.after
async def a_proper_qos_is_accepted(run: Repetition) -> None:
    await run.mqtt.stays_quiet(QUIET_S, lambda journal: mqtt.no_packet(journal, "SUBSCRIBE", direction="in"))
    run.succeeds(await run.mqtt.call("subscribe", filter="sensors/#", qos=1), granted_qos=1)
    run.witnessed(mqtt.subscribed(await run.mqtt.session_journal(), filter="sensors/#", qos=1))


@FAULT.task(
    "FO1",
    "OPC UA",
    "Read non-existent node (ns=2;i=99999) and expect a structured read-failed error.",
    needs="opcua.read",
    requirements="ERR-003 ENV-007",
)
async def read_missing_node(run: Repetition) -> None:
    missing = run.opcua.probe("missing_node")
    reply = await run.opcua.call("read", node=missing)
    run.fails(reply, "illegal_address", trace={"status_code": {"symbol": "BadNodeIdUnknown"}})
    journal = await run.opcua.journal()
    run.witnessed(
        opcua.exactly_one_service(journal, "Read", node=missing),
        opcua.result_status(journal, "Read", "BadNodeIdUnknown"),
    )


@FAULT.task(
    "FO2",
    "OPC UA",
    "Write wrong type (string to float node) and expect a structured write-failed error.",
    needs="opcua.write",
    requirements="ADR-004",
)
async def write_wrong_type(run: Repetition) -> None:
    before = await run.opcua.image()
    reply = await run.opcua.call("write", node=VALVE, value="fully open")
    run.fails(reply, "type_mismatch", outcome=("not_sent", "rejected"))
    run.witnessed(
        opcua.only_changed(before, await run.opcua.image(), {}),
        opcua.accepted_writes(await run.opcua.journal(), 0),
    )


@write_wrong_type.after
async def a_number_is_accepted(run: Repetition) -> None:
    await run.opcua.stays_quiet(QUIET_S, lambda journal: opcua.accepted_writes(journal, 0))
    run.succeeds(await run.opcua.call("write", node=VALVE, value=31.25), value=31.25)
    run.witnessed(
        opcua.accepted_writes(await run.opcua.journal(), 1),
        opcua.image_holds(await run.opcua.image(), VALVE, 31.25),
    )


@FAULT.task(
    "FX1",
    "Cross-protocol",
    "3-step cross-protocol sequence with one deliberate bad OPC UA read; expect 2/3 succeed.",
    needs="modbus.read_input opcua.read mqtt.publish",
    requirements="ERR-003 RD-001 MQT-001",
)
async def one_bad_step_of_three(run: Repetition) -> None:
    registers = [run.rng.randrange(0x10000) for _ in range(4)]
    payload = json.dumps({"pump_speed": 50 + run.rep})
    await run.modbus.poke(unit=1, table="input_registers", address=0, values=registers)
    missing_node = run.opcua.probe("missing_node")
    block = await run.modbus.call("read_input", address=0, count=4)
    missing = await run.opcua.call("read", node=missing_node)
    message = await run.mqtt.call("publish", topic="control/pump", payload=payload, qos=0)
    run.succeeds(block, values=registers)
    run.fails(missing, "illegal_address")
    run.succeeds(message, topic="control/pump")
    qos = run.mqtt.if_taken("publish", "qos", 0)
    await run.mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/pump", timeout_s=1.0)
    run.witnessed(
        modbus.exactly_one_request(await run.modbus.journal(), function=4, address=0, quantity=4),
        opcua.exactly_one_service(await run.opcua.journal(), "Read", node=missing_node),
        mqtt.published_once(await run.mqtt.journal(), topic="control/pump", payload=payload.encode(), qos=qos),
    )


@pytest.mark.parametrize("task", FAULT, ids=lambda task: task.id)
def test_fault(task: Task, otmcp_trial: Callable[[Task], None]) -> None:
    otmcp_trial(task)
