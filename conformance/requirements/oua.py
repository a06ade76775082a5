"""OUA: OPC UA."""

from __future__ import annotations

import base64
import random
import struct
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.instants import same_instant
from pytest_otmcp.core.strict_json import same_json
from pytest_otmcp.protocols.journal import Entries, Image
from pytest_otmcp.protocols.opcua import oracle
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .opcua_values import (
    Typed,
    bytes_of,
    every_type,
    further_types,
    leaves,
    moment_text,
    said_by,
)
from .steps import CONNECTION_FAULTS, a_read_works, refused_before_the_wire, relayed

__all__ = ["TASKS"]

TASKS = Checks()

_VALVE = "ns=2;s=ValvePosition"
_TEMPERATURE = "ns=2;s=Temperature"
_METHODS = "ns=2;s=Methods"


def _everything(reply: Reply) -> list[object]:
    """Return all values of an answer."""
    return list(leaves([reply.outputs, reply.member("data")]))


def _truncated(reply: Reply) -> bool:
    """Tell whether an answer says that it is a part, in its envelope or where the subject file says."""
    return bool(reply.member("meta", "truncated") or reply.outputs.get("truncated"))


def _wrong(reply: Reply, requirement: str, expected: str, found: object) -> Finding:
    message = f"{reply.label}: expected {expected}, the reply says {found!r}"
    return Finding(code="wrong_value", message=message, requirement=requirement)


def _about(requirement: str, findings: list[Finding]) -> list[Finding]:
    return [replace(finding, requirement=requirement) for finding in findings]


async def _knows(opcua: Rig, node: str) -> bool:
    """Read a node that the kit has added, and tell whether the adapter asks the server for it.

    An adapter with a list of nodes of its own refuses it without asking: then nothing that needs added nodes can be judged.
    """
    if not opcua.subject.claims("read"):
        return True
    reply = await opcua.call("read", node=node)
    return not _not_in_its_list(reply, reply.during(await opcua.journal()), node)


def _not_in_its_list(reply: Reply, seen: Entries, node: str) -> bool:
    refused = reply.success is False and reply.error_code in ("illegal_address", "invalid_input")
    return refused and not oracle.reached(seen, node)


# -- OUA-001 ------------------------------------------------------------------------------------------------


@TASKS.check("OUA-001", "Every legal value is written with the node's own data type.", needs="opcua.write")
async def every_type_is_written_as_itself(run: Repetition, opcua: Rig) -> None:
    """Write to a variable of every built-in type: numbers at their bounds, whole numbers and others, texts that look like numbers, times,
    identifiers, bytes, localized texts, an enumeration.

    Said: success.
    Seen: each value with the type that its variable has.
    Why: a server refuses a value that comes with another type, and JSON has one kind of number where OPC UA has ten.
    """
    await opcua.prove()
    every = every_type(run.rng)
    await opcua.device.poke(create=[typed.created(typed.values[0]) for typed in every])
    if not await _knows(opcua, every[0].node):
        return
    for typed in every:
        for value in reversed(typed.values):
            reply = await _written(opcua, typed, value)
            run.succeeds(reply, requirement="OUA-001")
            seen = reply.during(await opcua.journal())
            run.witnessed(oracle.written_as(seen, typed.node, typed.kind, value, same=typed.same))


async def _written(opcua: Rig, typed: Typed, value: Any) -> Reply:
    reply = await opcua.call("write", node=typed.node, value=value)
    if (
        typed.kind == "LocalizedText"
        and reply.success is False
        and reply.error_code in ("type_mismatch", "invalid_input")
    ):
        # OPC 10000-6, section 5.4.2.11: in JSON a localized text may also be an object.
        return await opcua.call("write", node=typed.node, value={"Text": value})
    return reply


# -- OUA-002 ------------------------------------------------------------------------------------------------

