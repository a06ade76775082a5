"""Controls of several items: what an adapter has to refuse, and answers of a device that are no success.

The mock device makes the faults. Each control takes its fault back; where an adapter never answered, the reset before the next item does.
"""

from __future__ import annotations

from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.modbus import oracle as modbus_oracle
from pytest_otmcp.protocols.mqtt import oracle as mqtt_oracle
from pytest_otmcp.protocols.opcua import oracle as opcua_oracle
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .common import CONNECTION_FAULTS, QUIET_S, untold

__all__ = [
    "a_bad_value_is_no_success",
    "a_busy_device_is_no_success",
    "a_fraction_is_not_cut_off",
    "a_long_browse_is_complete",
    "filters_are_no_topics",
    "malformed_answers_are_survived",
    "no_register_follows_the_last",
    "the_text_false_is_not_true",
]

_LAST_ADDRESS = 65535
_BUSY = 6
_ASKED = 4

_PUMP_ENABLED = "ns=2;s=PumpEnabled"
_REFERENCES = 3
"""References in one answer: fewer than any folder of the plant has."""


async def no_register_follows_the_last(run: Repetition, modbus: Rig) -> None:
    """Read two registers of which only the first has an address."""
    beyond: dict[str, Any] = {"address": _LAST_ADDRESS, "count": 2}
    if not modbus.can_ask("read_holding", beyond):
        return
    reply = await modbus.call("read_holding", **beyond)
    run.fails(
        reply, "illegal_address", "invalid_input", "limit_exceeded", requirement="RD-007", code_requirement="ERR-002"
    )


async def a_busy_device_is_no_success(run: Repetition, modbus: Rig) -> None:
    """Read while the device answers that it is busy."""
    await modbus.device.fault({"action": {"exception": _BUSY}})
    reply = await modbus.call("read_holding", address=40, count=1)
    await modbus.device.fault()
    run.fails(reply, "device_busy", requirement="ERR-002")


async def malformed_answers_are_survived(run: Repetition, modbus: Rig) -> None:
    """Read four registers of which the device sends two, and one while the device sends no frame at all; read again after each.

    An adapter may end the connection on such an answer, so one that does not connect again by itself is not asked.
    """
    if not (modbus.subject.claims("recovery") and modbus.subject.reconnects):
        return
    await _short_answer(run, modbus)
    await _one_works_again(run, modbus)
    await modbus.device.fault({"times": 1, "action": {"garbage": True}})
    reply = await modbus.call("read_holding", address=40, count=1)
    await modbus.device.fault()
    # An adapter that asks a second time has an answer.
    if not reply.success:
        run.fails(reply, "protocol_error", *CONNECTION_FAULTS, requirement="RD-005", code_requirement="ERR-002")
    await _one_works_again(run, modbus)


async def _one_works_again(run: Repetition, modbus: Rig) -> None:
    replies = await modbus.call_until_success("read_holding", window_s=0.0, address=40, count=1)
    run.succeeds(replies[-1], requirement="REC-001")


async def _short_answer(run: Repetition, modbus: Rig) -> None:
    block: dict[str, Any] = {"address": 40, "count": _ASKED}
    if not modbus.can_ask("read_holding", block):
        return
    short = [run.rng.randrange(1, 0x10000) for _ in range(2)]
    await modbus.device.fault({"action": {"answer_values": short}})
    reply = await modbus.call("read_holding", **block)
    await modbus.device.fault()
    if not reply.success:
        run.fails(reply, "protocol_error", *CONNECTION_FAULTS, requirement="RD-005", code_requirement="ERR-002")
    else:
        run.judge(reply, _of_a_short_answer(reply, modbus_oracle.values_sent(reply.during(await modbus.journal()))))


def _of_a_short_answer(reply: Reply, sent: list[int]) -> list[Finding]:
    told = reply.outputs.get("values")
    # An adapter may ask for the registers in parts of two, each of which is answered in full.
    if isinstance(told, list) and len(told) == _ASKED <= len(sent):
        return []
    return [
        Finding(
            code="not_refused",
            message=f"{reply.label}: of four registers the device sent {sent}, the reply says {told!r} and claims success",
            requirement="RD-005",
            # What is told was read, though it is not all that was asked for.
            strength="MUST" if isinstance(told, list) and len(told) > len(sent) else "SHOULD",
        )
    ]


