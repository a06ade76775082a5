"""Defects of EtherCAT adapters that the checks of the requirement suite notice."""

from __future__ import annotations

from functools import partial
from typing import Any

from ...core import AdapterServer
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..defect import Data, Defect, around, defect, told, tools_of
from .enc import as_zero, by_way_of_float
from .further import beginning, cut_off, last_answer, merged, module_of, reencoded, stripped

__all__ = ["DEFECTS"]

_READ, _WRITE, _INPUTS, _WRITE_ALIAS = "read_sdo", "write_sdo", "read_pdo", "write_slave_by_alias"
_INDEX_BITS = 16

_module = partial(module_of, "ethercat")


def _others_are_zero(server: AdapterServer) -> None:
    tools = tools_of(server, _WRITE_ALIAS)
    genuine, size = tools._drive, 8

    async def drive(call: Any, position: int, data: bytes, offset: int | None) -> Any:
        before = bytes(offset or 0)
        return await genuine(call, position, (before + data).ljust(size, b"\0"), None)

    tools._drive = drive


def _of_the_first_exchange(server: AdapterServer) -> None:
    known: dict[int, Data] = {}

    @around(_INPUTS)
    async def remembered(genuine: Any, call: Any, arguments: Any) -> Data:
        if arguments.slave_position not in known:
            known[arguments.slave_position] = await genuine(call, arguments)
        return known[arguments.slave_position]

    remembered(server)


def _first_byte_only(data: Data) -> Data:
    return {**data, "bytes": data["bytes"][:1] + [0] * (len(data["bytes"]) - 1)}


def _written(arguments: Any) -> Data:
    content = _module("codec").encode(arguments.value, arguments.data_type)
    place = {"slave_position": arguments.slave_position, "index": arguments.index, "subindex": arguments.subindex}
    return {**place, **_module("codec").decode(content, arguments.data_type)}


def _number(value: Any, kind: str) -> Any:
    return float(value) if isinstance(value, str) and kind != "STRING" and value[:1].isdecimal() else value


def _lower_half(value: Any, kind: str) -> Any:
    return value & 0xFFFF if kind == "UINT16" and type(value) is int else value


def _one_decimal(data: Data) -> Data:
    value = data["value"]
    return {**data, "value": round(value, 1) if isinstance(value, float) else value}


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-02eca",
        "ethercat",
        "Outputs by an alias set all other outputs of the slave to 0.",
        _others_are_zero,
        "WR-002",
    ),
    defect(
        "MU-06eca",
        "ethercat",
        "Of an index the last 16 bits count.",
        cut_off(_READ, "index", _INDEX_BITS),
        "ADR-002",
    ),
    defect(
        "MU-08eca",
        "ethercat",
        "Of a value that does not fit into a UINT16 the lower half is written.",
        reencoded("ethercat", _lower_half),
        "ADR-003",
    ),
    defect(
        "MU-11eca",
        "ethercat",
        "A text with a number in it is written as the number.",
        reencoded("ethercat", _number),
        "ADR-004",
    ),
    defect(
        "MU-20eca",
        "ethercat",
        "With writes disabled outputs are written by an alias, and then denied.",
        guard_after_sending(_WRITE_ALIAS),
        "WR-004",
    ),
    defect(
        "MU-35eca",
        "ethercat",
        "While the slaves are gone, a read of an object succeeds with what was read before.",
        answers_from_memory_when_gone(_READ, silent=True),
        "REC-002",
    ),
    defect(
        "MU-36ec",
        "ethercat",
        "Inputs are those of the first exchange: nobody asks for later ones.",
        _of_the_first_exchange,
        "RD-001",
    ),
    defect(
        "MU-37eca",
        "ethercat",
        "Of several reads of objects at the same time all are told what the last one has found.",
        last_answer(_READ),
        "CON-001",
    ),
    defect(
        "MU-40eca",
        "ethercat",
        "Of inputs only the first byte is told, and zeros for the others.",
        told(_INPUTS, change=_first_byte_only),
        "RD-001",
    ),
    defect(
        "MU-41ec",
        "ethercat",
        "Of two writes of an object at the same time only one is sent, and both are told as successes.",
        merged(_WRITE, lambda asked: (asked.slave_position, asked.index, asked.subindex), _written),
        "CON-004",
    ),
    defect("MU-56ec", "ethercat", "A FLOAT32 that is NaN is 0.", told(_READ, change=as_zero), "ENC-004"),
    defect(
        "MU-57ec",
        "ethercat",
        "A floating-point number is rounded to one decimal when it is read.",
        told(_READ, change=_one_decimal),
        "ENC-003",
    ),
    defect("MU-58ec", "ethercat", "A UINT64 above 2^53 is rounded.", told(_READ, change=by_way_of_float), "ENC-005"),
    defect(
        "MU-123ec", "ethercat", "A text is read without the spaces around it.", told(_READ, change=stripped), "ENC-006"
    ),
    defect(
        "MU-123ecl",
        "ethercat",
        "Of a text the first 20 characters are read.",
        told(_READ, change=beginning),
        "ENC-006",
    ),
    defect(
        "MU-124ec",
        "ethercat",
        "started_at of an EtherCAT answer is the local time with a Z behind it.",
        local_time,
        "ENC-003 ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
    ),
)
