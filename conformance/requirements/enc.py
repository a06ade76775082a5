"""ENC: values in registers, nodes and payloads."""

from __future__ import annotations

import base64
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.strict_json import same_json
from pytest_otmcp.protocols.exercise import Asked, Texts
from pytest_otmcp.protocols.modbus import oracle as modbus_oracle
from pytest_otmcp.protocols.modbus.registers import FORMATS, ORDERS, WIDE, registers, same_bits, unpacked
from pytest_otmcp.protocols.modbus.tags import TAGS
from pytest_otmcp.protocols.mqtt.inbox import decoded, listed
from pytest_otmcp.protocols.opcua import oracle as opcua_oracle
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..tasks.messages import publish_from_kit, subscribe, sync_point
from .opcua_values import as_said
from .sparkplug_payload import DOUBLE, INT64, UINT64, payload_of
from .steps import (
    NOTHING_SENT,
    a_read_works,
    a_write_works,
    citing,
    exact_or_refused,
    exercise,
    knows_node,
    most_characters,
    nothing_arrived,
    read,
    witness,
)

__all__ = ["TASKS"]

TASKS = Checks()

_NOT_OFFERED = ("unsupported_operation", "invalid_input")
_NOT_THERE = (*_NOT_OFFERED, "illegal_address")
"""Codes where a value of a rare type also has an address that an adapter need not know, or reads more of than there is."""
_NOT_WRITTEN = ("range_overflow", "invalid_input", "type_mismatch")
_EXACT = 2**53 - 1
_ORDINARY = 1.5
"""A number that every type of floating-point numbers holds exactly."""
_SPECIAL = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
_AT = 60
"""First register of the numbers."""


def _wrong(reply: Reply, wanted: object, requirement: str, *, name: str = "value", warning: bool = False) -> Finding:
    found = reply.outputs.get(name)
    return Finding(
        code="wrong_value",
        message=f"{reply.label}: {name} should be {wanted!r}, the reply says {found!r}",
        requirement=requirement,
        strength="SHOULD" if warning else "MUST",
    )


async def _hold(modbus: Rig, operation: str, words: list[int]) -> None:
    table = "input_registers" if operation == "read_typed_input" else "holding_registers"
    await modbus.device.poke(unit=1, table=table, address=_AT, values=words)


# -- ENC-001 ----------------------------------------------------------------------------------------------------------


@TASKS.check("ENC-001", "Numbers are read in the byte order that was asked for.", needs="modbus.read_typed")
async def byte_orders_are_kept(run: Repetition, modbus: Rig) -> None:
    """Read numbers of each type in each byte order, from registers that the kit has computed: bytes that are all different, bounds, -1, pi, and
    values at random. Write a tag whose registers are swapped, and read it.

    Said: the number; an order or a type that the adapter does not offer fails with `unsupported_operation` or `invalid_input`. That an end of
        a type of whole numbers is no value, as some devices have it, is a warning.
    Seen: the tag's registers are those of its order.
    Why: with swapped registers 1.0 is a number that looks like a measurement.
    """
    for operation in ("read_typed", "read_typed_input"):
        orders = (
            ORDERS
            if modbus.subject.claims(operation) and modbus.subject.accepts_input(operation, "byte_order")
            else ORDERS[:1]
        )
        for kind in FORMATS:
            values = list(_numbers(run, kind))
            if not modbus.subject.claims(operation):
                continue
            for order in orders if kind in WIDE else ORDERS[:1]:
                for value in values:
                    await _hold(modbus, operation, registers(value, kind, order))
                    asked: dict[str, Any] = {"byte_order": order} if len(orders) > 1 else {}
                    reply = await modbus.call(operation, address=_AT, type=kind, **asked)
                    if exact_or_refused(run, reply, *_NOT_OFFERED, requirement="ENC-001") and not _is_number(
                        reply.outputs.get("value"), value, kind
                    ):
                        told = reply.outputs.get("value")
                        run.judge(reply, [_wrong(reply, value, "ENC-001", warning=_says_no_value(told, value, kind))])
    if modbus.subject.claims("write_tag"):
        await _swapped_tag(run, modbus)


def _numbers(run: Repetition, kind: str) -> Iterator[float]:
    size = struct.calcsize(FORMATS[kind])
    if kind.startswith("float"):
        # Of the bits of pi each byte is another one, also in four bytes.
        yield unpacked(struct.pack(FORMATS[kind], math.pi), kind)
        yield -2.0
        yield unpacked(struct.pack(FORMATS[kind], run.rng.uniform(-1e6, 1e6)), kind)
        return
    yield unpacked(bytes(range(1, size + 1)), kind)
    lowest, highest = unpacked(b"\x80" + bytes(size - 1), kind), unpacked(b"\x7f" + b"\xff" * (size - 1), kind)
    yield from (lowest, unpacked(b"\xff" * size, kind), highest)
    yield unpacked(run.rng.getrandbits(8 * size).to_bytes(size, "big"), kind)


def _is_number(found: object, wanted: float, kind: str) -> bool:
    """Tell whether an answer has this number; whole numbers may be decimal strings."""
    if kind.startswith("float"):
        return same_bits(found, wanted, kind)
    return found == str(wanted) or (not isinstance(found, bool) and same_json(found, wanted))


