"""ADR: addresses, ranges and types."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from functools import partial
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.strict_json import same_json
from pytest_otmcp.protocols.journal import Image
from pytest_otmcp.protocols.modbus import oracle as modbus_oracle
from pytest_otmcp.protocols.modbus.registers import registers, same_bits
from pytest_otmcp.protocols.modbus.tags import TAGS
from pytest_otmcp.protocols.opcua import oracle as opcua_oracle
from pytest_otmcp.trial.alteration import DEEP, ELEMENTS, Alteration, filler
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .steps import (
    CONNECTION_FAULTS,
    NOTHING_SENT,
    a_read_works,
    a_write_works,
    citing,
    exact_or_refused,
    exercise,
    knows_node,
    nothing_arrived,
    refused_before_the_wire,
    relayed,
    since,
    witness,
    works_again,
)

__all__ = ["TASKS"]

TASKS = Checks()

SIZE = 0x10000
_LIKE_NAMES = (30_000, 30_001, 39_999, 40_000, 40_001, 49_999)
"""Addresses that name registers 0, 1 and so on where somebody takes them for the numbers of older documents (MODBUS Application Protocol
V1.1b3, section 4.4: such a model "is the vendor's")."""
_OUTSIDE = ("invalid_input", "illegal_address", "limit_exceeded", "range_overflow", "type_mismatch")
_WRONG_KIND = ("type_mismatch", "invalid_input", "range_overflow")
_UNKNOWN = ("illegal_address", "invalid_input")
_NOBODY = ("gateway_path_unavailable", "gateway_target_no_response")


# -- Modbus -----------------------------------------------------------------------------------------------------------


@TASKS.check(
    "ADR-001",
    "Reads and writes go to the address that was asked for.",
    needs="modbus.read_holding modbus.write_holding",
)
async def addresses_are_those_that_were_asked_for(run: Repetition, modbus: Rig) -> None:
    """Write a register and read it, while its neighbours hold other values: register 1, some at random, the first two and last two that
    there can be, and those whose numbers look like the documents' names for registers, such as 40001.

    Said: the value that was written. Other registers than 1 may be unknown to the adapter: then a failure with `illegal_address` or
        `invalid_input`.
    Seen: one write to this register, and a read of it.
    Why: an adapter that counts wrongly, in reads and writes alike, agrees with itself and moves the neighbour.
    """
    await modbus.device.poke(unit=1, cells=SIZE)
    for address in (1, *run.rng.sample(range(10, 90), 3), 0, SIZE - 2, SIZE - 1, *_LIKE_NAMES):
        written, held = run.rng.sample(range(SIZE), 2)
        for neighbour in (address - 1, address + 1):
            if 0 <= neighbour < SIZE:
                await modbus.device.poke(unit=1, table="holding_registers", address=neighbour, values=[held])
        codes = () if address == 1 else _UNKNOWN
        reply = await modbus.call("write_holding", address=address, value=written)
        if exact_or_refused(run, reply, *codes, requirement="ADR-001", value=written):
            seen = reply.during(await modbus.journal())
            run.witnessed(modbus_oracle.exactly_one_write(seen, "holding_registers", address=address, values=[written]))
        await modbus.device.poke(unit=1, table="holding_registers", address=address, values=[held ^ 1])
        read = await modbus.call("read_holding", address=address, count=1)
        if exact_or_refused(run, read, *codes, requirement="ADR-001", values=[held ^ 1]):
            seen = read.during(await modbus.journal())
            run.witnessed(modbus_oracle.read_where_asked(seen, function=3, address=address))


@TASKS.check(
    "ADR-002",
    "What is no address, count or unit is refused.",
    needs="modbus.read_holding modbus.write_holding",
)
async def what_is_no_address_is_refused(run: Repetition, modbus: Rig) -> None:
    """Read and write at addresses that there are not, read so many registers that there is no such number, and ask for units that there
    are not; before and after, the same with what there is.

    Said: failures with `invalid_input`, `illegal_address`, `limit_exceeded`, `range_overflow` or `type_mismatch`, and the outcome
        `not_sent`, or with the code of the exception by which the device refused it; for a reserved unit also the failure of the
        gateway. Success before and after.
    Seen: no request that changes the plant.
    Why: an address or a unit that is cut down to fit is another machine.
    """
    await a_read_works(run, modbus)
    await a_write_works(run, modbus)
    refused = partial(_refused, run, modbus)
    random = run.rng.randrange(SIZE, 2**31)
    for address in (-1, SIZE, random, 2**31, 10.5, "0x10"):
        await refused("read_holding", {"address": 20, "count": 1}, "address", address)
        await refused("write_holding", {"address": 20, "value": 7}, "address", address)
    for count in (-1, 0, 1.5, "0x1", SIZE + 1):
        await refused("read_holding", {"address": 20, "count": 1}, "count", count)
    for operation, inputs in (
        ("read_holding", {"address": 20, "count": 1}),
        ("write_holding", {"address": 20, "value": 7}),
    ):
        for unit in (-1, 256, 257, 2**31, 1.5, "0x1", 248, 254):
            if modbus.subject.accepts_input(operation, "unit"):
                # A reserved unit is a number that a gateway may have been given.
                nobody = _NOBODY if unit in (248, 254) else ()
                await refused(operation, {**inputs, "unit": 1}, "unit", unit, nobody=nobody)
    await a_read_works(run, modbus)
    await a_write_works(run, modbus)


async def _refused(
    run: Repetition,
    at: Rig,
    operation: str,
    inputs: Mapping[str, Any],
    name: str,
    value: object,
    nobody: Sequence[str] = (),
) -> None:
    """Call with a value outside of its input's domain. The device may be the one that refuses: then the code is that of what it said.

    Args:
        nobody: codes that say that there is nothing with this value, where it can be sent.
    """
    reply = await _with(at, operation, inputs, name, value)
    if reply is None:
        return
    seen = reply.during(await at.journal())
    # An adapter with a list of its own targets says that this one is not on it.
    unlisted = () if seen else ("access_denied",)
    told = relayed(at, seen)
    codes = (*_OUTSIDE, *nobody, *told, *unlisted)
    outcomes = (*NOTHING_SENT, "rejected", *(("unknown",) if nobody else ()))
    run.fails(reply, *codes, outcome=outcomes, requirement="ADR-002", code_requirement="ERR-002")
    # Where there is nobody the device says so itself, whichever code the adapter has for that.
    if not {reply.error_code, *told} & {*nobody}:
        run.witnessed(nothing_arrived(at, seen, requirement="ADR-002"))


async def _with(at: Rig, operation: str, inputs: Mapping[str, Any], name: str, value: object) -> Reply | None:
    """Call with another value of one input; None where its kind cannot be given."""
    if type(value) is int:
        return await at.call(operation, **{**inputs, name: value})
    argument = (at.arguments_of(operation, **inputs) or {}).get(name)
    if argument is None:
        return None
    return await at.call_altered(operation, Alteration(given={argument: value}), **inputs)


@TASKS.check("ADR-003", "A value that does not fit into its registers is refused.", needs="modbus.write_holding")
async def what_does_not_fit_a_register_is_refused(run: Repetition, modbus: Rig) -> None:
    """Write the lowest and the highest value of a register, of a block and of tags of other types; and for each one that lies just beyond.

    Said: success; failures with `range_overflow` and the outcome `not_sent`.
    Seen: the registers hold the bounds; no request that changes the plant for what is beyond.
    Why: a value that is cut down to fit is one that nobody asked for.
    """
    await modbus.prove()
    for low, high in ((0, -1), (0xFFFF, 0x10000), (0, 70000), (0xFFFF, -(2**31))):
        await _bound(run, modbus, "write_holding", {"address": 1}, "value", low, high, (1, [low]))
        if modbus.subject.claims("write_registers"):
            await _bound(run, modbus, "write_registers", {"address": 1}, "values", [7, low], [7, high], (1, [7, low]))
    if modbus.subject.claims("write_tag"):
        for inside, beyond in ((-(2**31), -(2**31) - 1), (2**31 - 1, 2**31)):
            await _bound_of_tag(run, modbus, "otmcp_swapped", inside, beyond)
        await _bound_of_tag(run, modbus, "otmcp_float", 3.4028234663852886e38, 1e39)


async def _bound_of_tag(run: Repetition, modbus: Rig, name: str, inside: float, beyond: float) -> None:
    tag = TAGS[name]
    held = (tag.address, registers(inside, tag.type, tag.order))
    await _bound(run, modbus, "write_tag", {"name": name}, "value", inside, beyond, held)


async def _bound(
    run: Repetition,
    modbus: Rig,
    operation: str,
    inputs: Mapping[str, Any],
    name: str,
    inside: Any,
    beyond: Any,
    held: tuple[int, list[int]],
) -> None:
    if modbus.excess(operation, **inputs, **{name: inside}) is not None:
        # The tool's schema has a bound of its own, and no smaller value shows what becomes of one that is cut down.
        return
    address, words = held
    accepted = await modbus.call(operation, **inputs, **{name: inside})
    run.succeeds(accepted, requirement="ADR-003")
    before = await modbus.device.image()
    run.witnessed(modbus_oracle.image_holds(before, "holding_registers", address, words))
    reply = await modbus.call(operation, **inputs, **{name: beyond})
    run.fails(reply, "range_overflow", outcome=NOTHING_SENT, requirement="ADR-003")
    run.witnessed(
        modbus_oracle.no_state_changing_request(reply.during(await modbus.journal()), requirement="ADR-003"),
        modbus_oracle.only_changed(before, await modbus.device.image(), {}, otherwise="ADR-003"),
    )


@TASKS.check("ADR-004", "A value of another kind than a register's is refused.", needs="modbus.write_holding")
async def a_register_holds_whole_numbers(run: Repetition, modbus: Rig) -> None:
    """Write to a register a fraction, texts, a list and nothing; to a coil the text "false"; then a whole number.

    Said: failures with `type_mismatch`, `invalid_input` or `range_overflow` and the outcome `not_sent`; then success.
    Seen: no request that changes the plant; then one.
    Why: a value that is made to fit is one that nobody asked for.
    """
    if "value" not in (modbus.arguments_of("write_holding", address=1, value=7) or {}):
        run.not_applicable("the value is not given to the tool as it is")
    await modbus.prove()
    cases: list[tuple[str, dict[str, Any], list[object]]] = [
        ("write_holding", {"address": 1, "value": 7}, [40.7, "abc", "40", [40], None])
    ]
    if modbus.subject.claims("write_coil"):
        cases.append(("write_coil", {"address": 20, "value": True}, ["false", "off", None]))
    for operation, inputs, values in cases:
        for value in values:
            before = await modbus.device.image()
            reply = await _with(modbus, operation, inputs, "value", value)
            if reply is None:
                continue
            run.fails(reply, *_WRONG_KIND, outcome=NOTHING_SENT, requirement="ADR-004")
            run.witnessed(
                modbus_oracle.no_state_changing_request(reply.during(await modbus.journal()), requirement="ADR-004"),
                modbus_oracle.only_changed(before, await modbus.device.image(), {}, otherwise="ADR-004"),
            )
    await a_write_works(run, modbus)


@TASKS.check("ADR-005", "A scaled value is rounded to the nearest raw value.", needs="modbus.write_tag modbus.read_tag")
async def scaled_values_are_rounded(run: Repetition, modbus: Rig) -> None:
    """Write values of scaled tags that lie between two raw values, at a raw bound, and one step beyond it; read each back, and read raw
    values that were set at the device.

    Said: success, and the raw value that was written where the adapter tells it; `range_overflow` beyond the bound; what is read
        differs from what was written by at most half a step, and from what the device holds not at all. An adapter without offsets
        has no tag with one.
    Seen: the nearest raw value in the register.
    Why: 25.3 that is cut off to 252 tenths is wrong by a tenth on every write.
    """
    await modbus.prove()
    near = {
        "otmcp_scaled": (25.3, 25.34, 25.36, -25.3, -25.36, 3276.7, -3276.8, run.rng.randrange(-32768, 32768) / 10),
        "otmcp_shifted": (10.3, 10.2, -40.0, 32727.5, -39.8),
    }
    unknown = None
    for name, values in near.items():
        tag = TAGS[name]
        step = Decimal(str(tag.scale))
        for value in values:
            raw = round((Decimal(str(value)) - Decimal(str(tag.offset))) / step)
            written = await modbus.call("write_tag", name=name, value=value)
            if value == values[0] and tag.offset and _is_not_there(written):
                read = await modbus.call("read_tag", name=name)
                if _is_not_there(read):
                    unknown = name
                    break
            if run.succeeds(written, requirement="ADR-005"):
                image = await modbus.device.image()
                run.witnessed(_holds(image, tag.address, registers(raw, tag.type)))
                told = written.outputs.get("raw")
                if isinstance(told, int) and told != raw:
                    run.judge(written, [_wrong(written, "raw", raw)])
            read = await modbus.call("read_tag", name=name)
            if run.succeeds(read, requirement="ADR-005"):
                exact = raw * step + Decimal(str(tag.offset))
                if not _near(read.outputs.get("value"), exact):
                    run.judge(read, [_wrong(read, "value", float(exact))])
    for name, beyond in (
        ("otmcp_scaled", 3276.8),
        ("otmcp_scaled", -3276.9),
        ("otmcp_shifted", 32728),
        ("otmcp_shifted", -40.5),
    ):
        if name == unknown:
            continue
        reply = await modbus.call("write_tag", name=name, value=beyond)
        run.fails(reply, "range_overflow", outcome=NOTHING_SENT, requirement="ADR-005")
        run.witnessed(
            modbus_oracle.no_state_changing_request(reply.during(await modbus.journal()), requirement="ADR-005")
        )


def _is_not_there(reply: Reply) -> bool:
    codes = ("illegal_address", "invalid_input", "unsupported_operation")
    return reply.success is False and (reply.unclassified or reply.error_code in codes)


def _holds(image: Any, address: int, words: list[int]) -> list[Finding]:
    held = [modbus_oracle.held(image, "holding_registers", address + index) for index in range(len(words))]
    if held == words:
        return []
    message = f"the registers from {address} on should hold {words}, they hold {held}"
    return [Finding(code="device_differs", message=message, requirement="ADR-005")]


def _near(value: object, exact: Decimal) -> bool:
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and abs(Decimal(value) - exact) < Decimal("1e-6")
    )


def _wrong(reply: Reply, name: str, wanted: object) -> Finding:
    found = reply.outputs.get(name)
    message = f"{reply.label}: {name} should be {wanted!r}, the reply says {found!r}"
    return Finding(code="wrong_value", message=message, requirement="ADR-005")


# -- OPC UA -----------------------------------------------------------------------------------------------------------


@TASKS.check("ADR-002", "A node id beyond its bounds is refused.", needs="opcua.read")
async def what_is_no_node_id_is_refused(run: Repetition, opcua: Rig) -> None:
    """Read nodes whose namespace index or number is beyond 16 or 32 bits, such that they are known nodes when they are cut down; before and
    after, a known node.

    Said: failures with `invalid_input` or `illegal_address`; success before and after.
    Seen: the known node holds another value each time.
    Why: an index that is cut down to fit is another namespace.
    """
    await a_read_works(run, opcua)
    for node in (
        "ns=65538;s=Temperature",
        "ns=-65534;s=Temperature",
        f"i={2**32 + 2256}",
        "i=-2256",
        "ns=2.0;s=Temperature",
    ):
        reply = await opcua.call("read", node=node)
        run.fails(reply, "invalid_input", "illegal_address", requirement="ADR-002", code_requirement="ERR-003")
    await a_read_works(run, opcua)


_BOUNDS: Mapping[str, tuple[tuple[float, float], ...]] = {
    "SByte": ((-128, -129), (127, 128)),
    "Byte": ((0, -1), (255, 256)),
    "Int16": ((-32768, -32769), (32767, 32768)),
    "UInt16": ((0, -1), (65535, 70000)),
    "Int32": ((-(2**31), -(2**31) - 1), (2**31 - 1, 2**31)),
    "UInt32": ((0, -1), (2**32 - 1, 2**32)),
    "Int64": ((-(2**53) + 1, -(2**63) - 1), (2**53 - 1, 2**63)),
    "UInt64": ((0, -1), (2**53 - 1, 2**64)),
    "Float": ((3.4028234663852886e38, 1e39),),
}
"""Types to pairs of a value that fits and one that does not."""


@TASKS.check("ADR-003", "A value that the node's type cannot hold is refused.", needs="opcua.read opcua.write")
async def what_does_not_fit_a_node_is_refused(run: Repetition, opcua: Rig) -> None:
    """Write the lowest and the highest value of each type of number, and for each one that lies just beyond.

    Said: success; failures with `range_overflow`, or with `type_mismatch` or `illegal_value` where the server has refused it.
    Seen: the node holds the bound, also after what is beyond it.
    Why: a value that is cut down to fit is one that nobody asked for.
    """
    await opcua.device.poke(nodes="types")
    if not await knows_node(run, opcua, "ns=2;s=Boolean"):
        return
    for kind, pairs in _BOUNDS.items():
        node = f"ns=2;s={kind}"
        for inside, beyond in pairs:
            run.succeeds(await opcua.call("write", node=node, value=inside), requirement="ADR-003")
            reply = await opcua.call("write", node=node, value=beyond)
            seen = reply.during(await opcua.journal())
            sent = any(entry["kind"] == "Write" for entry in seen if entry["state_changing"])
            codes = ("range_overflow", "type_mismatch", "illegal_value") if sent else ("range_overflow",)
            run.fails(reply, *codes, outcome=(*NOTHING_SENT, "rejected"), requirement="ADR-003")
            run.witnessed(_kept(await opcua.device.image(), node, inside, "ADR-003"))


def _kept(image: Any, node: str, value: object, requirement: str) -> list[Finding]:
    held = opcua_oracle.held(image, node)
    if same_json(held, value) or (isinstance(value, float) and same_bits(held, value, "float32")):
        return []
    message = f"{node} should hold {value!r}, it holds {held!r}"
    return [Finding(code="device_differs", message=message, requirement=requirement)]


@TASKS.check("ADR-004", "A value of another kind than the node's is refused.", needs="opcua.read opcua.write")
async def a_node_holds_its_own_kind(run: Repetition, opcua: Rig) -> None:
    """Write texts, fractions, booleans and lists to nodes of another kind, and a single value to an array; then a value that fits.

    Said: failures with `type_mismatch`, `invalid_input` or `range_overflow`, or with `illegal_value` of the server; then success.
    Seen: no node holds another value than before.
    Why: a value that is made to fit is one that nobody asked for: many languages take the text "false" for true.
    """
    await opcua.device.poke(nodes=["types", "arrays"])
    if not await knows_node(run, opcua, "ns=2;s=Boolean"):
        return
    await opcua.device.poke(node="Boolean", value=False)
    given = opcua.arguments_of("write", node="ns=2;s=Boolean", value=True)
    # To a tool that is told every value as a text, false is "false".
    as_text = given is not None and "value" not in given
    wrong: dict[str, tuple[object, ...]] = {
        "Boolean": ([True],) if as_text else ("false", "off", [True]),
        "Int32": (40.7, "abc", True, [7]),
        "UInt16": (40.7, "7.5"),
        "Double": ("abc", True, [1.5]),
        "DateTime": ("yesterday", True),
        "Int32.Vector": (7, "abc", [1.5, 2, 3]),
        "Double.Matrix": (1.5, [1.5, 2.5]),
    }
    before = await opcua.device.image()
    for name, values in wrong.items():
        node = f"ns=2;s={name}"
        for value in values:
            reply = await opcua.call("write", node=node, value=value)
            run.fails(reply, *_WRONG_KIND, "illegal_value", outcome=(*NOTHING_SENT, "rejected"), requirement="ADR-004")
            held = opcua_oracle.held(before, node)
            run.witnessed(_kept(await opcua.device.image(), node, held, "ADR-004"))
    await a_write_works(run, opcua)


@TASKS.check("ADR-008", "A node id is checked, and a namespace's name outlives its index.", needs="opcua.read")
async def nodes_are_who_they_say(run: Repetition, opcua: Rig) -> None:
    """Read by texts that are no node ids, and by ids of nodes that there are not: in an unknown namespace, by its number and by its URI, and
    numbers and texts of which the server has the other kind only. Then write a node by the URI of its namespace, restart the
    server with another order of namespaces, in which the node's old index is a namespace that has a node of the same name, and write it again.

    Said: `invalid_input`, or `illegal_address` by an adapter that has a list of its nodes; `illegal_address`. The writes succeed; an adapter that takes no URIs says `invalid_input`, and is not asked again.
    Seen: no request for what is no node id. The second write reaches the same node as the first, and not the one at its old index.
    Why: after the server was changed, a remembered index is another machine.
    """
    await a_read_works(run, opcua)
    for text in ("garbage", "ns=2;i=abc", "ns=2;x=1", "ns=x;s=Temperature", "i=", ";;", ""):
        reply = await opcua.call("read", node=text)
        # An adapter with a list of its nodes has none of this name.
        run.fails(reply, "invalid_input", "illegal_address", requirement="ADR-008")
        if opcua_oracle.reached(reply.during(await opcua.journal()), text):
            message = f"{reply.label}: the server should have seen nothing of a text that is no node id"
            run.judge(reply, [Finding(code="wrote", message=message, requirement="ADR-008")])
    for unknown in (f"ns=99;s=x{run.rng.getrandbits(32):08x}", f"ns=2;s=x{run.rng.getrandbits(32):08x}"):
        reply = await opcua.call("read", node=unknown)
        run.fails(reply, "illegal_address", requirement="ADR-008", code_requirement="ERR-003")
    await _other_nodes(run, opcua)
    await _renumbered(run, opcua)


async def _other_nodes(run: Repetition, opcua: Rig) -> None:
    """Read nodes that there are not, each of which is a known node when a part of its id is overlooked; and one that there is."""
    digits, value = str(run.rng.randrange(10_000, 100_000)), round(run.rng.uniform(1.0, 99.0), 3)
    await opcua.device.poke(create=[{"variable": digits, "type": "Double", "value": value}])
    reply = await opcua.call("read", node=f"ns=2;s={digits}")
    exact_or_refused(run, reply, *_UNKNOWN, requirement="ADR-008", value=value)
    for other in (f"ns=2;i={digits}", "s=2256", "nsu=urn:otmcp:unknown;s=Temperature", "nsu=urn:otmcp:unknown;i=2256"):
        reply = await opcua.call("read", node=other)
        run.fails(reply, *_UNKNOWN, "unsupported_operation", requirement="ADR-008")


_PLANT, _TWIN = "urn:otmcp:plant", "urn:otmcp:twin"


async def _renumbered(run: Repetition, opcua: Rig) -> None:
    """Read, and write where the adapter writes, by URI, before and after the namespaces were numbered anew."""
    name = "ValvePosition"
    node = f"nsu={_PLANT};s={name}"
    value, twin = (round(run.rng.uniform(1.0, 99.0), 3) for _ in range(2))
    keeps = opcua.subject.claims("recovery") and opcua.subject.reconnects
    if opcua.subject.claims("write"):
        # With other namespaces the nodes that a proof uses have other ids.
        await opcua.prove()
    await opcua.device.poke(node=name, value=value)
    reply = await opcua.call("read", node=node)
    if not exact_or_refused(run, reply, *_UNKNOWN, "unsupported_operation", requirement="ADR-008", value=value):
        return
    await opcua.device.poke(namespaces=[_TWIN])
    await opcua.device.poke(create=[{"variable": name, "type": "Double", "value": twin, "namespace": _TWIN}])
    await opcua.device.poke(node=name, value=value)
    if not keeps:
        await opcua.fresh_session()
    replies = await opcua.call_until_success("read", window_s=0.0, node=node)
    run.succeeds(replies[-1], requirement="ADR-008", value=value)
    if opcua.subject.claims("write") and keeps:
        written = round(run.rng.uniform(1.0, 99.0), 3)
        run.succeeds(await opcua.call("write", node=node, value=written), requirement="ADR-008", value=written)
        image = await opcua.device.image()
        run.witnessed(
            _kept(image, f"ns=3;s={name}", written, "ADR-008"), _kept(image, f"ns=2;s={name}", twin, "ADR-008")
        )
    await opcua.device.poke(namespaces=[])
    await works_again(run, opcua, "read", node=f"ns=2;s={name}")


# -- any protocol -----------------------------------------------------------------------------------------------------


@TASKS.every_protocol("ADR-002", "What is outside of an input's domain is refused.", writes=True, having="outside")
async def what_is_outside_of_a_domain_is_refused(run: Repetition, at: Rig) -> None:
    """Read and write with addresses, and other inputs that the protocol itself limits, that there cannot be; some are known ones when they
    are cut down to fit. Before and after, with what there is.

    Said: failures with `invalid_input`, `illegal_address`, `limit_exceeded`, `range_overflow` or `type_mismatch`, and the outcome
        `not_sent` or `rejected`, or with the code of the answer by which the device refused it; for an address that no device may have
        also that nothing answered. Success before and after.
    Seen: nothing that changes the plant.
    Why: an address that is cut down to fit is another machine.
    """
    asks = exercise(at)
    reading, writing = asks.read(run.rng), asks.write(run.rng)
    await a_read_works(run, at)
    await a_write_works(run, at)
    for name, values in asks.outside.items():
        for value in values:
            for asked in (reading, writing):
                if name in asked.inputs and at.subject.accepts_input(asked.operation, name):
                    nobody = (*_NOBODY, *CONNECTION_FAULTS) if value in asks.unanswered.get(name, ()) else ()
                    await _refused(run, at, asked.operation, asked.inputs, name, value, nobody=nobody)
    await a_read_works(run, at)
    await a_write_works(run, at)


@TASKS.every_protocol(
    "ADR-003", "A value that its target's type cannot hold is refused.", reads=False, writes=True, having="bounds"
)
async def what_does_not_fit_is_refused(run: Repetition, at: Rig) -> None:
    """Write values at a bound of their type, and for each one that lies just beyond.

    Said: success; failures with `range_overflow` and the outcome `not_sent`. A type that the adapter does not offer fails with
        `unsupported_operation` or `invalid_input`.
    Seen: the device holds the bounds; no request that changes the plant for what is beyond.
    Why: a value that is cut down to fit is one that nobody asked for.
    """
    bounds = exercise(at).bounds
    assert bounds is not None
    offered = [(asked, beyond) for asked, beyond in bounds() if at.subject.claims(asked.operation)]
    if not offered:
        run.not_applicable("the adapter has no operation that writes a number")
    await at.prove()
    await a_write_works(run, at)
    for asked, beyond in offered:
        for poke in asked.pokes:
            await at.device.poke(**poke)
        accepted = await at.call(asked.operation, **asked.inputs)
        if not exact_or_refused(run, accepted, "unsupported_operation", "invalid_input", requirement="ADR-003"):
            continue
        before = await at.device.image()
        run.witnessed(citing("ADR-003", witness(at).holds(before, asked.points)))
        reply = await at.call(asked.operation, **{**asked.inputs, "value": beyond})
        run.fails(reply, "range_overflow", outcome=NOTHING_SENT, requirement="ADR-003")
        await _unchanged(run, at, reply, before, "ADR-003")


async def _unchanged(run: Repetition, at: Rig, reply: Reply, before: Image, requirement: str) -> None:
    """Expect that nothing of a call has reached the device and that the device is as it was."""
    run.witnessed(
        nothing_arrived(at, reply.during(await at.journal()), requirement=requirement),
        witness(at).only_changed(before, await at.device.image(), {}, otherwise=requirement),
    )


@TASKS.every_protocol(
    "ADR-004", "A value of another kind than its target's is refused.", reads=False, writes=True, having="misfits"
)
async def what_is_of_another_kind_is_refused(run: Repetition, at: Rig) -> None:
    """Write fractions, texts, lists and nothing where they do not belong; before and after, what does.

    Said: failures with `type_mismatch`, `invalid_input` or `range_overflow` and the outcome `not_sent`; success before and after.
    Seen: no request that changes the plant; before and after, one.
    Why: a value that is made to fit is one that nobody asked for: many languages take the text "false" for true.
    """
    misfits = exercise(at).misfits
    assert misfits is not None
    await at.prove()
    await a_write_works(run, at)
    for asked, values in misfits():
        if not at.subject.claims(asked.operation):
            continue
        for value in values:
            before = await at.device.image()
            reply = await _with(at, asked.operation, asked.inputs, "value", value)
            if reply is not None:
                run.fails(reply, *_WRONG_KIND, outcome=NOTHING_SENT, requirement="ADR-004")
                await _unchanged(run, at, reply, before, "ADR-004")
    await a_write_works(run, at)


_CHARACTERS = 10_000_000
_DEEP, _DEEPER = 100, 200
"""Levels that every adapter can read, and more than the parsers of some official SDKs do: Python's, as of version 2.3, drops a message
that is nested 198 deep, and never answers it."""


@TASKS.every_protocol("ADR-009", "What is too large or too deep is refused, and the session goes on.", writes=True)
async def what_is_too_large_is_refused(run: Repetition, at: Rig) -> None:
    """Write a text of ten million characters, a list of a million elements, and one that is nested 100 deep; after each, a value that
    fits. The same with a list that is nested 200 deep.

    Said: failures with `limit_exceeded`, `invalid_input`, `type_mismatch` or `range_overflow`, and the outcome `not_sent`; success after each.
        What is nested 200 deep should be refused so; an error of MCP instead of a result, or no answer, is remarkable.
    Seen: no request that changes the plant; after each refusal, one.
    Why: whatever an assistant is made to send, the adapter has to survive it, and the device must not have to.
    """
    asked = exercise(at).write(run.rng)
    given = at.arguments_of(asked.operation, **asked.inputs) or {}
    name = next((given[each] for each in ("value", "payload") if each in given), None)
    if name is None:
        run.not_applicable(f"the value of {asked.operation} is not given to the tool as it is")
    for size in (filler(_CHARACTERS), filler(1_000_000, ELEMENTS), filler(_DEEP, DEEP)):
        reply = await at.call_altered(asked.operation, Alteration(given={name: size}), **asked.inputs)
        await refused_before_the_wire(run, at, reply, "limit_exceeded", *_WRONG_KIND, requirement="ADR-009")
        await a_write_works(run, at)
    deeper = Alteration(given={name: filler(_DEEPER, DEEP)})
    message = f"{asked.operation}: what is nested {_DEEPER} deep should be refused in a result, the adapter gives another answer or none"
    remark = Finding(code="too_deep_to_read", message=message, requirement="ADR-009", strength="SHOULD")
    reply = await at.call_beyond(asked.operation, deeper, remark, **asked.inputs)
    if remark in reply.faults:
        run.witnessed(nothing_arrived(at, since(reply, await at.journal()), requirement="ADR-009"))
    else:
        await refused_before_the_wire(run, at, reply, "limit_exceeded", *_WRONG_KIND, requirement="ADR-009")
    await a_write_works(run, at)
