"""Words and experiments for tools that speak OPC UA."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

from ...protocols.exercise import Asked
from ...protocols.journal import JournalEntry
from ...protocols.opcua.entries import as_opcua
from ...protocols.opcua.oracle import children_of, folder_id, some_service
from ..evidence import Sample, lists_in
from ..experimenter import Experimenter
from ..experiments import every_write
from ..guess import Guess
from ..pack import Hints, Pack, plain
from ..proposal import Proposal, Shown

__all__ = ["PACK"]

_VALVE, _SENSOR = "ns=2;s=ValvePosition", "ns=2;s=Temperature"
"""A variable that may be written, and one that may not."""
_MISSING_NODE = "ns=2;i=99999"
_BAD = "Bad"
"""How the names of status codes begin that say of a failure (OPC 10000-4, section 7.39)."""
_NAMESPACE = "2:"
"""Prefix of the mock device's browse names when they are written with their namespace (OPC 10000-6, section 5.1.12)."""


async def _read(experimenter: Experimenter, guess: Guess) -> Proposal:
    value = round(experimenter.random.uniform(10.0, 90.0), 4)
    await experimenter.device.poke(node="Temperature", value=value)
    shown = await experimenter.call(guess, {}, node="ns=2;s=Temperature")
    seen = any(entry["kind"] == "Read" and "ns=2;s=Temperature" in str(entry) for entry in shown.entries)
    proposal = experimenter.propose(guess, shown, proven=seen, seen="a Read of the node" if seen else "")
    experimenter.locate(proposal, "value", value)
    if seen:
        experimenter.provoke(proposal, "illegal_address", node=_MISSING_NODE)
    return proposal


async def _read_many(experimenter: Experimenter, guess: Guess) -> Proposal:
    values = [round(experimenter.random.uniform(10.0, 90.0), 4) for _ in range(2)]
    names = ("Temperature", "Pressure")
    for name, value in zip(names, values, strict=True):
        await experimenter.device.poke(node=name, value=value)
    shown = await experimenter.call(guess, {}, nodes=[f"ns=2;s={name}" for name in names])
    seen = all(any(f"ns=2;s={name}" in str(entry) for entry in shown.entries) for name in names)
    proposal = experimenter.propose(guess, shown, proven=seen, seen="a Read of both nodes" if seen else "")
    experimenter.locate(proposal, "values", values)
    if seen:
        experimenter.provoke(proposal, "illegal_address", nodes=["ns=2;s=Temperature", _MISSING_NODE])
    return proposal


def _samples(rng: random.Random) -> tuple[Asked, ...]:
    """Return reads of nodes of several types, in a random order; the nodes are added by their pokes."""
    moment = datetime(2020, 1, 1, tzinfo=UTC) + timedelta(milliseconds=rng.randrange(10**11))
    held: dict[str, list[Any]] = {
        "Boolean": [True, False],
        "Double": [-round(rng.uniform(1.0, 99.0), 4)],
        "Int32": [-rng.randrange(1000, 2**31)],
        # No floating-point number holds it.
        "UInt64": [2**53 + 2 * rng.randrange(2**40) + 1],
        # A text may begin and end with blanks.
        "String": [f"  init {rng.getrandbits(32):08x}, of two words "],
        "DateTime": [moment.isoformat(timespec="milliseconds")],
        "Int32.Vector": [[rng.randrange(-(2**31), 2**31) for _ in range(3)]],
    }
    nodes = [
        {"variable": f"Otmcp.{kind}.{rng.getrandbits(32):08x}", "type": kind.partition(".")[0], "value": value}
        for kind, values in held.items()
        for value in values
    ]
    mixed = rng.sample(nodes[:4], 3)
    return (
        *(
            Asked(
                operation="read",
                inputs={"node": f"ns=2;s={node['variable']}"},
                outputs={"value": node["value"]},
                pokes=({"create": [node]},),
            )
            for node in nodes
        ),
        Asked(
            operation="read_many",
            inputs={"nodes": [f"ns=2;s={node['variable']}" for node in mixed]},
            outputs={"values": [node["value"] for node in mixed]},
            pokes=({"create": mixed},),
        ),
    )


async def _browse(experimenter: Experimenter, guess: Guess) -> Proposal:
    image = await experimenter.device.image()
    first, other = [
        (await experimenter.call(guess, {}, node=folder_id(image, name)), children_of(image, name))
        for name in ("Actuators", "Sensors")
    ]
    folder, (shown, children) = folder_id(image, "Actuators"), first
    seen = any(entry["kind"] == "Browse" and folder in str(entry) for entry in shown.entries)
    proposal = experimenter.propose(guess, shown, proven=seen, seen="a Browse of the folder" if seen else "")
    _locate_all(proposal, "node_ids", set(children.values()), other=(other[0], set(other[1].values())))
    _locate_all(proposal, "browse_names", set(children), other=(other[0], set(other[1])))
    return proposal


async def _write(experimenter: Experimenter, guess: Guess) -> Proposal:
    value = round(experimenter.random.uniform(10.0, 90.0), 2)
    shown = await experimenter.call(guess, {}, node=_VALVE, value=value)
    image = await experimenter.device.image()
    seen = any(entry["kind"] == "Write" and _VALVE in str(entry) for entry in shown.entries)
    proven = seen and str(value) in str(image)
    proposal = experimenter.propose(guess, shown, proven=proven, seen="a Write, and holds the value" if proven else "")
    if proven:
        experimenter.locate_echo(proposal, "value", value)
        experimenter.provoke(proposal, "type_mismatch", node=_VALVE, value="fully open")
        experimenter.provoke(proposal, "not_writable", node=_SENSOR, value=value)
    return proposal