def _says_no_value(told: object, value: float, kind: str) -> bool:
    """Tell whether an answer has no number at all where the registers hold an end of a type, which to some devices is no value."""
    bits = 8 * struct.calcsize(FORMATS[kind])
    ends = {"int": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1), "uint": (2**bits - 1,)}.get(kind.rstrip("0123456789"), ())
    return value in ends and (told is None or (isinstance(told, str) and not any(map(str.isdigit, told))))


async def _swapped_tag(run: Repetition, modbus: Rig) -> None:
    tag = TAGS["otmcp_swapped"]
    value = run.rng.randrange(-(2**31), 2**31)
    written = await modbus.call("write_tag", name="otmcp_swapped", value=value)
    if run.succeeds(written, requirement="ENC-001"):
        image = await modbus.device.image()
        run.witnessed(_in_registers(image, tag.address, registers(value, tag.type, tag.order), "ENC-001"))
    if modbus.subject.claims("read_tag"):
        value = run.rng.randrange(-(2**31), 2**31)
        await modbus.device.poke(
            unit=1, table=tag.table, address=tag.address, values=registers(value, tag.type, tag.order)
        )
        run.succeeds(await modbus.call("read_tag", name="otmcp_swapped"), requirement="ENC-001", value=value)


def _in_registers(image: Any, address: int, words: list[int], requirement: str) -> list[Finding]:
    held = [modbus_oracle.held(image, "holding_registers", address + index) for index in range(len(words))]
    if held == words:
        return []
    message = f"the registers from {address} on should hold {words}, they hold {held}"
    return [Finding(code="device_differs", message=message, requirement=requirement)]


# -- ENC-003 ----------------------------------------------------------------------------------------------------------


def _patterns(run: Repetition, kind: str) -> Iterator[float]:
    """Yield finite numbers: the hard ones, and bits at random."""
    size = struct.calcsize(FORMATS[kind])
    smallest = (1).to_bytes(size, "big")
    largest = bytes.fromhex("7f7fffff" if kind == "float32" else "7fefffffffffffff")
    for data in (bytes([0x80, *bytes(size - 1)]), smallest, largest):
        yield unpacked(data, kind)
    yield unpacked(struct.pack(FORMATS[kind], 0.1), kind)
    count = 0
    while count < 25:
        value = unpacked(run.rng.getrandbits(8 * size).to_bytes(size, "big"), kind)
        if math.isfinite(value):
            count += 1
            yield value


def _judge_bits(run: Repetition, reply: Reply, value: float, kind: str) -> None:
    found = reply.outputs.get("value")
    if not same_bits(found, value, kind):
        # JSON libraries of several languages have no negative zero; it equals zero.
        run.judge(reply, [_wrong(reply, value, "ENC-003", warning=value == 0.0 and found == 0.0)])


@TASKS.check("ENC-003", "Floating-point numbers keep their bits.", needs="modbus.read_typed")
async def floats_in_registers_keep_their_bits(run: Repetition, modbus: Rig) -> None:
    """Read numbers of 32 and 64 bits whose bits are random, the smallest and the largest, and -0; write some to a tag.

    Said: numbers that have the same bits when they are put into the type again. 0 for -0 is a warning.
    Seen: the tag's registers have the bits of the number that was written.
    Why: a rounded value hides a drift, and never reaches a limit that it stands at.
    """
    for kind in ("float32", "float64"):
        for value in _patterns(run, kind):
            await _hold(modbus, "read_typed", registers(value, kind))
            reply = await modbus.call("read_typed", address=_AT, type=kind)
            if exact_or_refused(run, reply, *_NOT_OFFERED, requirement="ENC-003"):
                _judge_bits(run, reply, value, kind)
    if modbus.subject.claims("write_tag"):
        tag = TAGS["otmcp_float"]
        for value in list(_patterns(run, "float32"))[1:9]:
            written = await modbus.call("write_tag", name="otmcp_float", value=value)
            if run.succeeds(written, requirement="ENC-003"):
                run.witnessed(
                    _in_registers(await modbus.device.image(), tag.address, registers(value, tag.type), "ENC-003")
                )


@TASKS.check("ENC-003", "Floating-point numbers keep their bits.", needs="opcua.read")
async def floats_in_nodes_keep_their_bits(run: Repetition, opcua: Rig) -> None:
    """Read numbers of the types Float and Double whose bits are random, the smallest and the largest, and -0; write some.

    Said: numbers that have the same bits when they are put into the type again. 0 for -0 is a warning.
    Seen: the node holds the number that was written.
    Why: a rounded value hides a drift, and never reaches a limit that it stands at.
    """
    await opcua.device.poke(nodes="types")
    if not await knows_node(run, opcua, "ns=2;s=Boolean"):
        return
    for name, kind in (("Float", "float32"), ("Double", "float64")):
        node = f"ns=2;s={name}"
        values = list(_patterns(run, kind))
        for value in values:
            await opcua.device.poke(node=name, value="-0.0" if same_bits(value, -0.0, kind) else value)
            reply = await opcua.call("read", node=node)
            if run.succeeds(reply, requirement="ENC-003"):
                _judge_bits(run, reply, value, kind)
        for value in values[1:6]:
            if opcua.subject.claims("write"):
                written = await opcua.call("write", node=node, value=value)
                if run.succeeds(written, requirement="ENC-003"):
                    held = opcua_oracle.held(await opcua.device.image(), node)
                    if not same_bits(held, value, kind):
                        message = f"{node} should hold {value!r}, it holds {held!r}"
                        finding = Finding(code="device_differs", message=message, requirement="ENC-003")
                        run.judge(written, [finding])


