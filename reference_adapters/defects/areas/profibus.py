"""Defects of a PROFIBUS DP adapter that the checks of the requirement suite notice."""

from __future__ import annotations

from functools import partial
from typing import Any

from ...core import AdapterServer
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..defect import Data, Defect, defect, told
from .enc import as_zero, by_way_of_float
from .further import cut_off, last_answer, merged, module_of

__all__ = ["DEFECTS"]

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


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-40pr",
        "profibus",
        "Of the inputs of a slave only the first byte is told, and zeros for the others.",
        told(_READ, change=_first_byte_only),
        "RD-001 RD-004",
    ),
    defect(
        "MU-20pw",
        "profibus",
        "With writes disabled outputs are written by an alias, and then denied.",
        guard_after_sending(_WRITE_ALIAS),
        "WR-004 WR-010",
        "ERR-006 WR-004",
    ),
    defect(
        "MU-08pa",
        "profibus",
        "Of a value that does not fit into an INT16 of the outputs the lower half is written.",
        _lower_bits,
        "ADR-003",
    ),
    defect(
        "MU-11pa",
        "profibus",
        "A text with a number in it is written to the outputs as the number.",
        _numbers_from_texts,
        "ADR-004",
    ),
    defect(
        "MU-06p",
        "profibus",
        "Of a station address the last 7 bits count.",
        cut_off(_WRITE, "slave_address", _ADDRESS_BITS),
        "ADR-002",
    ),
    defect(
        "MU-37p",
        "profibus",
        "Of several reads of inputs at the same time all are told what the last one has found.",
        last_answer(_READ),
        "CON-001",
    ),
    defect(
        "MU-41p",
        "profibus",
        "Of two values of the outputs at the same time only one is sent, and both are told as successes.",
        merged(_WRITE_ALIAS, lambda asked: asked.alias, _set),
        "CON-004",
    ),
    defect(
        "MU-56p", "profibus", "A FLOAT32 of the inputs that is NaN is 0.", told(_READ_ALIAS, change=as_zero), "ENC-004"
    ),
    defect(
        "MU-57p",
        "profibus",
        "A floating-point number of the inputs is rounded to one decimal.",
        told(_READ_ALIAS, change=_one_decimal),
        "ENC-003",
    ),
    defect(
        "MU-124p",
        "profibus",
        "started_at of a PROFIBUS answer is the local time with a Z behind it.",
        local_time,
        "ENC-003 ENC-004 ENC-005 ENC-007",
        "ENC-007",
    ),
    defect(
        "MU-58p",
        "profibus",
        "A UINT64 of the inputs above 2^53 is rounded.",
        told(_READ_ALIAS, change=by_way_of_float),
        "ENC-005",
    ),
    defect(
        "MU-35pb",
        "profibus",
        "While the device is gone, a read of the inputs of a slave succeeds with what was read before.",
        answers_from_memory_when_gone("read_inputs", silent=True),
        "REC-002 REC-003",
    ),
)