async def _write_many(experimenter: Experimenter, guess: Guess) -> Proposal:
    proposal = await every_write("write_many")(experimenter, guess)
    if not proposal.proven:
        return proposal
    value = round(experimenter.random.uniform(10.0, 90.0), 2)
    items = [{"node_id": node, "value": value} for node in (_VALVE, _SENSOR)]
    shown = await experimenter.call(guess, proposal.offset, items=items)
    for form, rule, found in lists_in(shown.message or {}, shown.told):
        if [_BAD in status for status in found] == [False, True]:
            proposal.form, proposal.outputs["statuses"] = form, rule
            proposal.evidence.append("of two writes it said by 'statuses' which one the device refused")
            return proposal
    if shown.message is not None:
        proposal.failures.append(("not_writable", shown.message))
    return proposal


async def _variables(experimenter: Experimenter, guess: Guess) -> Proposal:
    image = await experimenter.device.image()
    shown = await experimenter.call(guess, {})
    seen = not some_service(shown.entries)
    proposal = experimenter.propose(guess, shown, proven=seen, seen="services" if seen else "")
    _locate_all(proposal, "node_ids", set(image["variables"]))
    proposal.proven = proposal.proven and "node_ids" in proposal.outputs
    return proposal


def _locate_all(
    proposal: Proposal, output: str, expected: set[str], *, other: tuple[Shown, set[str]] | None = None
) -> None:
    """Look for a list of texts that the device is known to have given, in any order.

    Args:
        other: what another call showed, and the texts that have to be at the same place in its answer.
    """
    for form, rule, found in lists_in(proposal.good or {}, proposal.told):
        if _plain(found) == expected and (other is None or _is_there(form, rule, *other)):
            proposal.form = proposal.form or form
            if form == proposal.form:
                proposal.outputs[output] = rule
                proposal.evidence.append(f"{len(expected)} {output} of the device were found there")
                return
    proposal.evidence.append(f"the {output} of the device were not found in the answer: fill in 'result'")


def _is_there(form: str, rule: Mapping[str, object], shown: Shown, expected: set[str]) -> bool:
    found = Sample(message=shown.message or {}, expected=None, told=shown.told).read(form, rule)
    return isinstance(found, list) and _plain(found) == expected


def _plain(names: Iterable[object]) -> set[str]:
    return {str(name).removeprefix(_NAMESPACE) for name in names}


def _told(entry: JournalEntry) -> tuple[str, dict[str, object]] | None:
    nodes = as_opcua(entry).get("nodes", [])
    if entry["kind"] != "Write" or len(nodes) != 1 or nodes[0]["attribute"] != "Value":
        return None
    return "write", {"node": nodes[0]["node_id"], "value": nodes[0]["value"]}


def _sources(entry: JournalEntry) -> list[tuple[str, dict[str, object]]]:
    nodes = as_opcua(entry).get("nodes", []) if entry["kind"] == "Read" and entry["request"] else []
    return [("read", {"node": node["node_id"]}) for node in nodes if node["attribute"] == "Value"]


PACK = Pack(
    protocol="opcua",
    operations={
        "read": Hints(
            likely="read get node value variable",
            unlikely="write history event events browse call subscribe",
            needed="read get",
            experiment=_read,
        ),
        "read_many": Hints(
            likely="read get nodes multiple values many batch",
            unlikely="write history event events browse call subscribe alarms",
            needed="read get",
            experiment=_read_many,
        ),
        "browse": Hints(
            likely="browse children list node nodes",
            unlikely="read write call subscribe history variables",
            needed="browse children list",
            experiment=_browse,
        ),
        "write": Hints(
            likely="write set node nodes value",
            unlikely="read history call subscribe",
            needed="write set",
            experiment=_write,
        ),
        "variables": Hints(
            likely="all variables enumerate list tree",
            unlikely="read write call subscribe history multiple",
            needed="all variables variable enumerate",
            experiment=_variables,
        ),
        "write_many": plain(
            "write multiple nodes",
            r"(opcua_?)?write_?(multiple|many|batch)_?(opcua_?)?(nodes|values)?",
            _write_many,
        ),
        "call_method": plain("call method", r"(opcua_?)?call_?(opcua_?)?method"),
    },
    arguments={
        "node": "node_id nodeid node id node_ids nodes address",
        "nodes": "node_ids nodes nodeids ids",
        "items": "items nodes_to_write writes",
        "object": "object_id object object_node_id parent_id",
        "method": "method_id method method_node_id",
        "arguments": "arguments input_arguments args inputs",
    },
    lists=frozenset({"nodes", "items", "arguments"}),
    names=("opcua", "opc-ua", "opc_ua"),
    told=_told,
    sources=_sources,
    samples=_samples,
    errors={
        "illegal_address": (r"BadNodeIdUnknown|0x8034",),
        "not_writable": (r"BadNotWritable|0x803B",),
        "type_mismatch": (r"BadTypeMismatch|[Tt]ype.?[Mm]ismatch|could not convert",),
    },
)