@TASKS.every_protocol("ENC-003", "Floating-point numbers keep their bits.", having="floats", prompt=True)
async def floats_keep_their_bits(run: Repetition, at: Rig) -> None:
    """Read numbers of 32 and 64 bits whose bits are random, the smallest and the largest, and -0; write some of 32 bits.

    Said: numbers that have the same bits when they are put into the type again. 0 for -0 is a warning. A type that the adapter does not
        offer fails with `unsupported_operation` or `invalid_input`, or `illegal_address`.
    Seen: the device holds the number that was written.
    Why: a rounded value hides a drift, and never reaches a limit that it stands at.
    """
    asks = exercise(at)
    readers = {
        kind: read_of for kind, read_of in asks.floats.items() if at.subject.claims(read_of(_ORDINARY).operation)
    }
    if not readers:
        run.not_applicable("the adapter has no operation that reads such a number")
    await a_read_works(run, at)
    for kind, read_of in readers.items():
        ordinary = await _asked(at, read_of(_ORDINARY))
        if exact_or_refused(run, ordinary, *_NOT_THERE, requirement="ENC-003", value=_ORDINARY):
            for value in _patterns(run, kind):
                reply = await _asked(at, read_of(value))
                if run.succeeds(reply, requirement="ENC-003"):
                    _judge_bits(run, reply, value, kind)
    assert asks.real is not None
    if not at.subject.claims(asks.real(_ORDINARY).operation):
        return
    await a_write_works(run, at)
    for value in (_ORDINARY, *list(_patterns(run, "float32"))[1:6]):
        written = await _asked(at, asks.real(value))
        if not exact_or_refused(run, written, *_NOT_THERE * (value == _ORDINARY), requirement="ENC-003"):
            return
        run.witnessed(citing("ENC-003", witness(at).holds(await at.device.image(), asks.real(value).points)))


# -- ENC-004 ----------------------------------------------------------------------------------------------------------


def _judge_special(run: Repetition, at: Rig, reply: Reply, name: str) -> None:
    """Expect success with null and the number's name beside it; an adapter without an output for the name must not make it another number."""
    if not run.succeeds(reply, requirement="ENC-004"):
        return
    found = reply.outputs.get("value")
    if at.subject.claims(f"{reply.operation}.special"):
        if found is not None:
            run.judge(reply, [_wrong(reply, None, "ENC-004")])
        elif reply.outputs.get("special") != name:
            run.judge(reply, [_wrong(reply, name, "ENC-004", name="special")])
    elif isinstance(found, bool | int | float):
        run.judge(reply, [_wrong(reply, name, "ENC-004")])


@TASKS.check("ENC-004", "What is no number, or infinite, is told by its name.", needs="modbus.read_typed")
async def special_numbers_in_registers(run: Repetition, modbus: Rig) -> None:
    """Read registers that hold NaN, infinity and minus infinity, of 32 and 64 bits; read a number before and after them. Write a text "NaN" and a
    number that is too large to a tag of 32 bits.

    Said: success, null, and the name beside it; the number. A type that the adapter does not offer fails with `unsupported_operation` or
        `invalid_input`. The writes fail with `range_overflow`, `invalid_input` or `type_mismatch`.
    Seen: no request that changes the plant.
    Why: a sensor that has failed says NaN; told as 0 it is a plant that is cold.
    """
    for kind in ("float32", "float64"):
        if not await _reads_ordinary(run, modbus, kind):
            continue
        for name, value in _SPECIAL.items():
            await _hold(modbus, "read_typed", registers(value, kind))
            _judge_special(run, modbus, await modbus.call("read_typed", address=_AT, type=kind), name)
        await _reads_ordinary(run, modbus, kind)
    if modbus.subject.claims("write_tag"):
        for beyond in ("NaN", "Infinity", 1e39):
            reply = await modbus.call("write_tag", name="otmcp_float", value=beyond)
            run.fails(reply, *_NOT_WRITTEN, outcome=NOTHING_SENT, requirement="ENC-004")
            run.witnessed(nothing_arrived(modbus, reply.during(await modbus.journal()), requirement="ENC-004"))


async def _reads_ordinary(run: Repetition, modbus: Rig, kind: str) -> bool:
    """Expect an ordinary number of this type, and return whether the adapter offers the type."""
    await _hold(modbus, "read_typed", registers(_ORDINARY, kind))
    reply = await modbus.call("read_typed", address=_AT, type=kind)
    return exact_or_refused(run, reply, *_NOT_OFFERED, requirement="ENC-004", value=_ORDINARY)