_UNCERTAIN = ("UncertainLastUsableValue", "UncertainSensorNotAccurate")
_BAD = ("BadSensorFailure", "BadNotConnected", "BadOutOfService")
_RESERVED = 0xC0000000
"""A status code whose two highest bits are set; OPC 10000-4, section 7.39.1: a client shall treat it as bad."""


@TASKS.check("OUA-002", "A bad value is no success, an uncertain one says so.", needs="opcua.read")
async def the_severity_is_respected(run: Repetition, opcua: Rig) -> None:
    """Read a variable whose value is good, uncertain, bad, and of the severity that is reserved.

    Said: success for the good and the uncertain value, with the value, its status and its quality; for the others a failure with
        `bad_quality` or what else the status means, and no value.
    Seen: nothing further.
    Why: what a broken sensor shows last is a number like any other; the uncertain value is the best that the plant has.
    """
    for status in ("Good", *_UNCERTAIN):
        value = await _poked(run, opcua, status)
        reply = await opcua.call("read", node=_TEMPERATURE)
        quality = "good" if status == "Good" else "uncertain"
        run.succeeds(reply, requirement="OUA-002", value=value, status=status, quality=quality)
    for bad in (*_BAD, _RESERVED):
        value = await _poked(run, opcua, bad)
        reply = await opcua.call("read", node=_TEMPERATURE)
        refused = ("bad_quality", "device_failure", *((*CONNECTION_FAULTS, "protocol_error") if bad != _BAD[0] else ()))
        run.fails(reply, *refused, requirement="OUA-002", code_requirement="ERR-003")
        if reply.success is False and any(same_json(leaf, value) for leaf in _everything(reply)):
            run.judge(reply, [_wrong(reply, "OUA-002", "no value with a bad status", value)])
    await _poked(run, opcua, "Good")
    await a_read_works(run, opcua, requirement="OUA-002")


async def _poked(run: Repetition, opcua: Rig, status: str | int) -> float:
    """Give the temperature a random value with this status, and return it."""
    value = round(run.rng.uniform(-50.0, 150.0), 6)
    await opcua.device.poke(node="Temperature", value=value, status=status)
    return value


# -- OUA-003 ------------------------------------------------------------------------------------------------


@TASKS.check("OUA-003", "A value comes as typed JSON, with its data type and its times.", needs="opcua.read")
async def values_are_typed_json(run: Repetition, opcua: Rig) -> None:
    """Read a variable of every built-in type, a structure that everybody knows, one that nobody knows, null, an empty array, and a value
    with random times, and without times.

    Said: each value as JSON, its data type, and the source timestamp and server timestamp of the server; null where it has none.
    Seen: nothing further.
    Why: a value that is printed as a program's own object is guessed at, and a time that the adapter made up hides how old the value is.
    """
    every = [*every_type(run.rng), *further_types(run.rng)]
    low, body = round(run.rng.uniform(-99.0, 0.0), 3), run.rng.randbytes(9)
    await opcua.device.poke(create=[typed.created(typed.values[-1]) for typed in every])
    await opcua.device.poke(create=_odd_variables(low, body))
    if not await _knows(opcua, every[0].node):
        return
    for typed in every:
        reply = await opcua.call("read", node=typed.node)
        if run.succeeds(reply, requirement="OUA-003"):
            run.judge(reply, _told_as(reply, typed))
    await _odd_values_are_json(run, opcua, low, body)
    await _times_are_the_servers(run, opcua)


def _told_as(reply: Reply, typed: Typed) -> list[Finding]:
    value, findings = typed.values[-1], []
    if "value" in reply.outputs and not typed.same(reply.outputs["value"], value):
        findings.append(_wrong(reply, "OUA-003", f"{value!r} as a {typed.kind}", reply.outputs["value"]))
    told = reply.outputs.get("data_type")
    if "data_type" in reply.outputs and not typed.data_type and str(told).lower() != typed.kind.lower():
        findings.append(_wrong(reply, "OUA-003", f"the data type {typed.kind}", told))
    return findings


