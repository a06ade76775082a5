"""Words and experiments for tools that speak S7comm."""

from __future__ import annotations

import re

from ...protocols.s7 import calls
from ...protocols.s7.points import of_bytes, value_at
from ..evidence import beyond
from ..experiments import reading, writing
from ..pack import Hints, Pack, plain
from ..status import reach

__all__ = ["PACK"]

_VALUES = range(2000, 0x8000)
"""Values that cannot be mistaken for an offset, a size or a default."""
_BYTES, _INT = of_bytes(44, 6), value_at(44)

_BLOCKS = re.compile(r"^(db|data_?blocks?)$", re.IGNORECASE)
"""Names of the area of the data blocks, where a tool has several."""

_read_db = reading(lambda rng: _BYTES.read(list(rng.randbytes(6))), calls.reached)
_read_typed = reading(lambda rng: _INT.read(rng.choice(_VALUES)), calls.reached, missing=value_at(0, db=99).reads())
_write_db = writing(
    lambda rng: _INT.write(rng.choice(_VALUES)), calls.one_write, refused=("range_overflow", _INT.writes(70000))
)


PACK = Pack(
    protocol="s7",
    operations={
        "ping": Hints(
            likely="ping status health connection probe info",
            unlikely="read write list job template connect disconnect reconnect command tag state time szl",
            needed="ping status health connection probe info check",
            experiment=reach,
        ),
        "read_db": Hints(
            likely="read get db data block bytes",
            unlikely="write set typed input output marker tag szl state time info multiple",
            needed="read get",
            experiment=_read_db,
            choice=_BLOCKS,
        ),
        "read_typed": Hints(
            likely="read get db typed value",
            unlikely="write set input output marker tag szl state time info multiple",
            needed="read get",
            experiment=_read_typed,
            choice=re.compile(r"typed", re.IGNORECASE),
        ),
        "write_db": Hints(
            likely="write set db value",
            unlikely="read get input output marker tag state time multiple",
            needed="write set",
            experiment=_write_db,
            choice=_BLOCKS,
        ),
        "write_marker": plain("marker flag bit", r"write_?(marker|flag|memory)_?bit"),
        "read_cpu_state": plain("cpu state", r"(read|get)_?(plc|cpu)_?(state|status|mode)"),
        "set_cpu_state": plain("cpu state", r"set_?(plc|cpu)_?(state|mode)"),
    },
    arguments={
        "db": "db_number db dbnumber db_num block",
        "start": "start_offset start offset byte start_byte address byte_offset",
        "size": "size length count num_bytes",
        "type": "data_type type datatype dtype",
        "byte": "start_byte byte byte_offset offset",
        "bit": "bit_index bit bit_offset",
        "state": "state mode",
    },
    lists=frozenset(),
    constants={r"^rack$": 0, r"^slot$": 1},
    names=("s7", "s7comm", "snap7"),
    errors={
        "illegal_address": (
            r"(?i)object does not exist|item not available|invalid address|address out of range|0x0a\b|0x05\b",
        ),
        "range_overflow": (beyond("does not fit", "value overflow", "format requires"),),
    },
)
