"""Words and experiments for tools that speak PROFIBUS DP."""

from __future__ import annotations

import re

from ...protocols.profibus import oracle
from ..experimenter import Experimenter
from ..guess import Guess
from ..pack import Hints, Pack, plain
from ..proposal import Proposal
from ..status import reach

__all__ = ["PACK"]

_DRIVE, _DRIVE_INPUTS = 8, 8
_VALVES, _VALVE_OUTPUTS = 5, 2
"""Addresses of slaves, and how many bytes of inputs or outputs each has."""

_DIRECTLY = re.compile(r"^(address|direct|slave|station)$", re.IGNORECASE)
"""Names of the way in which a tool is told a slave by its address, beside an alias."""


async def _read_inputs(experimenter: Experimenter, guess: Guess) -> Proposal:
    content = experimenter.random.randbytes(_DRIVE_INPUTS)
    await experimenter.device.poke(station=_DRIVE, inputs=content.hex())
    shown = await experimenter.call(guess, {}, slave=_DRIVE)
    proven = not oracle.inputs_were_read(shown.entries, station=_DRIVE)
    proposal = experimenter.propose(guess, shown, proven=proven)
    experimenter.locate(proposal, "values", list(content))
    return proposal


async def _write_outputs(experimenter: Experimenter, guess: Guess) -> Proposal:
    content = bytes(experimenter.random.randrange(1, 0x100) for _ in range(_VALVE_OUTPUTS))
    shown = await experimenter.call(guess, {}, slave=_VALVES, data=list(content))
    proven = not oracle.exactly_one_write(shown.entries, station=_VALVES, outputs=content)
    proposal = experimenter.propose(guess, shown, proven=proven)
    if proven:
        experimenter.locate_echo(proposal, "values", list(content))
        experimenter.provoke(proposal, "limit_exceeded", slave=_VALVES, data=[1] * (_VALVE_OUTPUTS + 1))
    return proposal


PACK = Pack(
    protocol="profibus",
    operations={
        "ping": Hints(
            likely="ping status health connection probe info test",
            unlikely="read write list slave slaves alias scan diagnosis outputs inputs gsd",
            needed="ping status health connection probe info check",
            experiment=reach,
        ),
        "read_inputs": Hints(
            likely="read get inputs input slave data",
            unlikely="write set output outputs alias diagnosis diagnostics list status gsd",
            needed="read get",
            experiment=_read_inputs,
            choice=_DIRECTLY,
        ),
        "write_outputs": Hints(
            likely="write set outputs output slave data",
            unlikely="read get alias list gsd",
            needed="write set",
            experiment=_write_outputs,
            choice=_DIRECTLY,
        ),
        "scan_bus": plain("scan bus", r"(scan|discover)_?(bus|line|slaves|stations)"),
        "read_diagnosis": plain("diagnosis", r"(read|get)_?(slave_?)?diag(nosis|nostics?)?"),
        "read_alias": plain("alias", r"(read|get)_?(slave_?by_?)?alias(_?value)?"),
        "write_alias": plain("alias", r"(write|set)_?(slave_?by_?)?alias(_?value)?"),
    },
    arguments={
        "slave": "slave_address slave station station_address address",
        "data": "data outputs bytes values",
        "name": "alias alias_name name",
    },
    lists=frozenset({"data"}),
    names=("profibus", "profibus-dp", "profibus_dp"),
    errors={
        "limit_exceeded": (r"(?i)bytes of outputs?|output length|(outputs|data|bytes)\b.{0,20}too (long|many)",),
    },
)