def _odd_variables(low: float, body: bytes) -> list[dict[str, Any]]:
    structure = {"type": "ExtensionObject", "data_type": "i=22"}
    return [
        {"variable": "Otmcp.Known", **structure, "value": {"Range": {"Low": low, "High": low + 100}}},
        {"variable": "Otmcp.Unknown", **structure, "value": {"ns=2;i=4711": base64.b64encode(body).decode()}},
        {"variable": "Otmcp.Null", "type": "Double", "value": None},
        {"variable": "Otmcp.Empty", "type": "Int32", "value": []},
    ]


async def _odd_values_are_json(run: Repetition, opcua: Rig, low: float, body: bytes) -> None:
    known = await opcua.call("read", node="ns=2;s=Otmcp.Known")
    if run.succeeds(known, requirement="OUA-003"):
        run.judge(known, _decoded(known, low))
    unknown = await opcua.call("read", node="ns=2;s=Otmcp.Unknown")
    if run.succeeds(unknown, requirement="OUA-003") and "value" in unknown.outputs:
        said = _everything(unknown)
        if not (any(bytes_of(leaf) == body for leaf in said) and any("4711" in str(leaf) for leaf in said)):
            expected = f"{base64.b64encode(body).decode()!r}, which is base64, and the type ns=2;i=4711"
            run.judge(unknown, [_wrong(unknown, "OUA-003", expected, unknown.outputs["value"])])
    for node, value in (("ns=2;s=Otmcp.Null", None), ("ns=2;s=Otmcp.Empty", [])):
        run.succeeds(await opcua.call("read", node=node), requirement="OUA-003", value=value)


def _decoded(reply: Reply, low: float) -> list[Finding]:
    """Expect the members of a Range, or its bytes as base64."""
    if "value" not in reply.outputs:
        return []
    found = reply.outputs["value"]
    members = isinstance(found, Mapping) and all(said_by(found, number) for number in (low, low + 100))
    if members or any(struct.pack("<dd", low, low + 100) in bytes_of(leaf) for leaf in leaves(found)):
        return []
    return [_wrong(reply, "OUA-003", f"a Range from {low} to {low + 100}, by its members or as base64", found)]


_TIMES = ("source_timestamp", "server_timestamp")


async def _times_are_the_servers(run: Repetition, opcua: Rig) -> None:
    """Read a value with two random times, one with the first alone, one with the second alone, and one with none."""
    for there in ((True, True), (True, False), (False, True), (False, False)):
        value = round(run.rng.uniform(-50.0, 150.0), 6)
        times = {name: moment_text(run.rng) if has else None for name, has in zip(_TIMES, there, strict=True)}
        await opcua.device.poke(node="Temperature", value=value, **times)
        reply = await opcua.call("read", node=_TEMPERATURE)
        if run.succeeds(reply, requirement="OUA-003", value=value):
            run.judge(reply, _told_times(reply, times))


def _told_times(reply: Reply, times: Mapping[str, str | None]) -> list[Finding]:
    return [
        _wrong(reply, "OUA-003", f"the {name.replace('_', ' ')} {meant or 'null'}", reply.outputs[name])
        for name, meant in times.items()
        if name in reply.outputs
        and not (reply.outputs[name] is None if meant is None else same_instant(reply.outputs[name], meant))
    ]


# -- OUA-004 ------------------------------------------------------------------------------------------------

_VECTOR, _FIXED, _MATRIX, _SINGLE, _LONG = (f"Otmcp.{name}" for name in ("Vector", "Fixed", "Matrix", "Single", "Long"))
_LENGTH = 200


def _numbers(rng: random.Random, count: int) -> list[int]:
    return [rng.randrange(-(2**31), 2**31) for _ in range(count)]


