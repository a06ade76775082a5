"""WR: writes, and what keeps them from happening."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.bounds import Limit
from pytest_otmcp.protocols.exercise import Asked, Limited
from pytest_otmcp.protocols.journal import ADAPTER, Entries, JournalEntry
from pytest_otmcp.protocols.modbus import oracle as modbus_oracle
from pytest_otmcp.protocols.modbus.entries import as_modbus, describe, points
from pytest_otmcp.protocols.mqtt.commands import SCAN_RATE, asks_for_births
from pytest_otmcp.protocols.mqtt.entries import payload_of
from pytest_otmcp.protocols.mqtt.oracle import Publications
from pytest_otmcp.protocols.opcua import oracle as opcua_oracle
from pytest_otmcp.protocols.oracle import state_changing
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.wire.mqtt.sparkplug import parse_topic

from ..commanded import carried_out
from ..commanded import guarded as guarded_command
from ..tasks.common import ITS_OWN_REFUSALS, UNCERTAIN, a_meaningless_switch_enables_nothing, each_fails, each_write
from .fenced import BEYOND, FORBIDDEN, beyond, can_be_asked, is_written, refused, whole
from .steps import (
    CONNECTION_FAULTS,
    QUIET_S,
    a_read_works,
    a_write_works,
    answers_again,
    citing,
    exact_or_refused,
    exercise,
    fails_or_relays,
    faulty,
    nothing_arrived,
    polls,
    reads_anything,
    reset,
    said_of_repetitions,
    silence,
    since,
    witness,
    write,
)

__all__ = ["TASKS"]

TASKS = Checks()

_LATE_S = 0.2
"""Seconds by which an answer is late, well below every timeout."""

_SHUTTING_DOWN = 0x8B
"""Reason code of a broker that ends a connection."""

_VALVE = "ns=2;s=ValvePosition"
_SENSOR = "ns=2;s=Temperature"
"""A variable that nobody may write."""
_EDGE_NODE = "edge-node-1"
"""The node as the mock has it."""
_METRICS = [{"name": "temperature", "datatype": "Double", "value": 20.0}]


# -- what is written ----------------------------------------------------------------------------------------


def _every_write(run: Repetition, at: Rig) -> list[Asked]:
    """Return a write by every operation that the subject has bound; each changes what the device held before."""
    every = exercise(at).every_write
    assert every is not None
    return [asked for asked in every(run.rng) if at.subject.claims(asked.operation)]


async def _prepare(at: Rig, asked: Asked) -> None:
    for poke in asked.pokes:
        await at.device.poke(**poke)


# -- WR-001, WR-002 -----------------------------------------------------------------------------------------


@TASKS.check("WR-001", "What is reported as written is in the device.", needs="modbus.write_holding")
async def a_modbus_write_has_its_effect(run: Repetition, modbus: Rig) -> None:
    """Write by every operation that writes; then write a register while the device refuses it; switch coils on and off. Write a register with
    the value that was written last, after the device has changed it.

    Said: success; for the write that is refused a failure with `illegal_value`.
    Seen: the device holds what was written, and nothing else has changed; what was refused is not in it.
    Why: an assistant that reads "written" goes on as if the valve had moved.
    """
    await _have_their_effect(run, modbus)
    await modbus.device.fault(*faulty(exercise(modbus).writes, exception=3))
    _, refused = await write(run, modbus)
    await modbus.device.fault()
    codes = ["illegal_value"]
    if refused.success is False and refused.error_code not in codes:
        # Without its device an adapter has nothing to tell of what the device would have said.
        codes += [] if refused.during(await modbus.journal()) else CONNECTION_FAULTS
    run.fails(refused, *codes, requirement="WR-001", code_requirement="ERR-002")
    await _coils_go_both_ways(run, modbus)
    value, other = _two_values(run, modbus)
    change = {"unit": 1, "table": "holding_registers", "address": 1, "values": [other]}
    held, elsewhere = {"1/holding_registers/1": value}, {"address": 2, "value": other}
    await _again_after_a_change(run, modbus, change, held, elsewhere, address=1, value=value)


_DRAWS = 2000
"""Values that are drawn to find two that the schema of a tool allows: of 65535 it may be a thousand."""


def _two_values(run: Repetition, modbus: Rig) -> tuple[int, int]:
    """Return two values of a register that the schema of the tool allows, as far as they are found."""
    first = run.rng.sample(range(1, 0x10000), 2)
    found = [value for value in first if modbus.excess("write_holding", address=1, value=value) is None]
    for _ in range(_DRAWS):
        if len(found) == len(first):
            break
        value = run.rng.randrange(1, 0x10000)
        if value not in found and modbus.excess("write_holding", address=1, value=value) is None:
            found.append(value)
    value, other = found if len(found) == len(first) else first
    return value, other


async def _again_after_a_change(
    run: Repetition,
    at: Rig,
    change: Mapping[str, Any],
    expected: Mapping[str, object],
    elsewhere: Mapping[str, Any],
    **inputs: Any,
) -> None:
    """Write the same value again and again, the last time after another target was written; before each time somebody else has written
    another value."""
    writing = exercise(at).writing
    if not at.can_ask(writing, inputs):
        return
    for number in range(3):
        if number == 2 and at.can_ask(writing, elsewhere):
            run.succeeds(await at.call(writing, **elsewhere), requirement="WR-001")
        await at.device.poke(**change)
        if run.succeeds(await at.call(writing, **inputs), requirement="WR-001"):
            run.witnessed(witness(at).holds(await at.device.image(), expected))


_CELLS = 1000
"""Cells of each table, more than fit into the last eight bits of an address."""


async def _coils_go_both_ways(run: Repetition, modbus: Rig) -> None:
    """Switch a coil on and off, at the usual address and at one that is large."""
    await modbus.prove()
    await modbus.device.poke(unit=1, cells=_CELLS)
    for address in (4, run.rng.randrange(_CELLS // 2, _CELLS)):
        for value in (True, False):
            if not modbus.can_ask("write_coil", {"address": address, "value": value}):
                continue
            await modbus.device.poke(unit=1, table="coils", address=address, values=[not value])
            before = await modbus.device.image()
            reply = await modbus.call("write_coil", address=address, value=value)
            # An adapter may know its coils, and say so of another one.
            refusals = () if address == 4 else ITS_OWN_REFUSALS
            written = exact_or_refused(run, reply, *refusals, requirement="WR-001")
            after = {f"1/coils/{address}": value} if written else {}
            run.witnessed(witness(modbus).only_changed(before, await modbus.device.image(), after, otherwise="WR-001"))
            if written:
                run.witnessed(witness(modbus).holds(await modbus.device.image(), after))


@TASKS.check("WR-001", "What is reported as written is in the server.", needs="opcua.write")
async def an_opcua_write_has_its_effect(run: Repetition, opcua: Rig) -> None:
    """Write by every operation that writes variables; where the tool writes several at once, write two of which one cannot be written; then
    write one while the server refuses it. Write a variable with the value that was written last, after somebody else has changed it. Write to
    nodes that do not exist, and are called nearly like that variable.

    Said: success; for the two a failure, with `partial_failure` or the reason of the refusal; for what is refused with `device_failure`; for
        the missing nodes with `illegal_address` or `invalid_input`.
    Seen: the server holds what was written; what was refused is not in it; nothing changes for the missing nodes.
    Why: an assistant that reads "written" goes on as if the valve had moved.
    """
    await _have_their_effect(run, opcua)
    if opcua.subject.claims("write_many"):
        await _partly_refused(run, opcua)
    await opcua.device.fault(*faulty(exercise(opcua).writes, status="BadDeviceFailure"))
    _, refused = await write(run, opcua)
    await opcua.device.fault()
    run.fails(refused, "device_failure", requirement="WR-001", code_requirement="ERR-003")
    value, other = (round(run.rng.uniform(low, low + 40.0), 3) for low in (1.0, 50.0))
    change = {"node": "ValvePosition", "value": other}
    elsewhere = {"node": "ns=2;s=FanSpeed", "value": other}
    await _again_after_a_change(run, opcua, change, {_VALVE: value}, elsewhere, node=_VALVE, value=value)
    for nearly in (_VALVE[:-1], _VALVE.lower(), f"{_VALVE}1"):
        if not opcua.can_ask("write", {"node": nearly, "value": other}):
            continue
        # A new proof sets values of its own.
        await opcua.prove()
        before = await opcua.device.image()
        reply = await opcua.call("write", node=nearly, value=other)
        run.fails(reply, *ITS_OWN_REFUSALS, requirement="WR-001", code_requirement="ERR-003")
        run.witnessed(witness(opcua).only_changed(before, await opcua.device.image(), {}, otherwise="WR-002"))


@TASKS.every_protocol(
    "WR-001",
    "What is reported as written is in the device.",
    reads=False,
    writes=True,
    having="write_refused",
)
async def a_write_has_its_effect(run: Repetition, at: Rig) -> None:
    """Write by every operation that writes, and with every further argument that says what is to be done, such as a control code and its
    times; then write once while the device refuses it.

    Said: success; for an argument that the adapter does not offer a failure with `unsupported_operation` or `invalid_input`; for the last a
        failure with the code of this refusal.
    Seen: one request with what was asked for; the device holds what was written; what was refused is not in it.
    Why: an assistant that reads "written" goes on as if the valve had moved.
    """
    await _have_their_effect(run, at)
    await _say_what_is_asked_for(run, at)
    refused_by = exercise(at).write_refused
    assert refused_by is not None
    action, code = refused_by
    await at.device.fault(*faulty(exercise(at).writes, **action))
    _, refused = await write(run, at)
    await at.device.fault()
    run.fails(refused, code, requirement="WR-001", code_requirement="ERR-001")


async def _have_their_effect(run: Repetition, at: Rig) -> None:
    await at.prove()
    for asked in _every_write(run, at):
        await _prepare(at, asked)
        reply = await at.call(asked.operation, **asked.inputs)
        run.succeeds(reply, requirement="WR-001")
        if reply.success:
            run.witnessed(witness(at).holds(await at.device.image(), asked.points))
            await _and_back(run, at, asked)
        elif reply.success is False:
            run.witnessed(await _done_all_the_same(at, asked, reply))


async def _and_back(run: Repetition, at: Rig, asked: Asked) -> None:
    """Switch off what a write has switched on; an adapter that always sends "on" would pass otherwise."""
    if asked.inputs.get("value") is not True or {*map(str, asked.points.values())} != {"True"}:
        return
    off = replace(asked, inputs={**asked.inputs, "value": False}, points=dict.fromkeys(asked.points, False))
    if at.can_ask(off.operation, off.inputs):
        run.succeeds(await at.call(off.operation, **off.inputs), requirement="WR-001")
        run.witnessed(witness(at).holds(await at.device.image(), off.points))


async def _done_all_the_same(at: Rig, asked: Asked, reply: Reply) -> list[Finding]:
    """Expect of a write that is told as failed, by no fault of the connection, that the device has not done it."""
    unsure = reply.error_code in CONNECTION_FAULTS or reply.member("error", "outcome") in ("unknown", "applied")
    if unsure or not exercise(at).done(reply.during(await at.journal()), asked):
        return []
    if not asked.points or witness(at).holds(await at.device.image(), asked.points):
        return []
    message = f"{reply.label}: it is told as failed, and the device holds what was to be written"
    return [Finding(code="device_differs", message=message, requirement="WR-001")]


async def _partly_refused(run: Repetition, opcua: Rig) -> None:
    value = round(run.rng.uniform(1.0, 99.0), 3)
    items = [{"node_id": node, "value": value} for node in (_VALVE, _SENSOR)]
    reply = await opcua.call("write_many", items=items)
    statuses = reply.outputs.get("statuses")
    told = len(statuses) == len(items) and "bad" in str(statuses[1]).lower() if isinstance(statuses, list) else False
    # Without an envelope a list that says of each item what became of it is as good as a failure.
    if reply.native or not (reply.success and told):
        codes = ("partial_failure", "not_writable", "access_denied", "invalid_input")
        run.fails(reply, *codes, requirement="ERR-008", code_requirement="ERR-003")


async def _say_what_is_asked_for(run: Repetition, at: Rig) -> None:
    commands = exercise(at).commands
    for asked in () if commands is None else commands(run.rng):
        if not can_be_asked(at, asked):
            continue
        before = await at.device.image()
        reply = await at.call(asked.operation, **asked.inputs)
        done = protocols()[at.protocol].changes(reply.during(await at.journal()))
        written = exact_or_refused(run, reply, "unsupported_operation", "invalid_input", requirement="WR-001")
        # A device that refuses may have been asked for something else.
        if written or done:
            run.witnessed(_sent_as_asked(at, reply, asked, done))
        if written:
            run.witnessed(witness(at).holds(await at.device.image(), asked.points))
        else:
            run.witnessed(witness(at).only_changed(before, await at.device.image(), {}, otherwise="WR-001"))


def _sent_as_asked(at: Rig, reply: Reply, asked: Asked, done: Sequence[JournalEntry]) -> list[Finding]:
    """Expect one request that writes, and that it says what was asked for."""
    says = exercise(at).says
    assert says is not None
    said = [told for entry in done if (told := says(entry)) is not None]
    if len(said) == len(done) == 1 and all(said[0].get(name) == wanted for name, wanted in asked.sent.items()):
        return []
    shown = [{name: told.get(name) for name in asked.sent} for told in said]
    return [
        Finding(
            code="not_written_once",
            message=f"{reply.label}: the device should have seen one request with {dict(asked.sent)}, it saw {shown or 'none'}",
            requirement="WR-001",
            evidence=protocols()[at.protocol].seen(done),
        )
    ]


@TASKS.check("WR-002", "A write changes its target and nothing else.", needs="modbus.write_holding")
async def a_modbus_write_changes_its_target_alone(run: Repetition, modbus: Rig) -> None:
    """Write by every operation that writes, and to a second unit where the tool can name one.

    Said: success.
    Seen: the cells that were written have changed; every other cell of every table of both units is as it was, and those around
        the target have values of their own.
    Why: a neighbour that changes is a machine that nobody commanded.
    """
    await modbus.prove()
    await modbus.device.poke(units=[1, 2])
    for unit in (1, 2):
        for table in ("holding_registers", "input_registers"):
            values = [run.rng.randrange(1, 0x10000) for _ in range(60)]
            await modbus.device.poke(unit=unit, table=table, address=0, values=values)
        for table in ("coils", "discrete_inputs"):
            values = [bool(run.rng.getrandbits(1)) for _ in range(60)]
            await modbus.device.poke(unit=unit, table=table, address=0, values=values)
    for asked in (one for one in _every_write(run, modbus) if one.points):
        await _prepare(modbus, asked)
        await _changes_alone(run, modbus, asked.operation, asked.inputs, asked.points)
        if modbus.subject.accepts_input(asked.operation, "unit") and asked.operation == "write_holding":
            value = run.rng.randrange(1, 0x10000)
            await modbus.device.poke(unit=2, table="holding_registers", address=1, values=[0xFFFF ^ value])
            inputs = {"address": 1, "value": value, "unit": 2}
            await _changes_alone(run, modbus, asked.operation, inputs, points("holding_registers", 1, [value], unit=2))


async def _changes_alone(
    run: Repetition, at: Rig, operation: str, inputs: Mapping[str, Any], expected: Mapping[str, object]
) -> None:
    # A new proof sets values of its own.
    await at.prove()
    before = await at.device.image()
    run.succeeds(await at.call(operation, **inputs), requirement="WR-001")
    run.witnessed(witness(at).only_changed(before, await at.device.image(), expected, otherwise="WR-002"))


@TASKS.every_protocol(
    "WR-002",
    "A write changes its target and nothing else.",
    reads=False,
    writes=True,
    having="every_write",
    apart="modbus",
)
async def a_write_changes_its_target_alone(run: Repetition, at: Rig) -> None:
    """Write by every operation that writes.

    Said: success.
    Seen: what was written has changed, everything else that the device holds is as it was.
    Why: a neighbour that changes is a machine that nobody commanded.
    """
    await at.prove()
    for asked in _every_write(run, at):
        # What a method changes, the subject file does not say.
        if asked.points:
            await _prepare(at, asked)
            await _changes_alone(run, at, asked.operation, asked.inputs, asked.points)


# -- WR-003 -------------------------------------------------------------------------------------------------


@TASKS.every_protocol("WR-003", "A write is sent once, whatever becomes of its answer.", writes=True, status=True)
async def a_write_is_sent_once(run: Repetition, at: Rig) -> None:
    """Write; write while the device answers late; while it resets the connection instead; and while it never answers, over Modbus by
    every operation that writes.

    Said: success twice; then failures with `timeout` or `connection_lost` and the outcome `unknown`, or success where the adapter
        has found out by itself that the write was done.
    Seen: each write once, also while the device is watched afterwards.
    Why: a command that is sent again because its answer was lost is a second movement.
    """
    asks = exercise(at)
    await a_write_works(run, at)
    await at.device.fault(*faulty(asks.writes, delay_s=_LATE_S))
    await a_write_works(run, at)
    for action in (reset(at), silence(at)):
        await at.device.fault(*faulty(asks.writes, **action))
        asked, reply = await write(run, at)
        await at.device.fault()
        await answers_again(run, at)
        await at.watch(QUIET_S)
        if not reply.success:
            run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN, requirement="WR-003", code_requirement="ERR-005")
        entries = since(reply, await at.journal())
        run.witnessed(_at_most_once(at, reply, asks.done(entries, asked), "WR-003", entries))
    if asks.every_writing:
        await _further_writes_are_sent_once(run, at)


async def _further_writes_are_sent_once(run: Repetition, at: Rig) -> None:
    """Write by every further operation while the device never answers."""
    asks = exercise(at)
    for asked in _every_write(run, at):
        if asked.operation == asks.writing or not at.can_ask(asked.operation, asked.inputs):
            continue
        await at.prove()
        await _prepare(at, asked)
        await at.device.fault(*faulty(asks.every_writing, **silence(at)))
        reply = await at.call(asked.operation, **asked.inputs)
        await at.device.fault()
        await answers_again(run, at)
        if not reply.success:
            run.fails(reply, *CONNECTION_FAULTS, *ITS_OWN_REFUSALS, requirement="WR-003", code_requirement="ERR-005")
        entries = since(reply, await at.journal())
        run.witnessed(_at_most_once(at, reply, asks.done(entries, asked), "WR-003", entries))


def _at_most_once(
    at: Rig, reply: Reply, found: Sequence[JournalEntry], requirement: str, entries: Entries = ()
) -> list[Finding]:
    if len(found) <= 1:
        return []
    return [
        Finding(
            code="written_twice",
            message=f"{reply.label}: after its answer was lost the device should have seen this write once, it saw it "
            f"{len(found)} times{said_of_repetitions(at, entries, found)}",
            requirement=requirement,
            evidence=protocols()[at.protocol].seen(found),
        )
    ]


# -- WR-004, WR-005 -----------------------------------------------------------------------------------------


@TASKS.every_protocol(
    "WR-004",
    "With writes disabled nothing is written.",
    reads=False,
    writes=True,
    guard=True,
    having="every_write",
    beside="control_guard",
    apart="opcua",
)
async def the_guard_covers_every_write(run: Repetition, at: Rig, guarded: Rig, uncontrolled: Rig | None = None) -> None:
    """Write by every operation that writes, and by every named command of several effects, with writes disabled; then the same with writes
    enabled. Where the subject has a switch of its own for control of the device itself: write with writes enabled and control disabled, and
    try by every operation to control it.

    Said: refusals with `writes_disabled` and the outcome `not_sent`; then success. Of control that is disabled refusals with
        `writes_disabled` or `access_denied`.
    Seen: over the whole life of the session with writes disabled no request that changes the plant; then one for each effect. With control
        disabled the write alone.
    Why: the write switch is what keeps an assistant's mistake out of the plant, and it has to keep all of them out.
    """
    await _refused_then_written(run, at, guarded)
    await _session_wrote_nothing(run, guarded)
    if uncontrolled is not None:
        await _writes_without_control(run, uncontrolled)


async def _writes_without_control(run: Repetition, uncontrolled: Rig) -> None:
    await a_write_works(run, uncontrolled)
    operations = protocols()[uncontrolled.protocol].operations
    for asked in _every_write(run, uncontrolled):
        if operations[asked.operation].controls:
            await _prepare(uncontrolled, asked)
            reply = await uncontrolled.call(asked.operation, **asked.inputs)
            run.fails(reply, "writes_disabled", "access_denied", outcome="not_sent", requirement="WR-004")
            entries = since(reply, await uncontrolled.journal())
            run.witnessed(nothing_arrived(uncontrolled, entries, requirement="WR-004"))
    await a_write_works(run, uncontrolled)


async def _refused_then_written(run: Repetition, at: Rig, guarded: Rig) -> None:
    await at.prove()
    for asked in _every_write(run, at):
        await _guarded(run, guarded, asked.operation, asked.inputs)
        await _prepare(at, asked)
        reply = await at.call(asked.operation, **asked.inputs)
        run.succeeds(reply, requirement="WR-001")
        run.witnessed(_one_change(at, asked.inputs, reply, await at.journal()))
    await _sequences_refused_then_written(run, at, guarded)


async def _sequences_refused_then_written(run: Repetition, at: Rig, guarded: Rig) -> None:
    commanded = exercise(at).commanded
    for asked in () if commanded is None else commanded(run.rng):
        if asked.then:
            await guarded_command(run, guarded, asked)
            await carried_out(run, at, asked)


async def _guarded(run: Repetition, guarded: Rig, operation: str, inputs: Mapping[str, Any]) -> None:
    reply = await guarded.call(operation, **inputs)
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.witnessed(nothing_arrived(guarded, since(reply, await guarded.journal()), requirement="WR-004"))


def _one_change(at: Rig, inputs: Mapping[str, Any], reply: Reply, entries: Entries) -> list[Finding]:
    protocol, items = protocols()[at.protocol], inputs.get("items")
    found = protocol.changes(reply.during(entries))
    # Of several targets each may have a request of its own.
    parts, targets = sum(map(protocol.parts, found)), len(items) if isinstance(items, list) else 1
    if len(found) == 1 or parts == targets or not reply.success:
        return []
    return [
        Finding(
            code="not_written_once",
            message=f"{reply.label}: with writes enabled the device should have seen one request that writes, it saw "
            f"{len(found)}",
            requirement="WR-003" if found else "WR-001",
            evidence=protocols()[at.protocol].seen(found),
        )
    ]


async def _session_wrote_nothing(run: Repetition, guarded: Rig) -> None:
    """Expect that the read-only session works, and that in its whole life, its end included, it wrote nothing."""
    await a_read_works(run, guarded)
    await guarded.close_session()
    known = {finding.code for finding in run.ledger.findings}
    if guarded.protocol == "mqtt":
        found = (await guarded.follow(Publications)).guarded(guarded.subject.declared)
    else:
        found = witness(guarded).nothing_changed_by(await guarded.follow(StateChanges))
    run.witnessed([finding for finding in found if finding.code not in known])


@TASKS.check("WR-004", "With writes disabled nothing is written or called.", needs="opcua.write opcua.guard")
async def the_opcua_guard_covers_every_write(run: Repetition, opcua: Rig, opcua_ro: Rig) -> None:
    """Write, and call a method, by every operation that does so, with writes disabled; then the same with writes enabled.

    Said: refusals with `writes_disabled` and the outcome `not_sent`; then success.
    Seen: over the whole life of the session with writes disabled no Write and no Call; then one for each of them.
    Why: a method moves the plant as a write does, and the write switch has to keep both out.
    """
    await _refused_then_written(run, opcua, opcua_ro)
    rate = round(run.rng.uniform(1.0, 99.0), 3)
    owner = opcua_oracle.folder_id(await opcua.device.image(), "Methods")
    call: dict[str, Any] = {"object": owner, "method": "ns=2;s=SetProductionRate", "arguments": [rate]}
    if opcua.subject.claims("call_method") and opcua.expresses("call_method", call):
        await _guarded(run, opcua_ro, "call_method", call)
        reply = await opcua.call("call_method", **call)
        run.succeeds(reply, requirement="OUA-001")
        run.witnessed(_one_change(opcua, call, reply, await opcua.journal()))
    await _session_wrote_nothing(run, opcua_ro)


@TASKS.check(
    "WR-004",
    "With writes disabled nothing is published.",
    needs="mqtt.write mqtt.read_or_status mqtt.guard",
)
async def the_mqtt_guard_covers_every_write(run: Repetition, mqtt: Rig, mqtt_ro: Rig) -> None:
    """Publish a message, Sparkplug messages and Sparkplug commands by every operation and every named command that does so, with
    writes disabled; then the same with writes enabled.

    Said: refusals with `writes_disabled` and the outcome `not_sent`; then success.
    Seen: over the whole life of the session with writes disabled no command and no Sparkplug message; then one for each of them.
    Why: a command to an edge node moves the plant as a message on a control topic does.
    """
    device = f"guarded-{run.rng.getrandbits(16):04x}"
    data = [{"name": "temperature", "value": 21.0}]
    scan_rate = [{"name": SCAN_RATE, "datatype": "Int64", "value": 4_242}]
    command = [{"name": "setpoint", "datatype": "Double", "value": 42.5}]
    every: list[tuple[str, Mapping[str, Any]]] = [
        ("publish", {"topic": "control/pump", "payload": f"{device}", "qos": 1}),
        ("node_birth", {"metrics": _METRICS}),
        ("node_data", {"metrics": data}),
        ("device_birth", {"device": device, "metrics": _METRICS}),
        ("device_data", {"device": device, "metrics": data}),
        ("device_death", {"device": device}),
        ("send_node_command", {"node": _EDGE_NODE, "metrics": scan_rate}),
        ("send_device_command", {"node": _EDGE_NODE, "device": "device-1", "metrics": command}),
        ("node_death", {}),
    ]
    for operation, inputs in every:
        if not (mqtt.subject.claims(operation) and mqtt.expresses(operation, inputs)):
            continue
        reply = await mqtt_ro.call(operation, **inputs)
        run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
        run.witnessed(_nothing_published(reply, since(reply, await mqtt_ro.journal())))
        control = await mqtt.call(operation, **inputs)
        run.succeeds(control)
        if control.success and not await mqtt.wait_for(kind="PUBLISH", direction="in", timeout_s=1.0):
            run.finding("not_written_once", f"{control.label}: the broker has seen no PUBLISH", "MQT-001")
    commanded = exercise(mqtt).commanded
    for asked in () if commanded is None else commanded(run.rng):
        await guarded_command(run, mqtt_ro, asked)
        await carried_out(run, mqtt, asked)
    await _session_wrote_nothing(run, mqtt_ro)


def _nothing_published(reply: Reply, entries: Entries) -> list[Finding]:
    """Expect that nothing of a refused call was published: no Sparkplug message, and no other one with its payload."""
    for message in protocols()["mqtt"].changes(entries):
        topic = str(message.get("topic"))
        of_sparkplug = parse_topic(topic) is not None and not asks_for_births(message)
        if of_sparkplug or payload_of(message).decode("utf-8", "replace") == reply.arguments.get("payload"):
            text = f"{reply.label}: with writes disabled the broker saw a PUBLISH on {topic}"
            return [Finding(code="wrote", message=text, requirement="WR-004")]
    return []


@TASKS.every_protocol(
    "WR-005", "A write switch that means nothing enables nothing.", writes=True, guard=True, status=True
)
async def a_meaningless_switch(run: Repetition, at: Rig, guarded: Rig) -> None:
    """Write with writes disabled; with writes enabled; and through an adapter that was started with a write switch that means
    nothing.

    Said: a refusal with `writes_disabled`; success; the refusal again, unless the adapter refuses to start so.
    Seen: the second write alone.
    Why: a switch that is misspelt must not open what it was to keep shut.
    """
    asked, refused = await write(run, guarded)
    run.fails(refused, "writes_disabled", outcome="not_sent", requirement="WR-004")
    await a_write_works(run, at)
    await guarded.close_session()
    await a_meaningless_switch_enables_nothing(run, guarded, asked.operation, **asked.inputs)


# -- WR-006, WR-007 -----------------------------------------------------------------------------------------


_NO_NUMBER = (*BEYOND, "type_mismatch")
_TOO_SOON = ("rate_limited", "access_denied")
_MARGIN_S = 0.1
"""Seconds beyond the time between two writes: two clocks count it."""


@TASKS.every_protocol(
    "WR-006", "What is not on the list is not written.", writes=True, launch="bounds", having="fenced"
)
async def only_what_is_on_the_list_is_written(run: Repetition, at: Rig, bounded: Rig) -> None:
    """Through an adapter that was told which targets may be written: write what is on the list; what is just outside, in a range across an end,
    in a batch with one that is allowed, and by another name; once with further arguments such as `force`.

    Said: success for what is on the list; else failures with `access_denied`, or that there is no such target, and the outcome `not_sent`.
    Seen: what is on the list; of everything else nothing, not even a part.
    Why: a list that looks at the first register alone lets an assistant write whatever lies behind it.
    """
    asks, bounds = exercise(at), bounded.subject.bounds
    if not bounds.allowed:
        run.not_applicable("the subject file does not say which targets the adapter was told to allow")
    assert asks.fenced is not None
    every = [asked for asked in asks.fenced(run.rng) if can_be_asked(bounded, asked)]
    inside = [asked for asked in every if all(map(bounds.allows, asked.points))]
    outside = [asked for asked in every if asked not in inside]
    # What has limits as well is asked for by WR-007.
    limited = {point for target in bounds.limits for point in _points_of(bounded, target)}
    inside = [asked for asked in inside if limited.isdisjoint(asked.points)]
    if not (inside and outside):
        run.not_applicable("the list has none, or all, of the targets that the kit can write")
    await a_read_works(run, bounded)
    for asked in outside:
        await refused(run, bounded, bounded.call, asked, *FORBIDDEN, requirement="WR-006")
    asked = outside[0]
    if bounded.arguments_of(asked.operation, **asked.inputs) is not None:
        forced = partial(bounded.call_altered, altered=Alteration(given={"force": True, "override": True}))
        await refused(run, bounded, forced, asked, *FORBIDDEN, requirement="WR-006")
    for asked in inside:
        reply = await bounded.call(asked.operation, **asked.inputs)
        if run.succeeds(reply, requirement="WR-006"):
            run.witnessed(await is_written(bounded, reply, asked, "WR-006"))


def _points_of(at: Rig, target: str) -> Iterable[str]:
    known = exercise(at).limited.get(target)
    return () if known is None else known.ways[0](1).points


@TASKS.every_protocol(
    "WR-007", "What is beyond a limit is not written.", writes=True, launch="bounds", having="limited"
)
async def what_is_beyond_a_limit_is_not_written(run: Repetition, at: Rig, bounded: Rig) -> None:
    """Through an adapter that was told limits of values: write the lowest and the highest, a number just beyond each, and what is no number, by every
    operation and every name, scaled ones too; the largest step and a larger one; and again before it is time.

    Said: success for what is within; else failures with `range_overflow`, or `rate_limited` for what comes too soon, and the outcome
        `not_sent`.
    Seen: what is within; nothing of everything else.
    Why: a limit that is compared before the value is scaled is ten times the limit that somebody has set.
    """
    limits = bounded.subject.bounds.limits
    if not limits:
        run.not_applicable("the subject file does not say which limits the adapter was told")
    known = exercise(at).limited
    judged = {
        target: [way for way in known[target].ways if can_be_asked(bounded, way(1))]
        for target in limits
        if target in known
    }
    if not any(judged.values()):
        run.not_applicable("the limits are of targets that the kit cannot write")
    await a_read_works(run, bounded)
    for target, ways in judged.items():
        if ways:
            await _keeps(_Limiting(run, bounded, limits[target], known[target]), ways)


class _Limiting:
    """Writes of one target that has limits.

    Args:
        limit: what the adapter was told.
        known: what the kit can write there.
    """

    def __init__(self, run: Repetition, at: Rig, limit: Limit, known: Limited) -> None:
        self.limit, self.known = limit, known
        self._run, self._at = run, at

    async def held(self, way: Callable[[float], Asked]) -> float:
        """Return the number that the device holds, where it is one of its points; else 0."""
        image: Any = await self._at.device.image()
        held = [image["points"].get(point) for point in way(1).points]
        return held[0] if len(held) == 1 and type(held[0]) in (int, float) else 0

    async def written(self, asked: Asked) -> Reply:
        """Expect that a number within the limits is written, when it is time for it."""
        await self._in_time()
        reply = await self._at.call(asked.operation, **asked.inputs)
        if self._run.succeeds(reply, requirement="WR-007"):
            self._run.witnessed(await is_written(self._at, reply, asked, "WR-007"))
        return reply

    async def refused(self, asked: Asked, *codes: str) -> None:
        """Expect that a write is refused, when it is time for one."""
        await self._in_time()
        await refused(self._run, self._at, self._at.call, asked, *codes, requirement="WR-007")

    async def refused_after(self, first: Reply, asked: Asked, every_s: float) -> None:
        """Expect that a write is refused which comes too soon after another one, as far as both were quick enough to be too close."""
        call, until_ns = self._at.call, first.exchange.sent_ns + every_s * 1e9
        await refused(self._run, self._at, call, asked, *_TOO_SOON, requirement="WR-007", until_ns=until_ns)

    async def _in_time(self) -> None:
        if self.limit.every_s is not None:
            await self._at.watch(self.limit.every_s + _MARGIN_S)


async def _keeps(at: _Limiting, ways: Sequence[Callable[[float], Asked]]) -> None:
    limit, unit = at.limit, at.known.unit
    last = await at.held(ways[0])
    for way in ways:
        if limit.step is None:
            for bound, outward in ((limit.lowest, -unit), (limit.highest, unit)):
                if bound is not None:
                    await at.written(way(whole(bound)))
                    for asked in beyond(way, bound + outward):
                        await at.refused(asked, *BEYOND)
                    last = bound
        else:
            await at.written(way(whole(last)))
            for asked in beyond(way, last + limit.step + unit):
                await at.refused(asked, *BEYOND)
            last += limit.step
            await at.written(way(whole(last)))
    within = ways[0](whole(last))
    for text in ("NaN", "Infinity") if at.known.given_as in within.inputs else ():
        asked = replace(within, inputs={**within.inputs, at.known.given_as: text})
        await at.refused(asked, *_NO_NUMBER)
    if limit.every_s is not None:
        # A number that a device holds already is not always sent.
        inner = last + unit if limit.highest is None and limit.step is None else last - unit
        await at.refused_after(await at.written(ways[0](whole(inner))), within, limit.every_s)


# -- WR-008, WR-009 -----------------------------------------------------------------------------------------


@TASKS.check("WR-008", "A write of several cells is one request, or it is refused.", needs="modbus.write_registers")
async def a_block_is_one_request(run: Repetition, modbus: Rig) -> None:
    """Write 1, 90, 123, 124 and 1000 registers, and none; where the tool is there, 1968 and 1969 coils, and none. Of 90, as many as the
    tool's own schema allows.

    Said: success; for one too many `limit_exceeded`, for none `invalid_input`. The device has no room for 123 registers and 1968
        coils; it refuses them.
        What the tool's own schema does not allow is refused as one too many is.
    Seen: one well-formed request for 1, 90, 123 and 1968, and none for the others.
    Why: a recipe that is written in two parts is half a recipe in between.
    """
    await _blocks(run, modbus, "write_registers", 16, {1: True, 90: True, 123: False}, (124, 1000))
    if modbus.subject.claims("write_coils"):
        await _blocks(run, modbus, "write_coils", 15, {1: True, 90: True, 1968: False}, (1969,))


async def _blocks(
    run: Repetition, modbus: Rig, operation: str, function: int, fitting: Mapping[int, bool], excessive: Sequence[int]
) -> None:
    """Write blocks of each size; of those for which the device has room and the tool's schema has none, the largest that it allows.

    Args:
        function: of the request.
        fitting: sizes that one request may have, and whether the device has so many cells.
        excessive: sizes that no request may have.
    """
    for count, there in fitting.items():
        if not there and not _allows(modbus, operation, count):
            excessive = (count, *excessive)
            continue
        most = next((size for size in range(count, 0, -1) if not there or _allows(modbus, operation, size)), count)
        values = _cells(run, function, most)
        reply = await modbus.call(operation, address=0, values=values)
        seen = state_changing(reply.during(await modbus.journal()))
        if there:
            run.succeeds(reply, requirement="WR-008")
            run.witnessed(_one_block(reply, seen, function, most))
            table = "holding_registers" if function == 16 else "coils"
            run.witnessed(modbus_oracle.image_holds(await modbus.device.image(), table, 0, list(values)))
        else:
            # An adapter that knows how many cells there are refuses by itself.
            run.fails(
                reply,
                "illegal_address",
                "invalid_input",
                "limit_exceeded",
                requirement="WR-008",
                code_requirement="ERR-002",
            )
            if seen or (reply.error_code == "illegal_address" and _was_sent(reply)):
                run.witnessed(_one_block(reply, seen, function, count))
    for count in (*excessive, 0):
        reply = await modbus.call(operation, address=0, values=_cells(run, function, count))
        codes = ("limit_exceeded", "invalid_input") if count else ("invalid_input",)
        run.fails(reply, *codes, outcome="not_sent", requirement="WR-008")
        run.witnessed(nothing_arrived(modbus, since(reply, await modbus.journal()), requirement="WR-008"))


def _allows(modbus: Rig, operation: str, count: int) -> bool:
    return modbus.excess(operation, address=0, values=[0] * count) is None


def _was_sent(reply: Reply) -> bool:
    return reply.native and reply.member("error", "outcome") == "rejected"


def _cells(run: Repetition, function: int, count: int) -> list[Any]:
    if function == 16:
        return [run.rng.randrange(0x10000) for _ in range(count)]
    return [bool(run.rng.getrandbits(1)) for _ in range(count)]


def _one_block(reply: Reply, seen: Sequence[JournalEntry], function: int, count: int) -> list[Finding]:
    requests = [as_modbus(entry) for entry in seen]
    if (
        len(requests) == 1
        and requests[0].get("quantity") == count
        and (requests[0]["function"] == function or count == 1)
    ):
        return []
    shown = "; ".join(describe(entry)[:60] for entry in seen[:4])
    return [
        Finding(
            code="not_written_once",
            message=f"{reply.tool} of {count} cells: the device should have seen one request with all of them, it saw {len(seen)}",
            requirement="WR-008",
            evidence=shown or "no request",
        )
    ]


@TASKS.check("WR-009", "A write is confirmed only by its own echo.", needs="modbus.write_holding")
async def another_echo_is_no_confirmation(run: Repetition, modbus: Rig) -> None:
    """Write by every operation that writes while the device confirms another value or quantity, and another address; then write
    while it confirms what was written.

    Said: failures with `protocol_error`, or of the connection, and the outcome `unknown`; then success.
    Seen: each write once.
    Why: a confirmation of something else says that something else was done, or that an answer belongs to another request.
    """
    await modbus.prove()
    for asked in _every_write(run, modbus):
        if asked.operation == "write_tag":
            continue
        # A coil has two values: a library need not tell apart what is neither.
        coil = 0 if asked.inputs.get("value") is True else 0xFF00
        other = {"value": 7, "coil": coil, "count": 9, "address": 55}
        # The answer to a mask write has no value of its own.
        for by_value in (False,) if asked.operation == "mask_write" else (True, False):
            await modbus.device.fault(*_other_echoes(other, by_value=by_value))
            reply = await modbus.call(asked.operation, **asked.inputs)
            await modbus.device.fault()
            codes = ("protocol_error", *CONNECTION_FAULTS)
            await fails_or_relays(
                run, modbus, reply, *codes, outcome="unknown", requirement="WR-009", code_requirement="ERR-005"
            )
            await answers_again(run, modbus)
            run.witnessed(_at_most_once(modbus, reply, state_changing(since(reply, await modbus.journal())), "WR-003"))
    await a_write_works(run, modbus)


def _other_echoes(other: Mapping[str, int], *, by_value: bool) -> list[Mapping[str, object]]:
    address = {"echo": {"address": other["address"]}}
    value = {"echo": {"value": other["value"]}} if by_value else address
    coil = {"echo": {"value": other["coil"]}} if by_value else address
    count = {"echo": {"count": other["count"]}} if by_value else address
    return [
        {"function": 5, "action": coil},
        {"function": 6, "action": value},
        *({"function": function, "action": count} for function in (15, 16)),
        {"function": 22, "action": address},
    ]


# -- WR-010, WR-011 -----------------------------------------------------------------------------------------


_WATCHED_S = {False: 2.5, True: 60.0}
"""Seconds for which nothing of it must arrive, in the short and in the long form: also what a timer of two seconds sends."""


@TASKS.every_protocol("WR-010", "What failed is not carried out later.", reads=False, writes=True, facets="recovery")
async def what_failed_is_not_made_up_for(run: Repetition, at: Rig) -> None:
    """Write twice while the device is away: before the adapter has noticed that, and after; and once by every other operation that
    writes. Read when it is back. An adapter without any read, or status, writes while the device takes no client, and once it does again.

    Said: failures of the connection for the writes, success for the reads.
    Seen: none of them, at whatever place, as long as the device is watched, in a soak for a minute.
    Why: a valve that opens when the line is back, minutes after the operator was told that it had not, hurts somebody.
    """
    writes = [exercise(at).write(run.rng), *each_write(run, at)]
    if not reads_anything(at):
        await _while_no_client_is_taken(run, at, writes)
        return
    await at.prove()
    await at.stop_device()
    await each_fails(run, at, writes, code_requirement="ERR-005")
    await at.start_device()
    # An adapter that answers again has its connection back: a write that it had kept would have been sent by now.
    await answers_again(run, at)
    await at.watch(_WATCHED_S[run.soak])
    # A further answer shows that adapter and device ran during that time.
    await a_read_works(run, at, requirement="REC-001")
    run.witnessed(nothing_arrived(at, await at.journal(), requirement="WR-010"))
    await a_write_works(run, at)


_OF_A_HOST = ("send_node_command", "send_device_command")


async def _while_no_client_is_taken(run: Repetition, at: Rig, writes: Sequence[Asked]) -> None:
    """Write while the device ends every connection: were it away, nothing would show that the adapter does not go over to another one."""
    if at.protocol != "mqtt":
        run.not_applicable("the subject has no read, and no status, that shows whether the device is there")
    if any(one.operation in _OF_A_HOST for one in writes):
        run.not_applicable(
            "a host that was away learns its nodes anew, and the subject has nothing that shows when it knows them"
        )
    await at.prove()
    await at.device.fault({"packet": "CONNECT", "action": {"reset": True}})
    await at.device.poke(disconnect={"client_id": None, "reason_code": _SHUTTING_DOWN})
    begun = len(await at.journal())
    await each_fails(run, at, writes, code_requirement="ERR-005")
    await at.device.fault()
    if not at.subject.reconnects:
        await at.fresh_session()
    await at.wait_for(
        kind="CONNACK", direction="out", timeout_s=at.subject.recovery_s, count=1 + _connected(await at.journal())
    )
    await at.watch(_WATCHED_S[run.soak])
    run.witnessed(nothing_arrived(at, (await at.journal())[begun:], requirement="WR-010"))
    await a_write_works(run, at, requirement="REC-001")


def _connected(entries: Entries) -> int:
    return sum(entry["kind"] == "CONNACK" and entry["origin"] == ADAPTER for entry in entries)


@TASKS.check("WR-011", "Bits are changed by one step at the device.", needs="modbus.mask_write")
async def bits_are_changed_in_one_step(run: Repetition, modbus: Rig) -> None:
    """Set one bit of a register in which four other bits change before every request.

    Said: success, or a refusal with `unsupported_operation`.
    Seen: one Mask Write Register, and the other bits as they had become; or nothing.
    Why: who reads, changes and writes back undoes what another client has done meanwhile, an interlock for instance.
    """
    await modbus.prove()
    start, moving, bit = run.rng.randrange(0x10000) & 0xFFFE, 0x00F0, 0x0001
    await modbus.device.poke(unit=1, table="holding_registers", address=30, values=[start])
    restless = {"unit": 1, "table": "holding_registers", "address": 30, "change": "toggle", "bits": moving}
    await modbus.device.poke(restless=[restless])
    reply = await modbus.call("mask_write", address=30, and_mask=0xFFFF ^ bit, or_mask=bit)
    image = await modbus.device.image()
    await modbus.device.poke(restless=[])
    seen = state_changing(since(reply, await modbus.journal()))
    if not reply.success:
        run.fails(reply, "unsupported_operation", outcome="not_sent", requirement="WR-011")
        run.witnessed(nothing_arrived(modbus, seen, requirement="WR-011"))
        return
    changes: int = cast(Any, image)["restless"][0]["changes"]
    expected = (start ^ moving if changes % 2 else start) | bit
    if [as_modbus(entry)["function"] for entry in seen] != [22]:
        run.finding(
            "not_written_once",
            f"{reply.label}: the device should have seen one Mask Write Register",
            "WR-011",
            evidence=protocols()["modbus"].seen(seen),
        )
    run.witnessed(citing("WR-011", modbus_oracle.image_holds(image, "holding_registers", 30, [expected])))


# -- WR-012 -------------------------------------------------------------------------------------------------


@TASKS.every_protocol(
    "WR-012",
    "A value that was read back after a write, and is another one, is not told as written.",
    reads=False,
    writes=True,
    having="clamped",
    apart="opcua",
)
async def what_was_read_back_is_said(run: Repetition, at: Rig) -> None:
    """Write while the device confirms and stores another value; then while it stores what it is given.

    Said: by an adapter that reads back, a failure such as `verify_failed`, or the value that is held now; then success.
    Seen: the write, and what is asked for after it in the same call: an adapter that reads nothing back cannot know.
    Why: who reads back and does not look makes a promise that nobody keeps.
    """
    clamped = exercise(at).clamped
    assert clamped is not None
    expected = clamped(run.rng)
    await at.prove()
    await at.device.fault(*faulty(exercise(at).writes, **expected.action))
    reply = await at.call(expected.write.operation, **expected.write.inputs)
    await at.device.fault()
    told = reply.outputs.get(expected.output)
    looked = _asked_after_the_write(reply.during(await at.journal()))
    unsaid = told != expected.held and not _says(reply, expected.held)
    if reply.success and looked and unsaid and not await polls(at, looked):
        message = f"{reply.label}: the device holds {expected.held} instead and was asked after the write; the reply says {told}"
        found = Finding(code="cut_off", message=message, requirement="WR-012", strength="SHOULD")
        run.judge(reply, [replace(found, evidence=protocols()[at.protocol].seen(looked))])
    await a_write_works(run, at)


def _says(reply: Reply, value: object) -> bool:
    """Tell whether a reply has this value anywhere: beside what was written it may say what was read back."""
    said = json.dumps((reply.envelope or {}).get("data"))
    return re.search(rf"(?<![\w.-]){re.escape(json.dumps(value))}(?![\w.]*\d)", said) is not None


def _asked_after_the_write(entries: Entries) -> list[JournalEntry]:
    written = [entry["seq"] for entry in state_changing(entries)]
    return [
        entry
        for entry in entries
        if written and entry["request"] and not entry["state_changing"] and entry["seq"] > written[-1]
    ]


@TASKS.check(
    "WR-012", "A value that the server cuts off is not told as written.", needs="opcua.write opcua.write.clamped"
)
async def what_is_cut_off_is_said(run: Repetition, opcua: Rig) -> None:
    """Write a variable while the server stores another value and says so; then while it stores what it is given.

    Said: that the value was cut off, and the one that is held now, or a failure; then the value, and that it was not cut off.
    Seen: the value that the server holds.
    Why: an assistant that believes in the value it asked for works with a plant that does not exist.
    """
    await opcua.prove()
    asked, stored = run.rng.uniform(70.0, 99.0), round(run.rng.uniform(1.0, 50.0), 3)
    await opcua.device.fault({"service": "Write", "action": {"clamp": stored}})
    reply = await opcua.call("write", node=_VALVE, value=asked)
    await opcua.device.fault()
    if reply.success and (reply.outputs.get("clamped") is not True or reply.outputs.get("value", stored) != stored):
        message = f"{reply.label}: the server holds {stored} instead, which the reply should say; it says {dict(reply.outputs)}"
        found = Finding(code="cut_off", message=message, requirement="WR-012", strength="SHOULD")
        run.judge(reply, [found])
    control = await opcua.call("write", node=_VALVE, value=stored + 1)
    run.succeeds(control, requirement="WR-001")
    if control.outputs.get("clamped"):
        message = f"{control.label}: the server holds what was asked for, the reply says that it was cut off"
        run.judge(control, [Finding(code="cut_off", message=message, requirement="WR-012", strength="SHOULD")])
