"""CON: calls side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.strict_json import same_json
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.journal import CYCLIC, Entries, JournalEntry
from pytest_otmcp.protocols.modbus import oracle as modbus_oracle
from pytest_otmcp.protocols.modbus.entries import as_modbus
from pytest_otmcp.protocols.modbus.entries import points as registers_of
from pytest_otmcp.protocols.mqtt.oracle import not_granted
from pytest_otmcp.protocols.oracle import state_changing
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .steps import (
    CONNECTION_FAULTS,
    QUIET_S,
    a_read_works,
    answers_again,
    exercise,
    fails_or_relays,
    faulty,
    read,
    relayed,
    silence,
    since,
    witness,
    written_once,
)

__all__ = ["TASKS"]

TASKS = Checks()

_PARALLEL = (4, 16, 64)
_BUSY = ("rate_limited", "device_busy", "limit_exceeded", "timeout")
"""Codes with which an adapter may refuse the last of many calls at the same time."""

_NO_SUCH_WRITE = ("type_mismatch", "invalid_input", "unsupported_operation", "not_writable")
"""Codes with which it refuses a write that it never makes."""

_LATE_S = 0.02
_FIRST_LATE_S, _SECOND_LATE_S = 0.3, 0.6
_ROUNDS = 5
_NEIGHBOURS = 4
_MOST_OUTSTANDING = 16
"""MODBUS Messaging on TCP/IP Implementation Guide V1.0b, section 4.4.1.2: NumberMaxOfClientTransaction."""

_MOST_CONNECTIONS = 8
"""Controllers have room for a few clients only."""

_CONSECUTIVE = {False: 50, True: 1000}
_HELD_UP_S = 1.0


def _has_its_own(run: Repetition, reply: Reply, count: int, **outputs: object) -> None:
    """Expect the answer to this very call; of many calls at the same time an adapter may refuse some."""
    if count > min(_PARALLEL) and reply.success is False:
        run.fails(reply, *_BUSY, requirement="CON-001")
        return
    run.succeeds(reply, requirement="CON-001", **outputs)


# -- CON-001 ------------------------------------------------------------------------------------------------


@TASKS.check("CON-001", "Each of several calls gets its own answer.", needs="modbus.read_input")
async def each_read_of_registers_gets_its_own(run: Repetition, modbus: Rig) -> None:
    """Read 4, 16 and 64 registers by as many calls at the same time, while the device gives every fourth answer late.

    Said: in each answer the value of its own register; of 16 and 64 calls some may be refused.
    Seen: no transaction identifier twice among the requests that wait for an answer.
    Why: an answer that belongs to another call is a wrong value that looks right.
    """
    for count in _PARALLEL:
        values = [run.rng.randrange(0x10000) for _ in range(count)]
        late = run.rng.sample(range(count), count // 4)
        await modbus.device.poke(unit=1, table="input_registers", address=0, values=values)
        await modbus.device.fault(
            *({"function": 4, "address": address, "action": {"delay_s": _LATE_S}} for address in late)
        )
        replies = await run.together(*(modbus.call("read_input", address=i, count=1) for i in range(count)))
        await modbus.device.fault()
        for reply, value in zip(replies, values, strict=True):
            _has_its_own(run, reply, count, values=[value])
    journal = await modbus.journal()
    # Where answers were given to other calls, how many requests wait says nothing more.
    if not run.ledger.failed:
        run.witnessed(_transactions(journal))


def _transactions(entries: Entries) -> list[Finding]:
    """Expect that no two requests of a connection that wait for an answer have the same identifier, and that not too many wait."""
    waiting: dict[int, dict[int, int]] = {}
    most = 0
    findings = []
    for entry in map(as_modbus, entries):
        asked = waiting.setdefault(entry["connection"], {})
        if entry["request"]:
            identifier = entry["transaction_id"]
            if identifier in asked.values():
                findings.append(
                    Finding(
                        code="transaction_twice",
                        message=f"two requests that waited for an answer at the same time had the transaction identifier {identifier}",
                        requirement="CON-001",
                    )
                )
            asked[entry["seq"]] = identifier
            most = max(most, len(asked))
        elif entry["answers"] is not None:
            asked.pop(entry["answers"], None)
    if most > _MOST_OUTSTANDING:
        findings.append(
            Finding(
                code="many_outstanding",
                message=f"on one connection {most} requests waited for an answer at the same time, more than {_MOST_OUTSTANDING}",
                requirement="CON-005",
            )
        )
    return findings[:1]


@TASKS.every_protocol("CON-001", "Each of several calls gets its own answer.", having="distinct", prompt=True)
async def each_read_gets_its_own(run: Repetition, at: Rig) -> None:
    """Read several values by 4, 16 and 64 calls at the same time, while the device answers late for every fourth of them.

    Said: in each answer the value that was asked for; of 16 and 64 calls some may be refused.
    Seen: nothing further.
    Why: an answer that belongs to another call is a wrong value that looks right.
    """
    distinct = exercise(at).distinct
    assert distinct is not None
    for count in _PARALLEL:
        asked = [one for one in distinct(run.rng, count) if at.subject.claims(one.operation)]
        if not asked:
            run.not_applicable("the adapter has no operation that reads such values")
        for poke in {str(poke): poke for one in asked for poke in one.pokes}.values():
            await at.device.poke(**poke)
        conditions = {str(one.condition): one.condition for one in asked}
        late = run.rng.sample(sorted(conditions), len(conditions) // 4)
        await at.device.fault(*faulty([conditions[name] for name in late], delay_s=_LATE_S))
        replies = await run.together(*(at.call(one.operation, **one.inputs) for one in asked))
        await at.device.fault()
        for reply, one in zip(replies, asked, strict=True):
            _has_its_own(run, reply, count, **one.outputs)


@TASKS.check("CON-001", "Each of several calls gets its own answer.", needs="mqtt.subscribe mqtt.subscribe.qos")
async def each_subscription_gets_its_own(run: Repetition, mqtt: Rig) -> None:
    """Subscribe to 4, 16 and 64 filters, each with a quality of service drawn at random, by as many calls at the same time,
    while the broker gives every fourth answer late.

    Said: in each answer the quality of service of its own subscription; of 16 and 64 calls some may be refused.
    Seen: nothing further.
    Why: an answer that belongs to another call says that a subscription is there which is not.
    """
    for count in _PARALLEL:
        asked = {f"otmcp/side/{run.rng.getrandbits(32):08x}": run.rng.randrange(3) for _ in range(count)}
        late = run.rng.sample(sorted(asked), count // 4)
        await mqtt.device.fault(
            *({"packet": "SUBSCRIBE", "topic": text, "action": {"delay_s": _LATE_S}} for text in late)
        )
        replies = await run.together(*(mqtt.call("subscribe", filter=text, qos=qos) for text, qos in asked.items()))
        await mqtt.device.fault()
        for reply, qos in zip(replies, asked.values(), strict=True):
            _has_its_own(run, reply, count, granted_qos=qos)
        if mqtt.subject.claims("unsubscribe"):
            await run.together(*(mqtt.call("unsubscribe", filter=text) for text in asked))


# -- CON-002 ------------------------------------------------------------------------------------------------


async def _late(run: Repetition, at: Rig, operation: str, first: Mapping[str, Any], second: Mapping[str, Any]) -> Reply:
    """Let a call time out at a device that stands still, and return the reply to the next one, during which the answer to the
    first is sent."""
    await at.device.poke(network="stalled")
    reply = await at.call(operation, **first)
    run.fails(reply, *CONNECTION_FAULTS, requirement="TMO-001", code_requirement="ERR-005")
    await at.device.poke(network="open")
    return await at.call(operation, **second)


async def _not_the_late_one(run: Repetition, at: Rig, reply: Reply, **outputs: object) -> None:
    if reply.success:
        run.succeeds(reply, requirement="CON-002", **outputs)
    else:
        codes = ["protocol_error", *CONNECTION_FAULTS]
        if reply.error_code not in codes:
            # The device may have refused it: a session of before is none to a server that stood still.
            codes += relayed(at, reply.during(await at.journal()))
        run.fails(reply, *codes, requirement="CON-002", code_requirement="ERR-005")


@TASKS.check("CON-002", "A late answer is not the answer to a later call.", needs="modbus.read_holding")
async def a_late_register_is_not_taken_for_another(run: Repetition, modbus: Rig) -> None:
    """Read a register while the device stands still, until that times out; then another one, during which the answer to the first
    is sent.

    Said: a failure; then the value of the second register, or a failure.
    Seen: the late answer, which has another value.
    Why: after one slow moment of the device every answer would be that of the call before.
    """
    first, second = run.rng.sample(range(0x10000), 2)
    await modbus.device.poke(unit=1, table="holding_registers", address=40, values=[first, 0, second])
    await a_read_works(run, modbus)
    await modbus.device.fault(
        {"function": 3, "address": 40, "times": 1, "action": {"delay_s": _FIRST_LATE_S}},
        {"function": 3, "address": 42, "times": 1, "action": {"delay_s": _SECOND_LATE_S}},
    )
    reply = await _late(run, modbus, "read_holding", {"address": 40, "count": 1}, {"address": 42, "count": 1})
    await _not_the_late_one(run, modbus, reply, values=[second])
    await modbus.device.fault()
    await answers_again(run, modbus)


@TASKS.check("CON-002", "A late answer is not the answer to a later call.", needs="opcua.read")
async def a_late_variable_is_not_taken_for_another(run: Repetition, opcua: Rig) -> None:
    """Read a variable while the server stands still, until that times out; then another one, during which the answer to the first
    is sent.

    Said: a failure; then the value of the second variable, or a failure.
    Seen: the late answer, which has another value.
    Why: after one slow moment of the server every answer would be that of the call before.
    """
    first, second = (round(run.rng.uniform(-50.0, 150.0), 6) for _ in range(2))
    await opcua.device.poke(node="Temperature", value=first)
    await opcua.device.poke(node="Pressure", value=second)
    await a_read_works(run, opcua)
    one, other = "ns=2;s=Temperature", "ns=2;s=Pressure"
    await opcua.device.fault(
        {"service": "Read", "node": one, "times": 1, "action": {"delay_s": _FIRST_LATE_S}},
        {"service": "Read", "node": other, "times": 1, "action": {"delay_s": _SECOND_LATE_S}},
    )
    reply = await _late(run, opcua, "read", {"node": one}, {"node": other})
    await _not_the_late_one(run, opcua, reply, value=second)
    await opcua.device.fault()
    await answers_again(run, opcua)


# -- CON-004 ------------------------------------------------------------------------------------------------


@TASKS.check(
    "CON-004", "Reads beside writes give the old or a new value.", needs="modbus.read_holding modbus.write_holding"
)
async def registers_are_read_beside_writes(run: Repetition, modbus: Rig) -> None:
    """Write a cell by two calls and read it by four, all at the same time, several times; where there are tools for it, a number
    of 32 bits. Read such a number while both its registers change before every request. Write four registers by as many calls at the same
    time, and by every operation that writes.

    Said: success for the writes; for each read the old value or one of the new ones, never parts of two.
    Seen: each write once; the cell holds what was written last; each of the targets its own value.
    Why: half of an old number and half of a new one is a number that the plant never had.
    """
    wide = modbus.subject.claims("write_registers") and modbus.subject.claims("read_typed")
    await modbus.prove()
    for _ in range(_ROUNDS):
        values = run.rng.sample(range(1, 0x100000000 if wide else 0x10000), 3)
        old, *new = [[value >> 16, value & 0xFFFF] if wide else [value] for value in values]
        await modbus.device.poke(unit=1, table="holding_registers", address=20, values=old)
        if wide:
            writes = [modbus.call("write_registers", address=20, values=words) for words in new]
            reads = [modbus.call("read_typed", address=20, type="uint32") for _ in range(4)]
        else:
            writes = [modbus.call("write_holding", address=20, value=words[0]) for words in new]
            reads = [modbus.call("read_holding", address=20, count=1) for _ in range(4)]
        replies = await run.together(reads[0], writes[0], reads[1], reads[2], writes[1], reads[3])
        for reply in (replies[0], replies[2], replies[3], replies[5]):
            run.succeeds(reply, requirement="CON-004")
            if wide:
                run.one_of(reply, "value", *values)
            else:
                run.one_of(reply, "values", *([value] for value in values))
        written = [replies[1], replies[4]]
        for reply in written:
            run.succeeds(reply, requirement="CON-004")
        seen = [as_modbus(entry).get("values") for entry in _since(written, await modbus.journal())]
        run.witnessed(_linear(modbus, written, new, seen))
        if seen and all(reply.success for reply in written):
            run.witnessed(
                _kept(
                    modbus_oracle.image_holds(
                        await modbus.device.image(), "holding_registers", 20, list(seen[-1] or [])
                    )
                )
            )
    if modbus.subject.claims("read_typed"):
        await _a_moving_number_is_whole(run, modbus)
    every_write = exercise(modbus).every_write
    assert every_write is not None
    for _ in range(_ROUNDS):
        await _each_to_its_own(run, modbus, _in_a_row(run))
        await _each_to_its_own(run, modbus, every_write(run.rng))


async def _a_moving_number_is_whole(run: Repetition, modbus: Rig) -> None:
    start = run.rng.randrange(1, 0x1000)
    await modbus.device.poke(unit=1, table="holding_registers", address=22, values=[start, start])
    cells = [
        {"unit": 1, "table": "holding_registers", "address": address, "change": "increment"} for address in (22, 23)
    ]
    await modbus.device.poke(restless=cells)
    reply = await modbus.call("read_typed", address=22, type="uint32")
    await modbus.device.poke(restless=[])
    run.succeeds(reply, requirement="CON-004")
    value = reply.outputs.get("value")
    if isinstance(value, int) and value >> 16 != value & 0xFFFF:
        message = f"{reply.label}: both halves of the number change at the same time, the reply has {value >> 16} and {value & 0xFFFF}"
        run.judge(reply, [Finding(code="wrong_value", message=message, requirement="CON-004")])


def _in_a_row(run: Repetition) -> list[Asked]:
    """Return writes of neighbouring registers, each with a value of its own."""
    values = run.rng.sample(range(1, 0x10000), _NEIGHBOURS)
    return [
        Asked(
            operation="write_holding",
            inputs={"address": address, "value": value},
            points=registers_of("holding_registers", address, [value]),
        )
        for address, value in enumerate(values, start=40)
    ]


async def _each_to_its_own(run: Repetition, at: Rig, asked: Sequence[Asked]) -> None:
    """Write different targets by calls at the same time: each of them holds its own value afterwards."""
    apart: list[Asked] = []
    for one in asked:
        if at.subject.claims(one.operation) and all(one.points.keys().isdisjoint(other.points) for other in apart):
            apart.append(one)
    for poke in (poke for one in apart for poke in one.pokes):
        await at.device.poke(**poke)
    replies = await run.together(*(at.call(one.operation, **one.inputs) for one in apart))
    image = await at.device.image()
    for reply, one in zip(replies, apart, strict=True):
        if await _never_written(at, one, reply):
            continue
        # A device may refuse the second of several commands at the same time, and an adapter may say so.
        if reply.success is False:
            await fails_or_relays(run, at, reply, *_BUSY, requirement="CON-004")
        elif run.succeeds(reply, requirement="CON-004"):
            run.witnessed(_kept(witness(at).holds(image, one.points)))


async def _never_written(at: Rig, asked: Asked, reply: Reply) -> bool:
    """Tell whether the adapter refuses a write for what it is, also alone: that says nothing of calls at the same time."""
    if reply.error_code not in _NO_SUCH_WRITE:
        return False
    alone = await at.call(asked.operation, **asked.inputs)
    return alone.error_code == reply.error_code


def _since(replies: Sequence[Reply], entries: Entries) -> Entries:
    """Return the requests that write, since these calls were made."""
    begun = min(reply.exchange.sent_ns for reply in replies)
    return [entry for entry in state_changing(entries) if entry["t_ns"] >= begun]


def _linear(at: Rig, replies: Sequence[Reply], values: Sequence[object], seen: Sequence[object]) -> list[Finding]:
    """Expect that each write that succeeded was seen once, with its value."""
    findings = []
    for reply, value in zip(replies, values, strict=True):
        count = sum(same_json(value, found) for found in seen)
        if reply.success and count != 1:
            message = (
                f"{reply.label}: beside others the device should have seen this write once, it saw it {count} times"
            )
            findings.append(
                Finding(code="not_written_once", message=message, requirement="CON-004", evidence=f"it saw {seen}")
            )
    return findings


def _kept(findings: Sequence[Finding]) -> list[Finding]:
    return [Finding(code=finding.code, message=finding.message, requirement="CON-004") for finding in findings]


@TASKS.every_protocol(
    "CON-004", "Reads beside writes give the old or a new value.", writes=True, having="contended", prompt=True
)
async def values_are_read_beside_writes(run: Repetition, at: Rig) -> None:
    """Write a value by two calls and read it by four, all at the same time, several times. Write different targets at the same time, by
    every operation that writes.

    Said: success for the writes; for each read the old value or one of the new ones. Of a write that the other one has overtaken an
        adapter that reads back may also say `verify_failed`.
    Seen: each write once; the device holds what was written last; each of the targets its own value.
    Why: a lost write, or one that comes twice, shows only under load.
    """
    asks = exercise(at)
    assert asks.contended is not None
    assert asks.asks_for is not None
    needed = asks.contended(run.rng)
    if not all(at.subject.claims(asked.operation) for asked in (needed.read, *needed.writes)):
        run.not_applicable("the adapter has no operation that reads what it writes")
    await at.prove()
    for _ in range(_ROUNDS):
        one = asks.contended(run.rng)
        for poke in one.pokes:
            await at.device.poke(**poke)
        if one.first is not None:
            run.succeeds(await at.call(one.first.operation, **one.first.inputs), requirement="CON-004")
        writes = [at.call(write.operation, **write.inputs) for write in one.writes]
        reads = [at.call(one.read.operation, **one.read.inputs) for _ in range(4)]
        replies = await run.together(reads[0], writes[0], reads[1], reads[2], writes[1], reads[3])
        for reply in (replies[0], replies[2], replies[3], replies[5]):
            run.succeeds(reply, requirement="CON-004")
            run.one_of(reply, one.output, one.old, *one.new)
        written = [replies[1], replies[4]]
        journal = await at.journal()
        changes = protocols()[at.protocol].changes(_since(written, journal))
        seen = [asks.asks_for(entry) for entry in changes]
        for reply, value in zip(written, one.new, strict=True):
            if reply.success is False and reply.error_code in relayed(at, reply.during(journal)):
                # The device has refused it, which says nothing of calls at the same time.
                run.fails(reply, str(reply.error_code), requirement="CON-004")
            elif reply.success is False and seen and not same_json(value, seen[-1]):
                run.fails(reply, "verify_failed", outcome="applied", requirement="CON-004")
            else:
                run.succeeds(reply, requirement="CON-004")
        run.witnessed(_linear(at, written, one.new, seen))
        image = await at.device.image()
        for write, value in zip(one.writes, one.new, strict=True):
            if seen and same_json(value, seen[-1]):
                run.witnessed(_kept(witness(at).holds(image, write.points)))
    if asks.every_write is not None:
        for _ in range(_ROUNDS):
            await _each_to_its_own(run, at, asks.every_write(run.rng))


@TASKS.check("CON-004", "Messages beside each other are sent once each.", needs="mqtt.publish mqtt.subscribe")
async def messages_are_published_beside_each_other(run: Repetition, mqtt: Rig) -> None:
    """Publish on one topic by four calls while two others subscribe, all at the same time.

    Said: success.
    Seen: each message once.
    Why: a lost command, or one that comes twice, shows only under load.
    """
    asks = exercise(mqtt)
    await mqtt.prove()
    asked = [asks.write(run.rng) for _ in range(4)]
    reads = [asks.read(run.rng) for _ in range(2)]
    replies = await run.together(*(mqtt.call(one.operation, **one.inputs) for one in (*asked, *reads)))
    for reply in replies:
        run.succeeds(reply, requirement="CON-004")
    done = [(one, reply) for one, reply in zip(asked, replies, strict=False) if reply.success]
    entries = await mqtt.journal()
    if not all(asks.done(entries, one) for one, _ in done):
        await mqtt.watch(QUIET_S)
        entries = await mqtt.journal()
    for one, reply in done:
        run.witnessed(written_once(mqtt, one, reply, entries, requirement="CON-004"))


# -- CON-005, CON-006 ---------------------------------------------------------------------------------------


@TASKS.every_protocol("CON-005", "A call that waits holds up nothing else.", prompt=True)
async def a_call_that_waits_holds_up_nothing(run: Repetition, at: Rig) -> None:
    """Read while the device is silent; ask for the list of tools meanwhile; then cancel the call. Where the list came late, and only
    when the call had ended, do it once more.

    Said: the list within a second, or before the call ends.
    Seen: the read, which is not answered.
    Why: a device that stands still must not take the assistant's other devices, and the way to stop, away from it.
    """
    await a_read_works(run, at)
    await at.device.fault(*faulty(exercise(at).reads, **silence(at)))
    held_up_s = await _held_up_s(run, at)
    if held_up_s is not None:
        # What stood still for a moment is late once; what waits for the device is late every time.
        held_up_s = await _held_up_s(run, at)
    await at.device.fault()
    if held_up_s is not None:
        message = f"{at.protocol}: while a call waited for the device, tools/list took {held_up_s:.1f} s, until the call had ended"
        run.finding("held_up", message, "CON-005")
    await answers_again(run, at)


async def _held_up_s(run: Repetition, at: Rig) -> float | None:
    """Return the seconds after which the list of tools came while a call waited; None where that was soon, or before the call ended."""
    asked = exercise(at).read(run.rng)
    took_s = []

    async def listing() -> None:
        took_s.append(await at.session.listing_took_s())

    waiting = await at.call_and_cancel(
        asked.operation, seen={"request": True}, timeout_s=2.0, meanwhile=listing, **asked.inputs
    )
    # On a machine that stands still the list is late as well, but the call goes on waiting.
    late = took_s[0] > _HELD_UP_S * max(1.0, run.time_scale)
    return took_s[0] if late and not waiting.cancelled else None


@TASKS.every_protocol("CON-006", "Many calls work, over few connections.", prompt=True)
async def many_calls_need_few_connections(run: Repetition, at: Rig) -> None:
    """Read fifty times, in a soak a thousand times, one call after the other; then by 32 calls at the same time.

    Said: the right value in every answer; of the calls at the same time some may be refused.
    Seen: a request for each of them; never more than eight connections at the same time.
    Why: a controller has room for a few clients; a connection for each call locks out the operator.
    """
    made: list[tuple[Asked, Reply]] = []
    for _ in range(_CONSECUTIVE[run.soak]):
        made.append(await read(run, at))
        asked, reply = made[-1]
        run.succeeds(reply, requirement="CON-006", **asked.outputs)
    asked = made[-1][0]
    together = await run.together(*(at.call(asked.operation, **asked.inputs) for _ in range(32)))
    for reply in together:
        if reply.success is False:
            run.fails(reply, *_BUSY, requirement="CON-006")
        else:
            run.succeeds(reply, requirement="CON-006", **asked.outputs)
    entries = await at.journal()
    silent = [one for one in made if one[1].success and not any(map(_exchanged, one[1].during(entries)))]
    if silent:
        await at.watch(QUIET_S)
        entries = await at.journal()
    late = [reply for asked, reply in silent if _subscribed_after(at, asked, reply, entries)]
    if late:
        message = f"{late[0].label}: it claims success, and the device saw the request only after that"
        run.finding(
            "told_too_early", message, "MQT-002", evidence=protocols()[at.protocol].seen(since(late[0], entries))
        )
    if unasked := [reply for _, reply in silent if reply not in late]:
        message = f"{unasked[0].label}: the device should have been asked in each of {len(made)} calls, it was not in {len(unasked)}"
        run.finding(
            "no_exchange", message, "CON-006", evidence=protocols()[at.protocol].seen(unasked[0].during(entries))
        )
    run.witnessed(_connections(at, await at.session_journal()))


def _exchanged(entry: JournalEntry) -> bool:
    return entry["request"] or entry["kind"] in CYCLIC


def _subscribed_after(at: Rig, asked: Asked, reply: Reply, entries: Entries) -> bool:
    """Tell whether a call that was a success subscribed only after its answer."""
    return at.protocol == "mqtt" and not not_granted(since(reply, entries), asked.inputs.get("filter", ""))


def _connections(at: Rig, entries: Entries) -> list[Finding]:
    opened: set[int] = set()
    most = 0
    for entry in entries:
        if entry["origin"] == "client" and entry["kind"] == "CONNECTED":
            opened.add(entry["connection"])
            most = max(most, len(opened))
        elif entry["kind"] == "DISCONNECTED":
            opened.discard(entry["connection"])
    if most <= _MOST_CONNECTIONS:
        return []
    return [
        Finding(
            code="many_connections",
            message=f"{at.protocol}: the adapter should have at most {_MOST_CONNECTIONS} connections to the device at the same "
            f"time, it had {most}",
            requirement="CON-006",
        )
    ]