def _shaped(rng: random.Random) -> dict[str, Any]:
    """Return random values by the name of the variable that can hold them."""
    return {
        _VECTOR: _numbers(rng, 3),
        _FIXED: _numbers(rng, 3),
        _MATRIX: [_numbers(rng, 3), _numbers(rng, 3)],
        _SINGLE: rng.randrange(1, 2**31),
    }


async def _create_arrays(opcua: Rig, held: Mapping[str, Any]) -> None:
    dimensions = {_FIXED: [3], _MATRIX: [2, 3]}
    await opcua.device.poke(
        create=[
            {"variable": name, "type": "Int32", "value": value, "dimensions": dimensions.get(name, [])}
            for name, value in held.items()
        ]
    )


@TASKS.check("OUA-004", "An array is read whole and keeps its shape.", needs="opcua.read")
async def arrays_keep_their_shape(run: Repetition, opcua: Rig) -> None:
    """Read arrays of one element, of three and of two hundred, a matrix, and a single value. Write values of these shapes; then write a
    single value to the array, an array to the single value, arrays that are too short, too long, flat or ragged, and one with a text.

    Said: every element in its place; the rows of the matrix, or its elements and its dimensions; the single value is no array. Success
        for the right shapes; for the others a failure with `type_mismatch` or `invalid_input` and the outcome `not_sent`.
    Seen: what was written with success, in its shape; no write of what was refused.
    Why: many servers store a single value in an array node, and the program that reads the recipe stops.
    """
    held = {**_shaped(run.rng), _LONG: _numbers(run.rng, _LENGTH), "Otmcp.One": _numbers(run.rng, 1)}
    await _create_arrays(opcua, held)
    if not await _knows(opcua, f"ns=2;s={_SINGLE}"):
        return
    for name, value in held.items():
        reply = await opcua.call("read", node=f"ns=2;s={name}")
        if run.succeeds(reply, requirement="OUA-004") and "value" in reply.outputs:
            run.judge(reply, _told_shape(reply, value))
    if opcua.subject.claims("write"):
        await _shapes_are_kept(run, opcua)


def _told_shape(reply: Reply, value: Any) -> list[Finding]:
    found = reply.outputs["value"]
    matrix = isinstance(value, list) and isinstance(value[0], list)
    flat = matrix and same_json(found, list(leaves(value))) and _has(reply.member("data"), [2, 3])
    if same_json(found, value) or flat or (_truncated(reply) and isinstance(found, list)):
        return []
    return [_wrong(reply, "OUA-004", repr(value), found)]


def _has(place: object, wanted: object) -> bool:
    """Tell whether a value is somewhere in an answer."""
    members = place.values() if isinstance(place, Mapping) else place if isinstance(place, list) else ()
    return same_json(place, wanted) or any(_has(member, wanted) for member in members)


async def _shapes_are_kept(run: Repetition, opcua: Rig) -> None:
    await opcua.prove()
    before = await opcua.device.image()
    written = _shaped(run.rng)
    # A node without ArrayDimensions holds arrays of any length.
    written[_VECTOR] = _numbers(run.rng, 5)
    for name, value in written.items():
        run.succeeds(await opcua.call("write", node=f"ns=2;s={name}", value=value), requirement="OUA-004")
    for name, value in _other_shapes(run.rng):
        reply = await opcua.call("write", node=f"ns=2;s={name}", value=value)
        await refused_before_the_wire(run, opcua, reply, "type_mismatch", "invalid_input", requirement="OUA-004")
    expected = {f"ns=2;s={name}": value for name, value in written.items()}
    run.witnessed(_about("OUA-004", oracle.only_changed(before, await opcua.device.image(), expected)))


