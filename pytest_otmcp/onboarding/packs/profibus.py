"""Words and experiments for tools that speak PROFIBUS DP."""

from __future__ import annotations

import re

from ...protocols.profibus import calls
from ...protocols.profibus.points import DRIVE, VALVES, bytes_of, inputs_of, outputs_of
from ..experiments import reading, writing
from ..pack import Hints, Pack, plain
from ..status import reach

__all__ = ["PACK"]

_INPUTS, _OUTPUTS = inputs_of(DRIVE), outputs_of(VALVES)

_DIRECTLY = re.compile(r"^(address|direct|slave|station)$", re.IGNORECASE)
"""Names of the way in which a tool is told a slave by its address, beside an alias."""

_read_inputs = reading(lambda rng: _INPUTS.read(list(rng.randbytes(8))), calls.reached)
_write_outputs = writing(
    lambda rng: _OUTPUTS.write(bytes_of(rng, VALVES)),
    calls.one_write,
    refused=("limit_exceeded", _OUTPUTS.writes([1, 1, 1])),
)


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