@TASKS.check("ENC-004", "What is no number, or infinite, is told by its name.", needs="opcua.read")
async def special_numbers_in_nodes(run: Repetition, opcua: Rig) -> None:
    """Read a number of the types Float and Double, then nodes of these types that hold NaN, infinity and minus infinity; then a number. Write
    texts with these names.

    Said: success; null, and the name beside it; then a number. A type that the adapter does not offer fails with `unsupported_operation` or
        `invalid_input`, or `illegal_address`. The writes fail with `range_overflow`, `invalid_input` or `type_mismatch`.
    Seen: the node holds what it held.
    Why: a sensor that has failed says NaN; told as 0 it is a plant that is cold.
    """
    await opcua.device.poke(nodes=["types", "special"])
    if not await knows_node(run, opcua, "ns=2;s=Boolean"):
        return
    for kind in ("Float", "Double"):
        ordinary = await opcua.call("read", node=f"ns=2;s={kind}")
        if not exact_or_refused(run, ordinary, *_NOT_THERE, requirement="ENC-004"):
            continue
        for name in _SPECIAL:
            reply = await opcua.call("read", node=f"ns=2;s={kind}.{name.replace('-', 'Minus')}")
            _judge_special(run, opcua, reply, name)
        if not opcua.subject.claims("write"):
            continue
        before = opcua_oracle.held(await opcua.device.image(), f"ns=2;s={kind}")
        for text in ("NaN", "nan", "Infinity"):
            reply = await opcua.call("write", node=f"ns=2;s={kind}", value=text)
            # A server that refuses the number says that it is out of range, which is no illegal value of the adapter's own.
            codes = (*_NOT_WRITTEN, "illegal_value")
            run.fails(reply, *codes, outcome=(*NOTHING_SENT, "rejected"), requirement="ENC-004")
        run.witnessed(opcua_oracle.image_holds(await opcua.device.image(), f"ns=2;s={kind}", before))
    await a_read_works(run, opcua)


def _metric(reply: Reply, name: str) -> Mapping[str, Any]:
    metrics = reply.outputs.get("metrics")
    listed = metrics if isinstance(metrics, list) else []
    return next((each for each in listed if isinstance(each, dict) and each.get("name") == name), {})


@TASKS.check("ENC-004", "What is no number, or infinite, is told by its name.", needs="mqtt.decode_sparkplug")
async def special_numbers_in_metrics(run: Repetition, mqtt: Rig) -> None:
    """Decode a Sparkplug payload with metrics that are NaN, infinite, minus infinite, and a number.

    Said: success; null and the name beside it; the number.
    Seen: nothing; the payload is the kit's.
    Why: a sensor that has failed says NaN; told as 0 it is a plant that is cold.
    """
    number = round(run.rng.uniform(-1e3, 1e3), 6)
    data = payload_of([*((name, DOUBLE, value) for name, value in _SPECIAL.items()), ("number", DOUBLE, number)])
    reply = await mqtt.call("decode_sparkplug", payload=base64.b64encode(data).decode())
    if not run.succeeds(reply, requirement="ENC-004"):
        return
    for name in _SPECIAL:
        found = _metric(reply, name)
        if found.get("value", 0) is not None or (reply.native and found.get("special") != name):
            run.judge(reply, [_of_metric(reply, name, f"null with special {name!r}", found, "ENC-004")])
    if not same_json(_metric(reply, "number").get("value"), number):
        run.judge(reply, [_of_metric(reply, "number", number, _metric(reply, "number"), "ENC-004")])


def _of_metric(reply: Reply, name: str, wanted: object, found: Mapping[str, Any], requirement: str) -> Finding:
    message = f"{reply.tool}: the metric {name!r} should be {wanted}, the reply says {dict(found)!r}"
    return Finding(code="wrong_value", message=message, requirement=requirement)


@TASKS.every_protocol("ENC-004", "What is no number, or infinite, is told by its name.", having="floats", prompt=True)
async def special_numbers(run: Repetition, at: Rig) -> None:
    """Read a number of each type of floating-point numbers, then values of it that are NaN, infinite and minus infinite; read a number after
    them. Write texts with these names, and a number that is too large.

    Said: the number; success, null, and the name beside it; then a number. A type that the adapter does not offer fails with
        `unsupported_operation` or `invalid_input`, or `illegal_address`. The writes fail with `range_overflow`, `invalid_input` or
        `type_mismatch`.
    Seen: no request that changes the plant.
    Why: a sensor that has failed says NaN; told as 0 it is a plant that is cold.
    """
    asks = exercise(at)
    assert asks.real is not None
    ordinary = [asked for asked in _floats(at, _ORDINARY) if at.subject.claims(asked.operation)]
    if not ordinary:
        run.not_applicable("the adapter has no operation that reads such a number")
    # A type that the adapter does not offer is refused in words of its own: that it is the type shows in an ordinary number of it.
    offered = [
        asked.inputs
        for asked in ordinary
        if exact_or_refused(run, await _asked(at, asked), *_NOT_THERE, requirement="ENC-004", value=_ORDINARY)
    ]
    for name, value in _SPECIAL.items():
        for asked in _floats(at, value):
            if asked.inputs in offered:
                _judge_special(run, at, await _asked(at, asked), name)
    await a_read_works(run, at)
    number = asks.real(0.5)
    if at.subject.claims(number.operation):
        await a_write_works(run, at)
        for beyond in ("NaN", "Infinity", 1e39):
            reply = await at.call(number.operation, **{**number.inputs, "value": beyond})
            run.fails(reply, *_NOT_WRITTEN, outcome=NOTHING_SENT, requirement="ENC-004")
            run.witnessed(nothing_arrived(at, reply.during(await at.journal()), requirement="ENC-004"))