def _other_shapes(rng: random.Random) -> list[tuple[str, Any]]:
    one, two, three, six = (_numbers(rng, count) for count in (1, 2, 3, 6))
    return [
        (_VECTOR, one[0]),
        (_FIXED, one[0]),
        (_SINGLE, one),
        (_SINGLE, three),
        (_FIXED, two),
        (_FIXED, six),
        (_MATRIX, six),
        (_MATRIX, [three, two]),
        (_MATRIX, [three, three, three]),
        (_VECTOR, [three, three]),
        (_VECTOR, [1, "two", 3]),
    ]


# -- OUA-005 ------------------------------------------------------------------------------------------------


@TASKS.check(
    "OUA-005", "The value alone is written, and a server's refusal is told as what it is.", needs="opcua.write"
)
async def the_value_alone_is_written(run: Repetition, opcua: Rig) -> None:
    """Write a variable that nobody may write, and one that this user may not; write one while the server refuses it in either way; write
    it while the server refuses whatever comes with a status or a timestamp.

    Said: a failure with `not_writable` for what nobody may write, with `access_denied` for what this user may not, each with the outcome
        `not_sent` or `rejected`; success for the last.
    Seen: the values stay as they were; the last write has its value alone.
    Why: servers use both status codes, and whoever reads "internal error" looks for the fault in the adapter.
    """
    await opcua.prove()
    names = {name: run.rng.randrange(1, 100) / 4 for name in ("Otmcp.ReadOnly", "Otmcp.Denied", "Otmcp.Writable")}
    access = dict(zip(names, ("read", "denied_writing", "read_write"), strict=True))
    await opcua.device.poke(
        create=[{"variable": name, "type": "Double", "value": names[name], "access": access[name]} for name in names]
    )
    before = await opcua.device.image()
    if await _knows(opcua, "ns=2;s=Otmcp.ReadOnly"):
        for name, code in (("Otmcp.ReadOnly", "not_writable"), ("Otmcp.Denied", "access_denied")):
            await _is_refused(run, opcua, f"ns=2;s={name}", code)
    for status, code in (("BadNotWritable", "not_writable"), ("BadUserAccessDenied", "access_denied")):
        await opcua.device.fault({"service": "Write", "action": {"status": status}})
        await _is_refused(run, opcua, _VALVE, code)
    await opcua.device.fault()
    run.witnessed(_about("OUA-005", oracle.only_changed(before, await opcua.device.image(), {})))
    await _nothing_comes_with_it(run, opcua)


async def _is_refused(run: Repetition, opcua: Rig, node: str, code: str) -> None:
    reply = await opcua.call("write", node=node, value=round(run.rng.uniform(1.0, 99.0), 3))
    run.fails(reply, code, outcome=("not_sent", "rejected"), requirement="OUA-005", code_requirement="OUA-005")


async def _nothing_comes_with_it(run: Repetition, opcua: Rig) -> None:
    """Write while the server refuses what comes with a status or a timestamp. A client may write a timestamp, so that is a warning."""
    await opcua.device.fault({"service": "Write", "action": {"refuse_timestamps": True, "refuse_status": True}})
    value = round(run.rng.uniform(1.0, 99.0), 3)
    reply = await opcua.call("write", node=_VALVE, value=value)
    await opcua.device.fault()
    entries = reply.during(await opcua.journal())
    with_it = oracle.written_with(entries)
    run.witnessed(with_it)
    if not with_it or any(finding.is_must for finding in with_it):
        run.succeeds(reply, requirement="OUA-005")
        return
    # What a server refuses for its timestamp is a refusal like any other; it may have refused for another reason.
    if reply.success is False:
        codes = ("unsupported_operation", *relayed(opcua, entries))
        run.fails(reply, *codes, outcome="rejected", requirement="OUA-005")


# -- OUA-006 ------------------------------------------------------------------------------------------------

_PAGE = 100
_CHILDREN = 2_500
_MORE = 7_500
"""Further variables in the same folder in the long form."""
_MOST_NODES = 50


