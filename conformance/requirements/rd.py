"""RD: reads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.strict_json import same_json
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.modbus import oracle
from pytest_otmcp.protocols.modbus.entries import as_modbus
from pytest_otmcp.protocols.modbus.registers import registers
from pytest_otmcp.protocols.oracle import requests
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .opcua_values import as_said
from .provoked import expect_failure
from .steps import (
    CONNECTION_FAULTS,
    a_read_works,
    answered,
    exact_or_refused,
    exercise,
    faulty,
    knows_node,
    read,
    works_again,
)

__all__ = ["TASKS"]

TASKS = Checks()

HOLDING, INPUT, COILS, DISCRETE = "read_holding", "read_input", "read_coils", "read_discrete_inputs"
TABLES = {
    INPUT: ("input_registers", 4),
    HOLDING: ("holding_registers", 3),
    COILS: ("coils", 1),
    DISCRETE: ("discrete_inputs", 2),
}
"""Operations to the table that they read, and its function."""

UNITS = (1, 2, 17, 247, 255)
SIZE = 0x10000
MOST_REGISTERS, MOST_BITS = 125, 2000
REFUSED = ("limit_exceeded", "invalid_input", "illegal_address", "range_overflow")
"""Codes for a block that an adapter does not read."""


def _claimed(modbus: Rig) -> list[str]:
    return [operation for operation in TABLES if modbus.subject.claims(operation)]


def _nonces(run: Repetition, operation: str, count: int) -> list[Any]:
    if operation in (COILS, DISCRETE):
        return [run.rng.random() < 0.5 for _ in range(count)]
    return [run.rng.randrange(SIZE) for _ in range(count)]


async def _set(modbus: Rig, operation: str, address: int, values: Sequence[Any], unit: int = 1) -> None:
    await modbus.device.poke(unit=unit, table=TABLES[operation][0], address=address, values=list(values))


@TASKS.check("RD-001", "What is read is what the device holds, in every table.", needs="modbus.read_cells")
async def every_table_is_read_as_it_is(run: Repetition, modbus: Rig) -> None:
    """Read cells of each table that the adapter reads; they were set at random just before. Once more with other values, and once with values
    that are nearly the same.

    Said: these values, each time.
    Seen: the device holds them.
    Why: a value of a moment ago, or of a neighbour, looks right until somebody acts on it.
    """
    places = {INPUT: (10, 4), HOLDING: (20, 1), COILS: (20, 5), DISCRETE: (20, 5)}
    last: dict[str, list[Any]] = {}
    for nearly in (False, False, True):
        for operation in _claimed(modbus):
            address, count = places[operation]
            # What has changed by one is another value, also to who tells only what has changed by more.
            values = [type(value)(value ^ 1) for value in last[operation]] if nearly else _nonces(run, operation, count)
            last[operation] = values
            await _set(modbus, operation, address, values)
            reply = await modbus.call(operation, address=address, count=count)
            run.succeeds(reply, requirement="RD-001", values=values)


_CLOCK = 2258
"""Node id of Server_ServerStatus_CurrentTime; OPC 10000-6, annex A."""


@TASKS.check("RD-001", "What is read is what the server holds, whatever its type.", needs="opcua.read")
async def every_type_is_read_as_it_is(run: Repetition, opcua: Rig) -> None:
    """Read a variable of each type that has a form of its own in JSON; they were set at random just before. One of them has nearly the same
    value as before. Read a node that does not exist, whose number is that of the server's clock but for the bits above the sixteenth.

    Said: these values; for the missing node a failure.
    Seen: the server holds them.
    Why: a number that was read as another type is another number.
    """
    await a_read_works(run, opcua)
    expect_failure(run, await opcua.call("read", node=f"i={_CLOCK + (1 << 16)}"), requirement="RD-001")
    await opcua.device.poke(nodes="types")
    if not await knows_node(run, opcua, "ns=2;s=Boolean"):
        return
    for node, value in _values(run):
        await opcua.device.poke(node=node, value=value)
        reply = await opcua.call("read", node=f"ns=2;s={node}")
        run.succeeds(reply, requirement="RD-001", value=as_said(node, value, reply))


@TASKS.every_protocol("RD-001", "What is read is what the device holds, whatever its type.", having="every_read")
async def every_value_is_read_as_it_is(run: Repetition, at: Rig) -> None:
    """Read by every operation that reads values, and a value of each type; they were set at random just before.

    Said: these values; a type that the adapter does not offer fails with `unsupported_operation` or `invalid_input`.
    Seen: the device holds them.
    Why: a number that was read as another type is another number.
    """
    every = exercise(at).every_read
    assert every is not None
    await a_read_works(run, at)
    for asked in every(run.rng):
        if at.subject.claims(asked.operation):
            for poke in asked.pokes:
                await at.device.poke(**poke)
            reply = await at.call(asked.operation, **asked.inputs)
            exact_or_refused(
                run, reply, "unsupported_operation", "invalid_input", requirement="RD-001", **asked.outputs
            )


def _values(run: Repetition) -> Iterator[tuple[str, object]]:
    yield "Boolean", False
    yield "Boolean", True
    for node, bits in (("Byte", 8), ("UInt16", 16), ("UInt32", 32)):
        # Read as a number with a sign, it would be another one.
        yield node, run.rng.randrange(2 ** (bits - 1), 2**bits)
    for node, bits in (("SByte", 8), ("Int16", 16), ("Int32", 32), ("Int64", 50)):
        yield node, -run.rng.randrange(1, 2 ** (bits - 1))
    number = run.rng.uniform(-1e9, 1e9)
    yield "Double", number
    # It is another value, also to who tells only what has changed by more.
    yield "Double", number * (1 + 1e-6)
    yield "String", f"text-{run.rng.getrandbits(32):08x}"
    yield "LocalizedText", f"text-{run.rng.getrandbits(32):08x}"


@TASKS.check("RD-002", "The tables are told apart.", needs="modbus.read_cells")
async def the_tables_are_told_apart(run: Repetition, modbus: Rig) -> None:
    """Read the same address in each table that the adapter reads, while it holds something else in each; then with each of
    them changed.

    Said: the values of the table that was asked for.
    Seen: reads by the function of this table.
    Why: register 1 as a command and as a measurement are two things with one number.
    """
    for turned in (False, True):
        words = iter(run.rng.sample(range(SIZE), 2))
        held = {COILS: not turned, DISCRETE: turned, HOLDING: next(words), INPUT: next(words)}
        for operation, value in held.items():
            await _set(modbus, operation, 1, [value])
        for operation in _claimed(modbus):
            reply = await modbus.call(operation, address=1, count=1)
            if run.succeeds(reply, requirement="RD-002", values=[held[operation]]):
                seen = reply.during(await modbus.journal())
                run.witnessed(
                    oracle.read_from_device(seen, function=TABLES[operation][1], address=1, count=1),
                )


@TASKS.check(
    "RD-003",
    "The unit that was asked for is the unit that answers.",
    needs="modbus.read_holding modbus.read_holding.unit",
)
async def units_are_told_apart(run: Repetition, modbus: Rig) -> None:
    """Read the same register of several units, each of which holds another value; then one whose answer says that it is another
    unit's.

    Said: the value of each unit; for the last a failure, or the value where the adapter asked again.
    Seen: for each call a read of this unit.
    Why: behind a gateway the units are other machines.
    """
    await modbus.device.poke(units=list(UNITS))
    values = dict(zip(UNITS, run.rng.sample(range(SIZE), len(UNITS)), strict=True))
    for unit, value in values.items():
        await _set(modbus, HOLDING, 20, [value], unit)
    for unit in run.rng.sample(UNITS, len(UNITS)):
        reply = await modbus.call("read_holding", address=20, count=1, unit=unit)
        if exact_or_refused(run, reply, "invalid_input", requirement="RD-003", values=[values[unit]]):
            run.witnessed(oracle.asked_of_unit(reply.during(await modbus.journal()), unit))
    await _is_no_data(run, modbus, "of another unit", {"answer_unit": 17}, requirement="RD-003")


_SEGMENTS_S = 0.0005
"""Seconds between the segments of an answer that is complete long before any deadline."""
_SEGMENT_BYTES = 8
"""Length of a segment: the length of a frame is in the first one, which a library may take for granted (pycomm3 1.2.16 does)."""


@TASKS.every_protocol("RD-004", "What is read is fresh, and nothing is read while the device is away.")
async def what_is_read_is_fresh(run: Repetition, at: Rig) -> None:
    """Read a value that was set just before, four times in a row, each time another one; the last answer comes in segments of 8 bytes. Read
    while the device is away; then again.

    Said: each value; failures with `connect_failed`, `connection_lost` or `timeout` as long as the device is away; success again.
    Seen: the device answers during each call that succeeds.
    Why: a value from memory is the plant of a moment ago; when the plant is gone, it is of nothing. TCP may end a
        segment anywhere: an adapter that takes the first one for the whole answer fails where the network is slow.
    """
    for in_segments in (False, False, False, True):
        if in_segments and protocols()[at.protocol].has_connections:
            await at.device.fault(*faulty(exercise(at).reads, drip_s=_SEGMENTS_S, drip_bytes=_SEGMENT_BYTES))
        asked, reply = await read(run, at)
        if run.succeeds(reply, requirement="RD-001" if in_segments else "RD-004", **asked.outputs):
            run.witnessed(answered(at, reply.during(await at.journal()), requirement="RD-004"))
    await at.device.fault()
    if not (at.subject.claims("recovery") and at.subject.reconnects):
        return
    asked = exercise(at).read(run.rng)
    await at.stop_device()
    first = await at.call_until_failure(asked.operation, window_s=1.0, **asked.inputs)
    again = [await at.call(asked.operation, **asked.inputs) for _ in range(2)]
    for reply in (first, *again):
        run.fails(reply, *CONNECTION_FAULTS, requirement="RD-004", code_requirement="REC-002")
    await at.start_device()
    for poke in asked.pokes:
        await at.device.poke(**poke)
    replies = await at.call_until_success(asked.operation, window_s=at.subject.recovery_s, **asked.inputs)
    run.succeeds(replies[-1], requirement="REC-001")


_FALSE_HEADERS: Mapping[str, Mapping[str, object]] = {
    "with the transaction identifier 0": {"answer_transaction": 0},
    "with the next transaction identifier": {"transaction_id": 1},
    "with the protocol identifier 1": {"protocol_id": 1},
    "of function 4": {"answer_function": 4},
    "that counts two bytes more than it has": {"byte_count": 2},
    "whose length leaves out its last two bytes": {"length": -2},
    "whose length counts two bytes more than come": {"length": 2},
}


_FALSE_BITS: Mapping[str, Mapping[str, object]] = {
    "with the next transaction identifier": {"transaction_id": 1},
    "of function 2": {"answer_function": 2},
    "that has a byte less than was asked for": {},
}


@TASKS.check("RD-005", "An answer that does not fit its request is no data.", needs="modbus.read_holding")
async def false_answers_are_no_data(run: Repetition, modbus: Rig) -> None:
    """Read a register while the device answers with a false value and something that shows that it is no answer to the request:
    another transaction, protocol, function, byte count or length; then four registers of which it sends two, or six; and nine coils in the
    same way. After each a read works.

    Said: failures with `protocol_error`, `connect_failed`, `connection_lost` or `timeout`; or what the device holds where the
        adapter asked again. An adapter that tells exactly the values that came, too few or too many, gets a warning.
    Seen: the register holds another value than the false answer says.
    Why: the answer to another request is a wrong value that looks right.
    """
    await a_read_works(run, modbus)
    for what, action in _FALSE_HEADERS.items():
        await _is_no_data(run, modbus, what, action, requirement="RD-005")
    for count in (2, 6):
        await _wrong_number(run, modbus, count)
    if modbus.can_ask(COILS, {"address": 30, "count": 9}) and await _reads_nine(run, modbus):
        for what, action in _FALSE_BITS.items():
            await _is_no_bit(run, modbus, what, action)


async def _reads_nine(run: Repetition, modbus: Rig) -> bool:
    held = _nonces(run, COILS, 9)
    await _set(modbus, COILS, 30, held)
    reply = await modbus.call(COILS, address=30, count=9)
    # An adapter may have a list of its coils, or read fewer at once.
    return exact_or_refused(
        run, reply, "limit_exceeded", "invalid_input", "illegal_address", requirement="RD-001", values=held
    )


async def _is_no_data(
    run: Repetition, modbus: Rig, what: str, action: Mapping[str, object], *, requirement: str
) -> None:
    held, false = run.rng.sample(range(1, SIZE), 2)
    await _set(modbus, HOLDING, 40, [held])
    await modbus.device.fault({"function": 3, "times": 1, "action": {**action, "answer_values": [false]}})
    reply = await modbus.call("read_holding", address=40, count=1)
    await modbus.device.fault()
    if not reply.success:
        _refuses(run, reply, requirement)
    elif same_json(reply.outputs.get("values"), [false]):
        run.judge(reply, [_taken(reply, f"an answer {what} says {false}", requirement)])
    else:
        run.succeeds(reply, requirement=requirement, values=[held])
    await works_again(run, modbus, "read_holding", address=40, count=1)


async def _is_no_bit(run: Repetition, modbus: Rig, what: str, action: Mapping[str, object]) -> None:
    """Read nine coils while the device answers with others, and something that shows that it is no answer to the request."""
    held = _nonces(run, COILS, 9)
    false = [not bit for bit in held]
    await _set(modbus, COILS, 30, held)
    sent = false if action else false[:8]
    rule = {**action, "answer_values": [int(bit) for bit in sent]}
    await modbus.device.fault({"function": 1, "times": 1, "action": rule})
    reply = await modbus.call(COILS, address=30, count=9)
    await modbus.device.fault()
    told = reply.outputs.get("values")
    if not reply.success:
        _refuses(run, reply, "RD-005")
    elif same_json(told, sent):
        run.judge(reply, [_taken(reply, f"an answer {what} says {sent}", "RD-005", warning=not action)])
    else:
        run.succeeds(reply, requirement="RD-005", values=held)
    await works_again(run, modbus, COILS, address=30, count=9)


def _refuses(run: Repetition, reply: Reply, requirement: str) -> None:
    run.fails(reply, "protocol_error", *CONNECTION_FAULTS, requirement=requirement, code_requirement="ERR-002")


def _taken(reply: Reply, came: str, requirement: str, *, warning: bool = False) -> Finding:
    return Finding(
        code="not_refused",
        message=f"{reply.label}: {came}, and the reply says {reply.outputs.get('values')!r} and claims success",
        requirement=requirement,
        strength="SHOULD" if warning else "MUST",
    )


async def _wrong_number(run: Repetition, modbus: Rig, count: int) -> None:
    """Read four registers while the device sends another number of them."""
    block: dict[str, Any] = {"address": 40, "count": 4}
    if not modbus.can_ask("read_holding", block):
        return
    held, false = _nonces(run, HOLDING, 4), _nonces(run, HOLDING, count)
    await _set(modbus, HOLDING, 40, held)
    await modbus.device.fault({"function": 3, "action": {"answer_values": false}})
    reply = await modbus.call("read_holding", **block)
    await modbus.device.fault()
    if not reply.success:
        _refuses(run, reply, "RD-005")
    elif not _fitted(reply.during(await modbus.journal())):
        told = reply.outputs.get("values")
        came = f"of four registers the device sent {false}"
        run.judge(reply, [_taken(reply, came, "RD-005", warning=same_json(told, false))])
    await works_again(run, modbus, "read_holding", address=40, count=1)


def _fitted(entries: Entries) -> bool:
    """Tell whether each read was answered with as many values as it asked for, which may be so when it is made in parts."""
    asked = {entry["seq"]: as_modbus(entry).get("quantity") for entry in requests(entries)}
    return all(
        len(as_modbus(entry).get("values", [])) == asked[entry["answers"]]
        for entry in entries
        if entry["answers"] in asked
    )


@TASKS.check("RD-006", "A read of bits gives as many values as were asked for.", needs="modbus.read_coils")
async def bits_are_counted_and_in_order(run: Repetition, modbus: Rig) -> None:
    """Read 1, 7, 8, 9, 13 and 2000 bits, of which one is different from all others; then the same number at random.

    Said: so many values, the different one at its place. 2000 may be more than the adapter reads at once: then a failure with
        `limit_exceeded`, `invalid_input` or `illegal_address`.
    Seen: the device holds these bits, and others beside them.
    Why: the bits that fill up the last byte are no switches of the plant.
    """
    await modbus.device.poke(unit=1, cells=2 * MOST_BITS)
    for operation in (COILS, DISCRETE):
        for count in (1, 7, 8, 9, 13, MOST_BITS):
            place, single = run.rng.randrange(count), run.rng.random() < 0.5
            for bits in ([single ^ (index != place) for index in range(count)], _nonces(run, operation, count)):
                if not modbus.subject.claims(operation):
                    continue
                if modbus.excess(operation, address=30, count=count) is not None:
                    continue
                # Neighbours that are all different from the last bit: one that is given too many shows.
                address = 30
                await _set(modbus, operation, address, [*bits, *([not bits[-1]] * 16)])
                reply = await modbus.call(operation, address=address, count=count)
                if count < MOST_BITS:
                    run.succeeds(reply, requirement="RD-006", values=bits)
                else:
                    exact_or_refused(run, reply, *REFUSED, requirement="RD-006", values=bits)


_TIMES = {False: 2, True: 16}
"""How many times as much as one request can ask for is read, in the short and in the long form."""


@TASKS.check(
    "RD-007",
    "No read goes beyond what one request can ask for, or beyond the last address.",
    needs="modbus.read_holding",
)
async def reads_keep_to_their_limits(run: Repetition, modbus: Rig) -> None:
    """Read 125, these again, 126, 250, in a soak 2000, and a million registers, none, less than none, two from 65534 and from 65535 on, 2000 and 2001 bits, and
    numbers of several registers that change all the time.

    Said: what the device holds, or a failure with `limit_exceeded`, `invalid_input`, `illegal_address` or the code of the exception by which
        the device refused it; always a failure where there are no such cells. What was read by several requests has `meta.atomic` false.
    Seen: each read asks for 1 to 125 registers, or 1 to 2000 bits; a number of several registers is read by one request.
    Why: a device refuses what is beyond the limits, or does something of its own; half of a number from before and half from after a change
        is a number that never was.
    """
    await modbus.device.poke(unit=1, cells=SIZE)
    await _one_register(run, modbus)
    for operation, most in (
        (HOLDING, MOST_REGISTERS),
        (INPUT, MOST_REGISTERS),
        (COILS, MOST_BITS),
        (DISCRETE, MOST_BITS),
    ):
        if modbus.subject.claims(operation):
            # The longest block twice: the second time each of its values is another one.
            for count in (most, most, most + 1, _TIMES[run.soak] * most):
                await _limit(run, modbus, operation, 100, count)
            await _limit(run, modbus, operation, SIZE - 2, 2)
            for address, count in ((0, 0), (0, -1), (0, 1_000_000), (SIZE - 1, 2)):
                reply = await modbus.call(operation, address=address, count=count)
                seen = reply.during(await modbus.journal())
                codes = (*REFUSED, *oracle.codes_of_refusals(seen))
                run.fails(reply, *codes, requirement="RD-007", code_requirement="ERR-002")
                run.witnessed(oracle.within_limits(seen))
    await _numbers_are_whole(run, modbus)
    await _one_register(run, modbus)


async def _one_register(run: Repetition, modbus: Rig) -> None:
    [value] = _nonces(run, HOLDING, 1)
    await _set(modbus, HOLDING, 20, [value])
    run.succeeds(await modbus.call("read_holding", address=20, count=1), requirement="RD-007", values=[value])


async def _limit(run: Repetition, modbus: Rig, operation: str, address: int, count: int) -> None:
    block: dict[str, Any] = {"address": address, "count": count}
    if not modbus.can_ask(operation, block):
        return
    values = _nonces(run, operation, count)
    await _set(modbus, operation, address, values)
    reply = await modbus.call(operation, **block)
    seen = reply.during(await modbus.journal())
    codes = (*REFUSED, *oracle.codes_of_refusals(seen))
    read = exact_or_refused(run, reply, *codes, requirement="RD-007", values=values)
    run.witnessed(oracle.within_limits(seen))
    stated = reply.member("meta", "atomic") if reply.native else False
    whole = oracle.in_one_request(seen, function=TABLES[operation][1], address=address, count=count)
    if read and not whole and stated is not False:
        message = f"{reply.label}: several requests read it, so meta.atomic should be false, it is {stated!r}"
        run.judge(reply, [oracle.torn(message)])


async def _numbers_are_whole(run: Repetition, modbus: Rig) -> None:
    for operation, function in (("read_typed", 3), ("read_typed_input", 4)):
        for kind in ("float32", "float64"):
            if not modbus.subject.claims(operation):
                continue
            value = run.rng.uniform(1.0, 2.0)
            words = registers(value, kind)
            await modbus.device.poke(
                unit=1, table="holding_registers" if function == 3 else "input_registers", address=60, values=words
            )
            reply = await modbus.call(operation, address=60, type=kind)
            if run.succeeds(reply, requirement="RD-007") and not oracle.in_one_request(
                reply.during(await modbus.journal()), function=function, address=60, count=len(words)
            ):
                message = f"{reply.label}: the {len(words)} registers of one number should be read by one request"
                run.judge(reply, [oracle.torn(message)])
            beyond = await modbus.call(operation, address=SIZE - 1, type=kind)
            run.fails(beyond, *REFUSED, requirement="RD-007", code_requirement="ERR-002")