def _floats(at: Rig, value: float) -> list[Asked]:
    """Return reads of a number, one for each type."""
    return [read_of(value) for read_of in exercise(at).floats.values()]


async def _asked(at: Rig, asked: Asked) -> Reply:
    """Set what a call needs, and make it."""
    for poke in asked.pokes:
        await at.device.poke(**poke)
    return await at.call(asked.operation, **asked.inputs)


# -- ENC-005 ----------------------------------------------------------------------------------------------------------


def _large(run: Repetition, *, signed: bool) -> list[int]:
    values = [_EXACT, _EXACT + 2, 2**63 - 1, run.rng.randrange(2**60, 2**62) | 1]
    return [*values, -_EXACT, -_EXACT - 2, -(2**63)] if signed else [*values, 2**64 - 1]


def _judge_large(run: Repetition, reply: Reply, found: object, value: int, what: str) -> None:
    """Expect the number where every reader of JSON has it exactly, else a decimal string."""
    if found == str(value) or (not isinstance(found, bool) and abs(value) <= _EXACT and same_json(found, value)):
        return
    exact = isinstance(found, int) and not isinstance(found, bool) and found == value
    message = f"{reply.label}: {what} should be {str(value)!r}, the reply says {found!r}"
    finding = Finding(
        code="wrong_value",
        message=message,
        requirement="ENC-005",
        # The number is right for whoever reads JSON without doubles; only our envelope promises a string.
        strength="MUST" if reply.native or not exact else "SHOULD",
    )
    run.judge(reply, [finding])


@TASKS.check("ENC-005", "Large whole numbers arrive digit by digit.", needs="modbus.read_typed")
async def large_numbers_in_registers(run: Repetition, modbus: Rig) -> None:
    """Read whole numbers of 64 bits at and beyond 2^53 - 1 in both directions.

    Said: decimal strings with all their digits; up to 2^53 - 1 numbers are as good.
    Seen: the registers hold these numbers.
    Why: a counter that is read by way of a floating-point number stands still, and then leaps.
    """
    for kind in ("uint64", "int64"):
        for value in _large(run, signed=kind == "int64"):
            await _hold(modbus, "read_typed", registers(value, kind))
            reply = await modbus.call("read_typed", address=_AT, type=kind)
            if exact_or_refused(run, reply, *_NOT_OFFERED, requirement="ENC-005"):
                _judge_large(run, reply, reply.outputs.get("value"), value, "value")


@TASKS.check("ENC-005", "Large whole numbers arrive digit by digit.", needs="opcua.read")
async def large_numbers_in_nodes(run: Repetition, opcua: Rig) -> None:
    """Read whole numbers of the types UInt64 and Int64 at and beyond 2^53 - 1 in both directions.

    Said: decimal strings with all their digits; up to 2^53 - 1 numbers are as good.
    Seen: the nodes hold these numbers.
    Why: a counter that is read by way of a floating-point number stands still, and then leaps.
    """
    await opcua.device.poke(nodes="types")
    if not await knows_node(run, opcua, "ns=2;s=Boolean"):
        return
    for kind in ("UInt64", "Int64"):
        for value in _large(run, signed=kind == "Int64"):
            await opcua.device.poke(node=kind, value=value)
            reply = await opcua.call("read", node=f"ns=2;s={kind}")
            if run.succeeds(reply, requirement="ENC-005"):
                _judge_large(run, reply, reply.outputs.get("value"), value, "value")


@TASKS.check("ENC-005", "Large whole numbers arrive digit by digit.", needs="mqtt.decode_sparkplug")
async def large_numbers_in_metrics(run: Repetition, mqtt: Rig) -> None:
    """Decode a Sparkplug payload with whole numbers of 64 bits at and beyond 2^53 - 1 in both directions.

    Said: decimal strings with all their digits; up to 2^53 - 1 numbers are as good.
    Seen: nothing; the payload is the kit's.
    Why: a counter that is read by way of a floating-point number stands still, and then leaps.
    """
    values = [
        *((f"UInt64/{value}", UINT64, value) for value in _large(run, signed=False)),
        *((f"Int64/{value}", INT64, value) for value in _large(run, signed=True)),
    ]
    reply = await mqtt.call("decode_sparkplug", payload=base64.b64encode(payload_of(values)).decode())
    if run.succeeds(reply, requirement="ENC-005"):
        for name, _, value in values:
            _judge_large(run, reply, _metric(reply, name).get("value"), value, name)