@TASKS.check(
    "OUA-006",
    "Browsing is complete, comes to an end, and leaves nothing behind.",
    needs="opcua.browse",
    keys="opcua.probes.missing_node",
)
async def browsing_is_complete(run: Repetition, opcua: Rig) -> None:
    """Ask for all variables while three folders are in each other, one of them has 120 variables, and the server takes 50 nodes in one
    request. Browse a folder with 2 500 variables, in a soak 10 000, while the server sends 100 references in one answer. Browse a node
    that the server does not have.

    Said: every node once; or a part of them, and in `meta.truncated`, or the output `truncated`, that it is a part. For the missing node a failure with
        `illegal_address`, or with `invalid_input` by an adapter with a list of nodes of its own.
    Seen: no continuation point is left open.
    Why: an empty list says that a folder has nothing in it, not that there is no such folder; the first page looks like the whole plant, a circle like a plant without end, and a server has few continuation points.
    """
    if opcua.subject.claims("variables"):
        await _circles_come_to_an_end(run, opcua)
    missing = await opcua.call("browse", node=opcua.subject.probe("missing_node"))
    run.fails(missing, "illegal_address", "invalid_input", requirement="OUA-006", code_requirement="ERR-003")
    folder = "ns=2;s=Wide.Folder"
    await opcua.device.poke(nodes="wide")
    wanted = {"ns=2;s=Wide", *(f"ns=2;s=Wide{number}" for number in range(1, _CHILDREN))}
    if run.soak:
        more = {"variable": "More", "in": "Wide.Folder", "type": "Int32", "value": 0, "copies": _MORE - 1}
        await opcua.device.poke(create=[more])
        wanted |= {"ns=2;s=More", *(f"ns=2;s=More{number}" for number in range(1, _MORE))}
    await opcua.device.poke(limits={"references_per_node": _PAGE})
    reply = await opcua.call("browse", node=folder)
    entries = await opcua.journal()
    seen = reply.during(entries)
    if _not_in_its_list(reply, seen, folder):
        return
    if run.succeeds(reply, requirement="OUA-006"):
        run.judge(reply, oracle.listed_once(reply.outputs.get("node_ids"), wanted, part=_truncated(reply)))
    # What a call before has left open was told of that one.
    before = oracle.open_points([entry for entry in entries if entry["t_ns"] < reply.exchange.sent_ns])
    run.witnessed(oracle.points_left(seen, before=before))


async def _circles_come_to_an_end(run: Repetition, opcua: Rig) -> None:
    await opcua.device.poke(nodes="cycle")
    await opcua.device.poke(
        create=[{"variable": "Otmcp.Row", "in": "CycleC", "type": "Int32", "value": 0, "copies": 119}]
    )
    await opcua.device.poke(
        limits={"nodes_per_browse": _MOST_NODES, "nodes_per_read": _MOST_NODES, "references_per_node": _MOST_NODES}
    )
    image: Image = await opcua.device.image()
    reply = await opcua.call("variables")
    await opcua.device.poke(limits={"nodes_per_browse": 0, "nodes_per_read": 0, "references_per_node": 0})
    if run.succeeds(reply, requirement="OUA-006"):
        wanted = set(image["variables"])
        run.judge(reply, oracle.listed_once(reply.outputs.get("node_ids"), wanted, part=_truncated(reply)))
    run.witnessed(oracle.points_left(reply.during(await opcua.journal())))


# -- OUA-007 ------------------------------------------------------------------------------------------------


