"""Defects of a DNP3 adapter that the checks of the requirement suite notice."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

from ...core import AdapterServer
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..defect import Change, Data, Defect, defect, told
from .enc import as_zero
from .further import beginning, cut_off, last_answer, merged, module_of, stripped

__all__ = ["DEFECTS"]

_READ, _READ_ALIAS, _WRITE_ALIAS = "read_analog_inputs", "read_point_by_alias", "write_point_by_alias"
_INDEX_BITS = 16
_WHOLE = range(-(2**31), 2**31)

_module = partial(module_of, "dnp3")


def _clamped(server: AdapterServer) -> None:
    tools, conversions = _module("tools"), _module("conversions")
    command = conversions.analog_command

    def clamped(index: int, kind: Any, value: Any) -> bytes:
        fits = min(max(value, _WHOLE[0]), _WHOLE[-1]) if type(value) is int else value
        content: bytes = command(index, kind, fits)
        return content

    conversions.analog_command = clamped
    tools.holds = lambda alias, objects, value: lambda point: True


def _numbers_from_texts(server: AdapterServer) -> None:
    tools, conversions = _module("tools"), _module("conversions")
    command = conversions.analog_command

    def lenient(index: int, kind: Any, value: Any) -> bytes:
        is_number = isinstance(value, str) and value[:1].isdecimal()
        content: bytes = command(index, kind, float(value) if is_number else value)
        return content

    conversions.analog_command = lenient
    tools.holds = lambda alias, objects, value: lambda point: True


def _ends_on_a_wrong_checksum(server: AdapterServer) -> None:
    parser = import_module("dnp3.datalink.parser")
    for name in ("_validate_header_crc", "_validate_data_block_crc"):
        setattr(parser, name, _or_ends(getattr(parser, name)))


def _or_ends(check: Callable[[bytes], bool]) -> Callable[[bytes], bool]:
    return lambda content: check(content) or os._exit(1)


def _six_digits(data: Data) -> Data:
    return {**data, "value": float(f"{data['value']:.6g}")} if isinstance(data["value"], float) else data


def _binary_command(change: Callable[..., tuple[Any, ...]]) -> Change:
    """Return the defect that of a command of a binary output something else is sent: what ``change`` makes of code, count and times."""

    def apply(server: AdapterServer) -> None:
        tools = _module("tools")
        genuine = tools.binary_command
        tools.binary_command = lambda index, *given: genuine(index, *change(*given))

    return apply


def _latched(code: str, count: int, on_ms: int, off_ms: int) -> tuple[Any, ...]:
    return code.replace("pulse", "latch"), count, on_ms, off_ms


def _a_second(code: str, count: int, on_ms: int, off_ms: int) -> tuple[Any, ...]:
    return code, count, min(on_ms, 1000), off_ms


def _once(code: str, count: int, on_ms: int, off_ms: int) -> tuple[Any, ...]:
    return code, 1, on_ms, off_ms


def _positive(data: Data) -> Data:
    return {**data, "points": [{**point, "value": abs(point["value"])} for point in data["points"]]}


def _set(arguments: Any) -> Data:
    return {
        "alias": arguments.alias,
        "unit": None,
        "outstation_address": 10,
        "point_type": "analog_output",
        "index": 0,
        "value": arguments.value,
        "status": "SUCCESS",
        "state": arguments.value,
    }


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-04dnp", "dnp3", "An analog input is read without its sign.", told(_READ, change=_positive), "RD-001 RD-004"
    ),
    defect("MU-14dc", "dnp3", "A pulse is sent as a latch.", _binary_command(_latched), "WR-001"),
    defect("MU-09dt", "dnp3", "The time of a pulse is a second at most.", _binary_command(_a_second), "WR-001"),
    defect("MU-09dq", "dnp3", "Of several pulses one is sent.", _binary_command(_once), "WR-001"),
    defect(
        "MU-20dw",
        "dnp3",
        "With writes disabled an alias is written, and then denied.",
        guard_after_sending(_WRITE_ALIAS),
        "WR-004",
    ),
    defect(
        "MU-09dnp", "dnp3", "A setpoint beyond 32 bits is set to the largest number that fits.", _clamped, "ADR-003"
    ),
    defect(
        "MU-11dnp",
        "dnp3",
        "A text with a number in it sets an analog output to the number.",
        _numbers_from_texts,
        "ADR-004",
    ),
    defect(
        "MU-06dnp", "dnp3", "Of an index the last 16 bits count.", cut_off(_READ, "start_index", _INDEX_BITS), "ADR-002"
    ),
    defect(
        "MU-37dnp",
        "dnp3",
        "Of several DNP3 reads at the same time all are told what the last one has found.",
        last_answer(_READ),
        "CON-001",
    ),
    defect(
        "MU-41dnp",
        "dnp3",
        "Of two setpoints at the same time only one is sent, and both are told as successes.",
        merged(_WRITE_ALIAS, lambda asked: asked.alias, _set),
        "CON-004",
    ),
    defect("MU-56dnp", "dnp3", "An analog input that is NaN is 0.", told(_READ_ALIAS, change=as_zero), "ENC-004"),
    defect(
        "MU-57dnp",
        "dnp3",
        "Of a floating-point number six digits are told.",
        told(_READ_ALIAS, change=_six_digits),
        "ENC-003",
    ),
    defect(
        "MU-123dl",
        "dnp3",
        "Of an octet string the first 20 characters are read.",
        told(_READ_ALIAS, change=beginning),
        "ENC-006",
    ),
    defect(
        "MU-123d",
        "dnp3",
        "An octet string is read without the spaces around it.",
        told(_READ_ALIAS, change=stripped),
        "ENC-006",
    ),
    defect(
        "MU-124d",
        "dnp3",
        "started_at of a DNP3 answer is the local time with a Z behind it.",
        local_time,
        "ENC-003 ENC-004 ENC-006 ENC-007",
        "ENC-007",
    ),
    defect(
        "MU-93dnp",
        "dnp3",
        "A DNP3 frame with a wrong checksum ends the adapter.",
        _ends_on_a_wrong_checksum,
        "RES-003",
        "MCP-007",
    ),
    defect(
        "MU-35dnp",
        "dnp3",
        "While the device is gone, a read of analog inputs succeeds with what was read before.",
        answers_from_memory_when_gone("read_analog_inputs"),
        "REC-002",
    ),
)