@TASKS.every_protocol("ENC-005", "Large whole numbers arrive digit by digit.", having="large", prompt=True)
async def large_numbers(run: Repetition, at: Rig) -> None:
    """Read whole numbers of 64 bits at and beyond 2^53 - 1 in both directions.

    Said: decimal strings with all their digits; up to 2^53 - 1 numbers are as good. A type that the adapter does not offer fails with
        `unsupported_operation` or `invalid_input`, or `illegal_address`.
    Seen: the device holds these numbers.
    Why: a counter that is read by way of a floating-point number stands still, and then leaps.
    """
    large = exercise(at).large
    assert large is not None
    asked_for = [asked for signed in (False, True) for asked in large(_large(run, signed=signed), signed)]
    offered = [asked for asked in asked_for if at.subject.claims(asked.operation)]
    if not offered:
        run.not_applicable("the adapter has no operation that reads such a number")
    await a_read_works(run, at)
    for asked in offered:
        value = asked.outputs["value"]
        assert isinstance(value, int)
        reply = await _asked(at, asked)
        if exact_or_refused(run, reply, *_NOT_THERE, requirement="ENC-005"):
            _judge_large(run, reply, reply.outputs.get("value"), value, "value")


# -- ENC-006 ----------------------------------------------------------------------------------------------------------

_TEXTS = ("text", "odd", "\u05e9\u05dc\u05d5\u05dd", "e\u0301", "\U0001f600\U0001d11e", "  padded  ", '"quoted"\\')
"""Texts that can be shown: from right to left, combined, beyond 16 bits, padded."""

_INVISIBLE = ("a\0b", "a\u202eb\u202c")
"""Texts with a zero byte, and with a change of direction."""

_LONG = 1000
"""Characters of a text where the type has no greatest length; a description of a recipe has as many."""

_BYTES = (b"\xff", b"\x00\x01\xfe\xff", b"\xc3(", b"\xed\xa0\x80", b"")


@TASKS.check(
    "ENC-006", "Text arrives as it is, and bytes that are no text are not lost.", needs="mqtt.subscribe mqtt.messages"
)
async def payloads_arrive_as_they_are(run: Repetition, mqtt: Rig) -> None:
    """Receive messages whose payloads are texts of many writings, texts with invisible characters, and bytes that are no text, some at random; publish
    bytes.

    Said: each text; the bytes as base64 with its mark. A text with invisible characters may be base64 as well.
    Seen: a payload that was given as base64 is published as its bytes.
    Why: a payload that is no text ends the receiving thread of many a client, and with it every message to come.
    """
    if mqtt.subject.blocks("messages"):
        run.not_applicable("the adapter has only a call that waits for messages")
    topic = "sensors/pressure"
    run.succeeds(await subscribe(mqtt, topic), requirement="ENC-006")
    nonce = f"{run.rng.getrandbits(32):08x}"
    random = bytes([0xFF, *run.rng.randbytes(12)])
    payloads = [*(text.encode() + nonce.encode() for text in (*_TEXTS, *_INVISIBLE)), *_BYTES[:-1], random]
    for payload in payloads:
        encoded = base64.b64encode(payload).decode()
        await publish_from_kit(mqtt, topic, payload)
        await mqtt.wait_for(kind="PUBLISH", direction="out", topic=topic, payload=encoded, timeout_s=1.0)
        await sync_point(run, mqtt, "sensors/#")
        reply = await mqtt.call("messages", filter=topic)
        if run.succeeds(reply, requirement="ENC-006") and payload not in _received(mqtt, reply):
            shown = str(reply.outputs.get("messages"))[:200]
            message = f"{reply.label}: a message with the bytes {payload.hex()} should be there, the reply says {shown}"
            run.judge(reply, [Finding(code="wrong_value", message=message, requirement="ENC-006")])
    if mqtt.subject.claims("publish") and mqtt.subject.accepts_input("publish", "encoding"):
        encoded = base64.b64encode(random).decode()
        reply = await mqtt.call("publish", topic="control/pump", payload=encoded, qos=1, encoding="base64")
        if run.succeeds(reply, requirement="ENC-006"):
            seen = reply.during(await mqtt.journal())
            if not any(entry["kind"] == "PUBLISH" and entry.get("payload") == encoded for entry in seen):
                message = f"{reply.label}: the broker should have been given the bytes {random.hex()}"
                run.judge(reply, [Finding(code="device_differs", message=message, requirement="ENC-006")])


def _received(mqtt: Rig, reply: Reply) -> list[bytes]:
    """Return the payloads of an answer, as bytes; what is base64 is told by its mark, or may be it where there are no marks."""
    messages = listed(reply.outputs)
    unmarked = () if mqtt.subject.claims("messages.encodings") else [decoded(message.payload) for message in messages]
    return [content for content in (*(message.content for message in messages), *unmarked) if content is not None]