@TASKS.check("OUA-007", "A write that is clamped, or not complete yet, is told as that.", needs="opcua.write")
async def what_became_of_a_write_is_told(run: Repetition, opcua: Rig) -> None:
    """Write a value while the server takes another one and answers GoodClamped; write one while it answers GoodCompletesAsynchronously
    and still holds the old value; write one that it takes.

    Said: success; the first with `clamped` true and the value that the server took, the second with `verified` false, the last with
        neither.
    Seen: the values in the server.
    Why: an assistant that reads "written" goes on as if the valve were where it was sent.
    """
    await opcua.prove()
    asked, taken, later = (round(run.rng.uniform(low, low + 30.0), 3) for low in (60.0, 20.0, 20.0))
    await opcua.device.fault({"service": "Write", "action": {"clamp": taken}})
    clamped = await opcua.call("write", node=_VALVE, value=asked)
    held = oracle.held(await opcua.device.image(), _VALVE)
    run.succeeds(clamped, requirement="OUA-007", clamped=True, value=held)
    await opcua.device.fault(
        {"service": "Write", "action": {"ack_only": True, "with_status": "GoodCompletesAsynchronously"}}
    )
    pending = await opcua.call("write", node=_VALVE, value=later)
    await opcua.device.fault()
    run.succeeds(pending, requirement="OUA-007", verified=False)
    value = round(run.rng.uniform(1.0, 99.0), 3)
    done = await opcua.call("write", node=_VALVE, value=value)
    run.succeeds(done, requirement="OUA-007", value=value)
    if done.outputs.get("clamped") is True:
        run.judge(done, [_wrong(done, "OUA-007", "clamped to be false for a value that the server took", True)])
    run.witnessed(_about("OUA-007", oracle.image_holds(await opcua.device.image(), _VALVE, value)))


# -- OUA-008 ------------------------------------------------------------------------------------------------

_MIX, _FLAGS, _NOTHING, _RATE = (f"ns=2;s={name}" for name in ("Mix", "Flags", "Nothing", "SetProductionRate"))
_REFUSED = ("invalid_input", "type_mismatch", "range_overflow")


@TASKS.check(
    "OUA-008",
    "A method is called with the arguments that it declares, once, and only where writes are enabled.",
    needs="opcua.call_method",
    guards="opcua",
)
async def methods_are_called_as_declared(run: Repetition, opcua: Rig, opcua_ro: Rig | None) -> None:
    """Call methods with arguments of several types; with one too few, one too many, and of a wrong kind; with a value that the server
    refuses; while the server ends the connection instead of answering; and with writes disabled.

    Said: success, with typed results, for the right arguments; a failure with `invalid_input` or `type_mismatch` and the outcome
        `not_sent` for the wrong ones; the server's refusal; an unknown outcome for the lost answer; `writes_disabled`.
    Seen: one Call for each success and for the refusal of the server, with the declared types; one for the lost answer; no other.
    Why: a method starts and stops a plant, and what is called twice has happened twice.
    """
    await opcua.prove()
    await opcua.device.poke(nodes="methods")
    number, text = run.rng.randrange(-(2**31), 2**31), str(run.rng.randrange(10, 100))
    byte, whole = run.rng.randrange(256), run.rng.randrange(1000)
    for method, arguments, kinds in (
        (_MIX, [number, text], ["Int32", "String"]),
        (_FLAGS, [True, byte, whole], ["Boolean", "Byte", "Double"]),
        (_NOTHING, [], []),
    ):
        if not await _is_called(run, opcua, method, arguments, kinds):
            return
    for method, arguments in _wrong_arguments(number, text):
        reply = await opcua.call("call_method", object=_METHODS, method=method, arguments=arguments)
        await refused_before_the_wire(run, opcua, reply, *_REFUSED, requirement="OUA-008")
    await _numbers_in_texts(run, opcua, number, text)
    await _a_refused_argument_is_told(run, opcua)
    if opcua_ro is not None:
        await _writes_are_disabled(run, opcua_ro, [number, text])
    # An adapter that is not said to connect again would be lost for the items that follow.
    if opcua.subject.claims("recovery") and opcua.subject.reconnects:
        await _a_lost_answer_is_no_second_call(run, opcua, [number, text])


