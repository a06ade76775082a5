"""Words and experiments for tools that speak EtherCAT."""

from __future__ import annotations

import re

from ...protocols.ethercat import calls
from ...protocols.ethercat.points import DRIVE, TERMINAL, TYPED, inputs_of, outputs_of
from ..experiments import reading, writing
from ..pack import Hints, Pack, plain
from ..status import reach

__all__ = ["PACK"]

_OBJECT, _INPUTS, _OUTPUTS = TYPED["UINT32"], inputs_of(DRIVE), outputs_of(TERMINAL)

_DIRECTLY = re.compile(r"^(address|direct|slave|position|index)$", re.IGNORECASE)
"""Names of the way in which a tool is told a place by itself, beside an alias."""

PACK = Pack(
    protocol="ethercat",
    operations={
        "ping": Hints(
            likely="ping status health connection probe info test",
            unlikely="read write list slave slaves alias scan sdo pdo esi state",
            needed="ping status health connection probe info check",
            experiment=reach,
        ),
        "read_sdo": Hints(
            likely="read get upload sdo coe object",
            unlikely="write set download pdo inputs alias list esi",
            needed="read get upload",
            experiment=reading(_OBJECT.any, calls.reached),
            choice=_DIRECTLY,
        ),
        "write_sdo": Hints(
            likely="write set download sdo coe object",
            unlikely="read get upload pdo outputs alias list esi state",
            needed="write set download",
            experiment=writing(
                lambda rng: _OBJECT.write(_OBJECT.kind.any(rng), before=0),
                calls.one_write,
                refused=("range_overflow", _OBJECT.writes(2**40)),
            ),
            choice=_DIRECTLY,
        ),
        "read_inputs": plain("pdo inputs", r"(read|get)_?(slave_?)?(pdo|inputs?|process_?data)"),
        "write_outputs": plain("pdo outputs", r"(write|set)_?(slave_?)?(pdo|outputs?|process_?data)"),
        "scan_network": plain("scan network", r"(scan|discover)_?(network|bus|line|slaves)"),
        "read_state": plain("state", r"(read|get)_?slave_?(state|info)"),
        "read_alias": plain("alias", r"(read|get)_?(slave_?by_?)?alias(_?value)?"),
        "write_alias": plain("alias", r"(write|set)_?(slave_?by_?)?alias(_?value)?"),
    },
    arguments={
        "slave": "slave_position slave position slave_index slave_number",
        "index": "index object_index",
        "subindex": "subindex sub_index sub",
        "type": "data_type type datatype",
        "value": "value",
        "data": "data outputs bytes values",
        "name": "alias alias_name name",
    },
    lists=frozenset({"data"}),
    names=("ethercat", "ether-cat", "ethercat-coe"),
)