@TASKS.check("ENC-006", "Text arrives as it is, and bytes that are no text are not lost.", needs="opcua.read")
async def texts_of_nodes_arrive_as_they_are(run: Repetition, opcua: Rig) -> None:
    """Read nodes that hold texts of many writings, texts with invisible characters, a long text, and bytes; write texts.

    Said: each text; the bytes as base64. Of a text with invisible characters at least the others.
    Seen: the node holds the text that was written, character by character.
    Why: a text that cannot be read must not end the reading of everything else.
    """
    await opcua.device.poke(nodes="types")
    if not await knows_node(run, opcua, "ns=2;s=Boolean"):
        return
    nonce = f"{run.rng.getrandbits(32):08x}"
    for kind in ("String", "LocalizedText"):
        for text in (*_TEXTS, *_INVISIBLE, _of_length(_LONG)):
            value = text + nonce
            await opcua.device.poke(node=kind, value=value)
            reply = await opcua.call("read", node=f"ns=2;s={kind}")
            if text in _INVISIBLE:
                if run.succeeds(reply, requirement="ENC-006") and nonce not in str(reply.outputs.get("value")):
                    run.judge(reply, [_wrong(reply, value, "ENC-006")])
            else:
                run.succeeds(reply, requirement="ENC-006", value=as_said(kind, value, reply))
    for data in (*_BYTES[:-1], run.rng.randbytes(12)):
        encoded = base64.b64encode(data).decode()
        await opcua.device.poke(node="ByteString", value=encoded)
        run.succeeds(await opcua.call("read", node="ns=2;s=ByteString"), requirement="ENC-006", value=encoded)
    if opcua.subject.claims("write"):
        for text in (*_TEXTS, _of_length(_LONG)):
            written = await opcua.call("write", node="ns=2;s=String", value=text + nonce)
            if run.succeeds(written, requirement="ENC-006"):
                run.witnessed(_holds_text(await opcua.device.image(), text + nonce))


def _holds_text(image: Any, text: str) -> list[Finding]:
    held = opcua_oracle.held(image, "ns=2;s=String")
    if held == text:
        return []
    message = f"the node should hold {text!r}, it holds {held!r}"
    return [Finding(code="device_differs", message=message, requirement="ENC-006")]


@TASKS.check(
    "ENC-006", "Text arrives as it is, and bytes that are no text end nothing.", needs="modbus.read_device_information"
)
async def texts_of_the_identification_arrive_as_they_are(run: Repetition, modbus: Rig) -> None:
    """Read a device's identification that holds texts of many writings; then one in which one object is no text.

    Said: each text; the other texts also where one is none.
    Seen: the device has these objects.
    Why: one byte that is no text ends the reading of everything else in many a client.
    """
    nonce = f"{run.rng.getrandbits(32):08x}"
    texts = {str(number): text.strip() + nonce for number, text in enumerate(_TEXTS[:6])}
    objects = {number: base64.b64encode(text.encode()).decode() for number, text in texts.items()}
    for other in (b"text", b"\xff\x00\xfe"):
        await modbus.device.poke(unit=1, identification={**objects, "6": base64.b64encode(other).decode()})
        reply = await modbus.call("read_device_information")
        found = reply.outputs.get("objects")
        told = {number: found.get(number) for number in texts} if isinstance(found, dict) else found
        if run.succeeds(reply, requirement="ENC-006") and told != texts:
            run.judge(reply, [_wrong(reply, texts, "ENC-006", name="objects")])


_UMLAUTS = "Gr\u00f6\u00dfe "


@TASKS.every_protocol("ENC-006", "Text arrives as it is.", having="texts", prompt=True)
async def texts_arrive_as_they_are(run: Repetition, at: Rig) -> None:
    """Read texts of many writings, texts with invisible characters, and one as long as the device has room for, as far as the device can hold
    them, and as the tool's schema allows; write texts, also some that it cannot hold, and one that is too long by a character.

    Said: each text. Of one with invisible characters, and where a byte is a character of one of several sets, at least the others; where zero
        bytes fill texts up, at least what is before the first one. For what the device cannot hold failures with `type_mismatch`, `invalid_input` or `range_overflow`, for what is too long also with
        `limit_exceeded`.
    Seen: the device holds the text that was written, character by character; what it held before, where it cannot hold the text.
    Why: a text that cannot be read must not end the reading of everything else; one with question marks in it is another text, and so is one
        without its end.
    """
    texts = exercise(at).texts
    assert texts is not None
    if not at.subject.claims(texts.read("").operation):
        run.not_applicable("the adapter has no operation that reads a text")
    await a_read_works(run, at)
    nonce = f"{run.rng.getrandbits(32):08x}"
    every = [text + nonce for text in (*_TEXTS, *_INVISIBLE, _UMLAUTS, _of_length(texts.longest - len(nonce)))]
    holds = [text for text in every if _can_hold(texts.encoding, text)]
    for text in holds:
        asked = texts.read(text)
        reply = await _asked(at, asked)
        # An adapter may take shorter messages than the longest text needs.
        codes = (*_NOT_THERE, "limit_exceeded") if len(text) == texts.longest else _NOT_THERE
        if not exact_or_refused(run, reply, *codes, requirement="ENC-006"):
            return
        found = reply.outputs.get("value")
        exact = text.removesuffix(nonce) not in _INVISIBLE and (text.isascii() or texts.encoding == "utf-8")
        ends = texts.filled_up and found == text.partition("\0")[0]
        if found != text if exact else nonce not in str(found) and not ends:
            run.judge(reply, [_wrong(reply, text, "ENC-006")])
    if at.subject.claims(texts.write(nonce).operation):
        await _write_texts(run, at, texts, [text for text in every if text.removesuffix(nonce) not in _INVISIBLE])