async def _is_called(run: Repetition, opcua: Rig, method: str, arguments: list[Any], kinds: list[str]) -> bool:
    """Call a method, and tell whether the adapter knows it: one with a list of methods of its own does not; see :func:`_knows`."""
    reply = await opcua.call("call_method", object=_METHODS, method=method, arguments=arguments)
    seen = reply.during(await opcua.journal())
    if _not_in_its_list(reply, seen, method):
        return False
    run.succeeds(reply, requirement="OUA-008", outputs=arguments, data_types=kinds)
    called = oracle.exactly_one_call(seen, _METHODS, method, arguments)
    run.witnessed(_about("OUA-008", called), oracle.called_with(seen, kinds))
    return True


def _wrong_arguments(number: int, text: str) -> list[tuple[str, list[Any]]]:
    return [
        (_MIX, [number]),
        (_MIX, [number, text, 1]),
        (_MIX, []),
        (_MIX, ["seven", text]),
        (_MIX, [number + 0.5, text]),
        (_MIX, [None, text]),
        (_MIX, [[number], text]),
        (_FLAGS, ["off", 1, 0.5]),
        (_FLAGS, [True, 256, 0.5]),
        (_NOTHING, [1]),
    ]


async def _numbers_in_texts(run: Repetition, opcua: Rig, number: int, text: str) -> None:
    """Give a number as a text: it is refused, or it is the number."""
    reply = await opcua.call("call_method", object=_METHODS, method=_MIX, arguments=[str(number), text])
    if reply.success:
        run.witnessed(oracle.called_with(reply.during(await opcua.journal()), ["Int32", "String"]))
    else:
        await refused_before_the_wire(run, opcua, reply, *_REFUSED, requirement="OUA-008")


async def _a_refused_argument_is_told(run: Repetition, opcua: Rig) -> None:
    """Call a method with a number that the server refuses; which argument it was should be told."""
    reply = await opcua.call("call_method", object=_METHODS, method=_RATE, arguments=[-1.0])
    run.fails(
        reply,
        "invalid_input",
        "illegal_value",
        outcome=("not_sent", "rejected"),
        requirement="OUA-008",
        code_requirement="ERR-003",
    )
    if (
        reply.native
        and reply.success is False
        and not any("BadOutOfRange" in str(leaf) for leaf in leaves(reply.envelope))
    ):
        message = f"{reply.label}: the server's status of the argument, BadOutOfRange, should be in the answer"
        run.judge(reply, [Finding(code="wrong_trace", message=message, requirement="OUA-008", strength="SHOULD")])


async def _writes_are_disabled(run: Repetition, opcua_ro: Rig, arguments: list[Any]) -> None:
    await opcua_ro.device.poke(nodes="methods")
    refused = await opcua_ro.call("call_method", object=_METHODS, method=_MIX, arguments=arguments)
    run.fails(refused, "writes_disabled", outcome="not_sent", requirement="OUA-008")
    if opcua_ro.subject.claims("read"):
        run.succeeds(await opcua_ro.call("read", node=_TEMPERATURE), requirement="OUA-008")
    run.witnessed(oracle.no_state_changing_service(await opcua_ro.journal(), requirement="OUA-008"))


async def _a_lost_answer_is_no_second_call(run: Repetition, opcua: Rig, arguments: list[Any]) -> None:
    await opcua.device.fault({"service": "Call", "times": 1, "action": {"close": True}})
    reply = await opcua.call("call_method", object=_METHODS, method=_MIX, arguments=arguments)
    run.fails(reply, *CONNECTION_FAULTS, outcome="unknown", requirement="OUA-008", code_requirement="ERR-005")
    await opcua.device.fault()
    replies = await opcua.call_until_success("read", window_s=opcua.subject.recovery_s, node=_TEMPERATURE)
    run.succeeds(replies[-1], requirement="REC-001")
    calls = [entry for entry in await opcua.journal() if entry["t_ns"] >= reply.exchange.sent_ns]
    run.witnessed(_about("OUA-008", oracle.exactly_one_call(calls, _METHODS, _MIX, arguments)))
