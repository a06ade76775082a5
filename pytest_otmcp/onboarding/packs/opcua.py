"""Words and experiments for tools that speak OPC UA."""

from __future__ import annotations

from ...protocols.opcua.oracle import children_of, folder_id, some_service
from ..evidence import lists_in
from ..experimenter import Experimenter
from ..guess import Guess
from ..pack import Hints, Pack, plain
from ..proposal import Proposal

__all__ = ["PACK"]

_VALVE = "ns=2;s=ValvePosition"
_MISSING_NODE = "ns=2;i=99999"
_NAMESPACE = "2:"
"""Prefix of the mock device's browse names when they are written with their namespace."""


async def _read(experimenter: Experimenter, guess: Guess) -> Proposal:
    value = round(experimenter.random.uniform(10.0, 90.0), 4)
    await experimenter.device.poke(node="Temperature", value=value)
    shown = await experimenter.call(guess, {}, node="ns=2;s=Temperature")
    seen = any(entry["kind"] == "Read" and "ns=2;s=Temperature" in str(entry) for entry in shown.entries)
    proposal = experimenter.propose(guess, shown, proven=seen, seen="a Read of the node" if seen else "")
    experimenter.locate(proposal, "value", value)
    if seen:
        await experimenter.provoke(proposal, "illegal_address", node=_MISSING_NODE)
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
    return proposal


async def _browse(experimenter: Experimenter, guess: Guess) -> Proposal:
    image = await experimenter.device.image()
    folder = folder_id(image, "Actuators")
    children = children_of(image, "Actuators")
    shown = await experimenter.call(guess, {}, node=folder)
    seen = any(entry["kind"] == "Browse" and folder in str(entry) for entry in shown.entries)
    proposal = experimenter.propose(guess, shown, proven=seen, seen="a Browse of the folder" if seen else "")
    _locate_all(proposal, "node_ids", set(children.values()))
    _locate_all(proposal, "browse_names", set(children))
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
        await experimenter.provoke(proposal, "type_mismatch", node=_VALVE, value="fully open")
    return proposal


async def _variables(experimenter: Experimenter, guess: Guess) -> Proposal:
    image = await experimenter.device.image()
    shown = await experimenter.call(guess, {})
    seen = not some_service(shown.entries)
    proposal = experimenter.propose(guess, shown, proven=seen, seen="services" if seen else "")
    _locate_all(proposal, "node_ids", set(image["variables"]))
    proposal.proven = proposal.proven and "node_ids" in proposal.outputs
    return proposal


def _locate_all(proposal: Proposal, output: str, expected: set[str]) -> None:
    """Look for a list of texts that the device is known to have given, in any order."""
    for form, rule, found in lists_in(proposal.good or {}, _NAMESPACE):
        if set(found) == expected:
            proposal.form = proposal.form or form
            if form == proposal.form:
                proposal.outputs[output] = rule
                proposal.evidence.append(f"{len(expected)} {output} of the device were found there")
                return
    proposal.evidence.append(f"the {output} of the device were not found in the answer: fill in 'result'")


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
            "write multiple nodes", r"(opcua_?)?write_?(multiple|many|batch)_?(opcua_?)?(nodes|values)?"
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
    errors={
        "illegal_address": (r"BadNodeIdUnknown|0x8034",),
        "type_mismatch": (r"BadTypeMismatch|[Tt]ype.?[Mm]ismatch|could not convert",),
    },
)
