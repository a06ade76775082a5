"""Words and experiments for tools that speak PROFINET IO."""

from __future__ import annotations

import re

from ...protocols.profinet import calls
from ...protocols.profinet.points import DRIVE, PUMP, VALVES, bytes_of, inputs_of, outputs_of, record_of
from ..experiments import reading, writing
from ..pack import Hints, Pack, plain
from ..status import reach

__all__ = ["PACK"]

_INPUTS, _OUTPUTS, _RECORD = inputs_of(DRIVE), outputs_of(PUMP), record_of(VALVES)

_DIRECTLY = re.compile(r"^(name|direct|device|station)$", re.IGNORECASE)
"""Names of the way in which a tool is told a station by its name, beside an alias."""

_read_inputs = reading(lambda rng: _INPUTS.read(list(rng.randbytes(8))), calls.reached)
_read_record = reading(lambda rng: _RECORD.read(list(rng.randbytes(2))), calls.reached)
_write_outputs = writing(
    lambda rng: _OUTPUTS.write(bytes_of(rng, PUMP)),
    calls.one_write,
    refused=("limit_exceeded", _OUTPUTS.writes([1, 1, 1])),
)
_write_record = writing(
    lambda rng: _RECORD.write(bytes_of(rng, VALVES)),
    calls.one_write,
    refused=("type_mismatch", _RECORD.writes([1, 1, 1])),
)


PACK = Pack(
    protocol="profinet",
    operations={
        "ping": Hints(
            likely="ping status health connection probe info test",
            unlikely="read write list device devices alias scan discover outputs inputs gsd name",
            needed="ping status health connection probe info check",
            experiment=reach,
        ),
        "read_inputs": Hints(
            likely="read get io inputs input data",
            unlikely="write set output outputs alias record parameter list status gsd name",
            needed="read get",
            experiment=_read_inputs,
            choice=_DIRECTLY,
        ),
        "write_outputs": Hints(
            likely="write set io outputs output data",
            unlikely="read get alias record parameter list gsd name ip",
            needed="write set",
            experiment=_write_outputs,
            choice=_DIRECTLY,
        ),
        "read_record": plain("record parameter", r"(read|get)_?(record|parameter)(_?data)?", _read_record),
        "write_record": plain("record parameter", r"(write|set)_?(record|parameter)(_?data)?", _write_record),
        "discover": plain("discover", r"(discover|scan|identify_all)_?(devices|stations|network)?"),
        "set_name": plain("name", r"set_?(device_?|station_?)?name(_?of_?station)?"),
        "identify": plain("identify", r"(identify|flash|blink|signal)_?(device|station|led)?"),
        "read_alias": plain("alias", r"(read|get)_?(device_?by_?)?alias(_?value)?"),
        "write_alias": plain("alias", r"(write|set)_?(device_?by_?)?alias(_?value)?"),
    },
    arguments={
        "station": "device_name station station_name device name_of_station name",
        "slot": "slot slot_number",
        "subslot": "subslot subslot_number",
        "index": "index record_index record",
        "data": "data outputs bytes values",
        "name": "alias alias_name name",
        "mac": "device_mac mac mac_address",
        "seconds": "duration_s duration seconds",
    },
    lists=frozenset({"data"}),
    names=("profinet", "profinet-io", "profinet_io"),
    errors={
        "limit_exceeded": (r"(?i)bytes of outputs?|output length|(outputs|data|bytes)\b.{0,20}too (long|many)",),
    },
)
