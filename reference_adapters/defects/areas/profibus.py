"""Defects of a PROFIBUS DP adapter that the checks of the requirement suite notice."""

from __future__ import annotations

from functools import partial
from typing import Any

from ...core import AdapterServer
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..mutant import Data, Mutant, told
from .enc import as_zero, by_way_of_float
from .further import cut_off, declared, last_answer, merged, module_of

__all__ = ["MUTANTS"]

_READ, _WRITE, _READ_ALIAS, _WRITE_ALIAS = "read_inputs", "write_outputs", "read_slave_by_alias", "write_slave_by_alias"
_ADDRESS_BITS = 7

_module = partial(module_of, "profibus")


def _lower_bits(server: AdapterServer) -> None:
    tools = _module("tools")
    encode = tools.encode

    def fitting(value: Any, kind: str) -> bytes:
        whole = kind == "INT16" and type(value) is int
        content: bytes = encode((value + 0x8000) % 0x10000 - 0x8000 if whole else value, kind)
        return content

    tools.encode = fitting


def _numbers_from_texts(server: AdapterServer) -> None:
    tools = _module("tools")
    encode = tools.encode

    def lenient(value: Any, kind: str) -> bytes:
        is_number = isinstance(value, str) and value[:1].isdecimal()
        content: bytes = encode(float(value) if is_number else value, kind)
        return content

    tools.encode = lenient


def _set(arguments: Any) -> Data:
    codec = _module("codec")
    shown: Data = codec.decode(codec.encode(arguments.value, "INT16"), "INT16")
    return {"alias": arguments.alias, "slave_address": 8, "unit": None, **shown}


def _first_byte_only(data: Data) -> Data:
    return {**data, "bytes": data["bytes"][:1] + [0] * (len(data["bytes"]) - 1)}


def _one_decimal(data: Data) -> Data:
    value = data["value"]
    return {**data, "value": round(value, 1) if isinstance(value, float) else value}


_mutant = partial(declared, "profibus")

MUTANTS: tuple[Mutant, ...] = (
    _mutant(
        "MU-40pr",
        "rd",
        "RD-001 RD-004",
        "RD-001 RD-004",
        told(_READ, change=_first_byte_only),
        "Of the inputs of a slave only the first byte is told, and zeros for the others.",
    ),
    _mutant(
        "MU-20pw",
        "wr",
        "WR-004 WR-010",
        "ERR-006 WR-004",
        guard_after_sending(_WRITE_ALIAS),
        "With writes disabled outputs are written by an alias, and then denied.",
    ),
    _mutant(
        "MU-08pa",
        "adr",
        "ADR-003",
        "ADR-003",
        _lower_bits,
        "Of a value that does not fit into an INT16 of the outputs the lower half is written.",
    ),
    _mutant(
        "MU-11pa",
        "adr",
        "ADR-004",
        "ADR-004",
        _numbers_from_texts,
        "A text with a number in it is written to the outputs as the number.",
    ),
    _mutant(
        "MU-06p",
        "adr",
        "ADR-002",
        "ADR-002",
        cut_off(_WRITE, "slave_address", _ADDRESS_BITS),
        "Of a station address the last 7 bits count.",
    ),
    _mutant(
        "MU-37p",
        "con",
        "CON-001",
        "CON-001",
        last_answer(_READ),
        "Of several reads of inputs at the same time all are told what the last one has found.",
    ),
    _mutant(
        "MU-41p",
        "con",
        "CON-004",
        "CON-004",
        merged(_WRITE_ALIAS, lambda asked: asked.alias, _set),
        "Of two values of the outputs at the same time only one is sent, and both are told as successes.",
    ),
    _mutant(
        "MU-56p",
        "enc",
        "ENC-004",
        "ENC-004",
        told(_READ_ALIAS, change=as_zero),
        "A FLOAT32 of the inputs that is NaN is 0.",
    ),
    _mutant(
        "MU-57p",
        "enc",
        "ENC-003",
        "ENC-003",
        told(_READ_ALIAS, change=_one_decimal),
        "A floating-point number of the inputs is rounded to one decimal.",
    ),
    _mutant(
        "MU-124p",
        "enc",
        "ENC-003 ENC-004 ENC-005 ENC-007",
        "ENC-007",
        local_time,
        "started_at of a PROFIBUS answer is the local time with a Z behind it.",
    ),
    _mutant(
        "MU-58p",
        "enc",
        "ENC-005",
        "ENC-005",
        told(_READ_ALIAS, change=by_way_of_float),
        "A UINT64 of the inputs above 2^53 is rounded.",
    ),
    _mutant(
        "MU-35pb",
        "rec",
        "REC-002 REC-003",
        "REC-002 REC-003",
        answers_from_memory_when_gone("read_inputs", silent=True),
        "While the device is gone, a read of the inputs of a slave succeeds with what was read before.",
    ),
)