async def _write_texts(run: Repetition, at: Rig, texts: Texts, every: Sequence[str]) -> None:
    await at.prove()
    ordinary = await _asked(at, texts.write(_TEXTS[0]))
    if not exact_or_refused(run, ordinary, *_NOT_THERE, requirement="ENC-006"):
        return
    for text in every:
        asked = texts.write(text)
        reply = await _asked(at, asked)
        if not _can_hold(texts.encoding, text):
            run.fails(reply, *_NOT_WRITTEN, outcome=NOTHING_SENT, requirement="ENC-006")
            run.witnessed(nothing_arrived(at, reply.during(await at.journal()), requirement="ENC-006"))
        elif len(text) > most_characters(at, asked, "value"):
            run.fails(reply, "limit_exceeded", *_NOT_WRITTEN, outcome=NOTHING_SENT, requirement="ENC-006")
            run.witnessed(nothing_arrived(at, reply.during(await at.journal()), requirement="ENC-006"))
        elif text.isascii() or texts.encoding == "utf-8":
            run.succeeds(reply, requirement="ENC-006")
            run.witnessed(citing("ENC-006", witness(at).holds(await at.device.image(), asked.points)))
    if texts.limited:
        asked = texts.write(_of_length(texts.longest + 1))
        for poke in asked.pokes:
            await at.device.poke(**poke)
        before = await at.device.image()
        reply = await at.call(asked.operation, **asked.inputs)
        codes = (*_NOT_WRITTEN, "limit_exceeded", "illegal_value", "unsupported_operation")
        run.fails(reply, *codes, outcome=(*NOTHING_SENT, "rejected"), requirement="ENC-006", code_requirement="ERR-002")
        run.witnessed(citing("ENC-006", witness(at).only_changed(before, await at.device.image(), {})))


def _of_length(length: int) -> str:
    """Return a text in which no part stands for another: words with their numbers."""
    return "".join(f"word {number} " for number in range(length))[:length]


def _can_hold(encoding: str, text: str) -> bool:
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True


# -- ENC-007 ----------------------------------------------------------------------------------------------------------


@TASKS.every_protocol("ENC-007", "Times are in UTC.", apart="opcua", prompt=True)
async def the_time_of_an_answer_is_utc(run: Repetition, at: Rig) -> None:
    """Read.

    Said: the value. `meta.started_at`, where there is one, is in UTC and lies within the call.
    Seen: the device holds the value.
    Why: a local time without its offset puts an alarm an hour before its cause.
    """
    await a_read_works(run, at)


_MOMENTS = (
    "1601-01-02T03:04:05+00:00",
    "1969-12-31T23:59:59+00:00",
    "2026-03-29T01:30:00+00:00",
    "9999-12-30T12:00:00+00:00",
)
"""Near the first and the last that OPC UA has; before 1970; an hour that many local times do not have."""

_CLOCKS = timedelta(seconds=10)


@TASKS.check("ENC-007", "Times are in UTC.", needs="opcua.read")
async def times_of_nodes_are_utc(run: Repetition, opcua: Rig) -> None:
    """Read a value that was set just before, with its timestamps; then nodes that hold times, one of them none.

    Said: timestamps in UTC that lie within seconds of the call; each time as the same instant, with its offset; none is null, and no time.
    Seen: the nodes hold these times.
    Why: a local time without its offset puts an alarm an hour before its cause.
    """
    _, reply = await read(run, opcua)
    run.succeeds(reply, requirement="ENC-007")
    started = _instant(reply.member("meta", "started_at"))
    for name in ("source_timestamp", "server_timestamp"):
        if name in reply.outputs:
            stated = _instant(reply.outputs[name])
            if stated is None or (started is not None and abs(stated - started) > _CLOCKS):
                about = "" if started is None else f", about {started}"
                run.judge(reply, [_wrong(reply, f"a time in UTC{about}", "ENC-007", name=name)])
    await opcua.device.poke(nodes=["types", "special"])
    if not await knows_node(run, opcua, "ns=2;s=Boolean"):
        return
    for text in (*_MOMENTS, f"2026-0{run.rng.randrange(1, 10)}-11T0{run.rng.randrange(10)}:02:03.456000+00:00"):
        await opcua.device.poke(node="DateTime", value=text)
        reply = await opcua.call("read", node="ns=2;s=DateTime")
        if run.succeeds(reply, requirement="ENC-007") and _instant(reply.outputs.get("value")) != _instant(text):
            run.judge(reply, [_wrong(reply, text, "ENC-007")])
    none = await opcua.call("read", node="ns=2;s=DateTime.Null")
    run.succeeds(none, requirement="ENC-007", value=None)


def _instant(text: object) -> datetime | None:
    """Return the instant that a text is in RFC 3339; None for one without an offset."""
    if not isinstance(text, str):
        return None
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        return None
    return found if found.tzinfo is not None else None
