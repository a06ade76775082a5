"""Defects of adapters for process data, of PROFIBUS and PROFINET, that the checks of the requirement suite notice."""

from __future__ import annotations

from functools import partial
from typing import Any

from ...core import AdapterServer, process_data
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..defect import Data, Defect, defect, told
from .enc import as_zero, by_way_of_float
from .further import cut_off, last_answer, merged, module_of

__all__ = ["DEFECTS"]

_READ_ALIAS, _WRITE_ALIAS = "read_{}_by_alias", "write_{}_by_alias"


def _lower_bits(protocol: str, server: AdapterServer) -> None:
    tools = module_of(protocol, "tools")
    encode = tools.encode

    def fitting(value: Any, kind: str) -> bytes:
        whole = kind == "INT16" and type(value) is int
        content: bytes = encode((value + 0x8000) % 0x10000 - 0x8000 if whole else value, kind)
        return content

    tools.encode = fitting


def _numbers_from_texts(protocol: str, server: AdapterServer) -> None:
    tools = module_of(protocol, "tools")
    encode = tools.encode

    def lenient(value: Any, kind: str) -> bytes:
        is_number = isinstance(value, str) and value[:1].isdecimal()
        content: bytes = encode(float(value) if is_number else value, kind)
        return content

    tools.encode = lenient


def _set(place: Data, arguments: Any) -> Data:
    shown: Data = process_data.decode(process_data.encode(arguments.value, "INT16"), "INT16")
    return {"alias": arguments.alias, **place, "unit": None, **shown}


def _first_byte_only(data: Data) -> Data:
    return {**data, "bytes": data["bytes"][:1] + [0] * (len(data["bytes"]) - 1)}


def _one_decimal(data: Data) -> Data:
    value = data["value"]
    return {**data, "value": round(value, 1) if isinstance(value, float) else value}


def _of(
    protocol: str,
    letter: str,
    *,
    read: str,
    write: str,
    called: str,
    place: Data,
    argument: str,
    bits: int,
    what: str,
    gone: str,
) -> tuple[Defect, ...]:
    """Return the defects of the adapter for a protocol.

    Args:
        letter: behind the numbers of these defects.
        read, write: tools for inputs, and for what is written as bytes.
        called: what the tools by alias call a station.
        place: what an alias's value says of its place.
        argument, bits: of the write: a number, and so many bits of it.
        what: that number is.
        gone: rows that notice an answer from memory while the device is gone. An adapter that asks twice in a call loses one question alone to REC-003.
    """
    read_alias, write_alias = _READ_ALIAS.format(called), _WRITE_ALIAS.format(called)
    return (
        defect(
            f"MU-40{letter}r",
            protocol,
            "Of inputs only the first byte is told, and zeros for the others.",
            told(read, change=_first_byte_only),
            "RD-001 RD-004",
        ),
        defect(
            f"MU-20{letter}w",
            protocol,
            "With writes disabled a value is written by an alias, and then denied.",
            guard_after_sending(write_alias),
            "WR-004 WR-010",
            "ERR-006 WR-004",
        ),
        defect(
            f"MU-08{letter}a",
            protocol,
            "Of a value that does not fit into an INT16 the lower half is written.",
            partial(_lower_bits, protocol),
            "ADR-003",
        ),
        defect(
            f"MU-11{letter}a",
            protocol,
            "A text with a number in it is written as the number.",
            partial(_numbers_from_texts, protocol),
            "ADR-004",
        ),
        defect(
            f"MU-06{letter}",
            protocol,
            f"Of {what} the last {bits} bits count.",
            cut_off(write, argument, bits),
            "ADR-002",
        ),
        defect(
            f"MU-37{letter}",
            protocol,
            "Of several reads of inputs at the same time all are told what the last one has found.",
            last_answer(read),
            "CON-001",
        ),
        defect(
            f"MU-41{letter}",
            protocol,
            "Of two values for an alias at the same time only one is sent, and both are told as successes.",
            merged(write_alias, lambda asked: asked.alias, partial(_set, place)),
            "CON-004",
        ),
        defect(
            f"MU-56{letter}",
            protocol,
            "A FLOAT32 of the inputs that is NaN is 0.",
            told(read_alias, change=as_zero),
            "ENC-004",
        ),
        defect(
            f"MU-57{letter}",
            protocol,
            "A floating-point number of the inputs is rounded to one decimal.",
            told(read_alias, change=_one_decimal),
            "ENC-003",
        ),
        defect(
            f"MU-124{letter}",
            protocol,
            "started_at of an answer of process data is the local time with a Z behind it.",
            local_time,
            "ENC-003 ENC-004 ENC-005 ENC-007",
            "ENC-007",
        ),
        defect(
            f"MU-58{letter}",
            protocol,
            "A UINT64 of the inputs above 2^53 is rounded.",
            told(read_alias, change=by_way_of_float),
            "ENC-005",
        ),
        defect(
            f"MU-35{letter}b",
            protocol,
            "While the device is gone, a read of inputs succeeds with what was read before.",
            answers_from_memory_when_gone(read, silent=True),
            gone,
        ),
    )


DEFECTS: tuple[Defect, ...] = (
    *_of(
        "profibus",
        "p",
        read="read_inputs",
        write="write_outputs",
        called="slave",
        place={"slave_address": 8},
        argument="slave_address",
        bits=7,
        what="a station address",
        gone="REC-002 REC-003",
    ),
    *_of(
        "profinet",
        "pn",
        read="read_io_data",
        write="write_record",
        called="device",
        place={"device_name": "kit-device"},
        argument="slot",
        bits=16,
        what="a slot",
        gone="REC-002",
    ),
)
