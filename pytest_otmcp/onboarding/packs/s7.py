"""Words and experiments for tools that speak S7comm."""

from __future__ import annotations

import re

from ...protocols.s7 import oracle
from ..evidence import beyond
from ..experimenter import Experimenter
from ..guess import Guess
from ..pack import Hints, Pack, plain
from ..proposal import Proposal
from ..status import reach

__all__ = ["PACK"]

_BLOCK, _MISSING_BLOCK = 10, 99
_PLACE = 44
_VALUES = range(2000, 0x8000)
"""Values that cannot be mistaken for an offset, a size or a default."""

_BLOCKS = re.compile(r"^(db|data_?blocks?)$", re.IGNORECASE)
"""Names of the area of the data blocks, where a tool has several."""


async def _read_db(experimenter: Experimenter, guess: Guess) -> Proposal:
    content = experimenter.random.randbytes(6)
    await experimenter.device.poke(area=f"DB{_BLOCK}", byte=_PLACE, data=content.hex())
    shown = await experimenter.call(guess, {}, db=_BLOCK, start=_PLACE, size=len(content))
    proven = oracle.reached(shown.entries, db=_BLOCK, start=_PLACE, size=len(content))
    proposal = experimenter.propose(guess, shown, proven=proven)
    experimenter.locate(proposal, "values", list(content))
    return proposal


async def _read_typed(experimenter: Experimenter, guess: Guess) -> Proposal:
    value = experimenter.random.choice(_VALUES)
    await experimenter.device.poke(area=f"DB{_BLOCK}", byte=_PLACE, data=value.to_bytes(2, "big").hex())
    shown = await experimenter.call(guess, {}, db=_BLOCK, start=_PLACE, type="INT")
    proven = oracle.reached(shown.entries, db=_BLOCK, start=_PLACE, size=2)
    proposal = experimenter.propose(guess, shown, proven=proven)
    experimenter.locate(proposal, "value", value)
    if proven:
        experimenter.provoke(proposal, "illegal_address", db=_MISSING_BLOCK, start=0, type="INT")
    return proposal


async def _write_db(experimenter: Experimenter, guess: Guess) -> Proposal:
    value = experimenter.random.choice(_VALUES)
    shown = await experimenter.call(guess, {}, db=_BLOCK, start=_PLACE, type="INT", value=value)
    written = value.to_bytes(2, "big")
    proven = not oracle.exactly_one_write(shown.entries, db=_BLOCK, start=_PLACE, written=written)
    proposal = experimenter.propose(guess, shown, proven=proven)
    if proven:
        experimenter.locate_echo(proposal, "value", value)
        experimenter.provoke(proposal, "range_overflow", db=_BLOCK, start=_PLACE, type="INT", value=70000)
    return proposal


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