async def a_fraction_is_not_cut_off(run: Repetition, modbus: Rig) -> None:
    """Write 40.7 to a register."""
    fraction: dict[str, Any] = {"address": 1, "value": 40.7}
    if not modbus.can_ask("write_holding", fraction):
        return
    await modbus.prove()
    before = await modbus.device.image()
    reply = await modbus.call("write_holding", **fraction)
    after = await modbus.device.image()
    if reply.success:
        told = reply.outputs.get("value")
        run.judge(
            reply,
            modbus_oracle.stored_otherwise(after, "holding_registers", 1, 40.7, told=told, requirement="ADR-004"),
        )
        return
    run.fails(reply, "type_mismatch", "invalid_input", "range_overflow", outcome="not_sent", requirement="ADR-004")
    run.witnessed(
        modbus_oracle.no_state_changing_request(
            reply.during(await modbus.journal()), requirement=untold(reply, "ADR-004")
        ),
        modbus_oracle.only_changed(before, after, {}, otherwise=untold(reply, "ADR-004")),
    )


async def filters_are_no_topics(run: Repetition, mqtt: Rig) -> None:
    """Publish on a topic with a wildcard, and on one with a null character, before anything else was published."""
    payload = "to no topic"
    for topic in ("control/#", "control/\0pump"):
        reply = await mqtt.call("publish", topic=topic, payload=payload, qos=0)
        run.fails(reply, "invalid_input", outcome="not_sent", requirement="ADR-006")
    await mqtt.watch(QUIET_S)
    journal = await mqtt.journal()
    run.witnessed(
        mqtt_oracle.not_published(journal, payload.encode(), requirement="ADR-006", declared=mqtt.subject.declared),
        mqtt_oracle.session_stays_up(journal),
    )


async def the_text_false_is_not_true(run: Repetition, opcua: Rig) -> None:
    """Write the text "false" to a variable that is true or false."""
    await opcua.device.poke(node="PumpEnabled", value=False)
    reply = await opcua.call("write", node=_PUMP_ENABLED, value="false")
    holds = opcua_oracle.held(await opcua.device.image(), _PUMP_ENABLED)
    await opcua.device.poke(node="PumpEnabled", value=True)
    if not reply.success:
        run.fails(reply, "type_mismatch", "invalid_input", outcome=("not_sent", "rejected"), requirement="ADR-004")
    if holds is not False:
        finding = Finding(
            code="device_differs",
            message=f"{reply.label}: {_PUMP_ENABLED} was false, it holds {holds!r} after the text 'false' was written",
            requirement="ADR-004",
        )
        run.judge(reply, [finding])


async def a_bad_value_is_no_success(run: Repetition, opcua: Rig) -> None:
    """Read a variable while its sensor has failed."""
    # Set at the node, it also reaches an adapter that has itself notified.
    await opcua.device.poke(node="Temperature", value=0.0, status="BadSensorFailure")
    reply = await opcua.call("read", node="ns=2;s=Temperature")
    await opcua.device.poke(node="Temperature", value=0.0)
    run.fails(reply, "bad_quality", "device_failure", requirement="OUA-002", code_requirement="ERR-003")


async def a_long_browse_is_complete(run: Repetition, opcua: Rig) -> None:
    """Browse while the server sends few references in one answer."""
    await opcua.device.poke(limits={"references_per_node": _REFERENCES})
    image = await opcua.device.image()
    reply = await opcua.call("browse", node=opcua_oracle.folder_id(image, "Actuators"))
    await opcua.device.poke(limits={"references_per_node": 0})
    run.succeeds(reply)
    actuators = opcua_oracle.children_of(image, "Actuators")
    run.witnessed(
        opcua_oracle.names_and_ids_agree(reply.outputs.get("node_ids"), reply.outputs.get("browse_names"), actuators)
    )
