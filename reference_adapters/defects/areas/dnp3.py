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
from ..mutant import Bend, Data, Mutant, told
from .enc import as_zero
from .further import beginning, cut_off, declared, last_answer, merged, module_of, stripped

__all__ = ["MUTANTS"]

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


def _binary_command(change: Callable[..., tuple[Any, ...]]) -> Bend:
    """Return the defect that of a command of a binary output something else is sent: what ``change`` makes of code, count and times."""

    def bend(server: AdapterServer) -> None:
        tools = _module("tools")
        genuine = tools.binary_command
        tools.binary_command = lambda index, *given: genuine(index, *change(*given))

    return bend


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


_mutant = partial(declared, "dnp3")

MUTANTS: tuple[Mutant, ...] = (
    _mutant(
        "MU-04dnp",
        "rd",
        "RD-001 RD-004",
        "RD-001 RD-004",
        told(_READ, change=_positive),
        "An analog input is read without its sign.",
    ),
    _mutant("MU-14dc", "wr", "WR-001", "WR-001", _binary_command(_latched), "A pulse is sent as a latch."),
    _mutant(
        "MU-09dt", "wr", "WR-001", "WR-001", _binary_command(_a_second), "The time of a pulse is a second at most."
    ),
    _mutant("MU-09dq", "wr", "WR-001", "WR-001", _binary_command(_once), "Of several pulses one is sent."),
    _mutant(
        "MU-20dw",
        "wr",
        "WR-004",
        "WR-004",
        guard_after_sending(_WRITE_ALIAS),
        "With writes disabled an alias is written, and then denied.",
    ),
    _mutant(
        "MU-09dnp",
        "adr",
        "ADR-003",
        "ADR-003",
        _clamped,
        "A setpoint beyond 32 bits is set to the largest number that fits.",
    ),
    _mutant(
        "MU-11dnp",
        "adr",
        "ADR-004",
        "ADR-004",
        _numbers_from_texts,
        "A text with a number in it sets an analog output to the number.",
    ),
    _mutant(
        "MU-06dnp",
        "adr",
        "ADR-002",
        "ADR-002",
        cut_off(_READ, "start_index", _INDEX_BITS),
        "Of an index the last 16 bits count.",
    ),
    _mutant(
        "MU-37dnp",
        "con",
        "CON-001",
        "CON-001",
        last_answer(_READ),
        "Of several DNP3 reads at the same time all are told what the last one has found.",
    ),
    _mutant(
        "MU-41dnp",
        "con",
        "CON-004",
        "CON-004",
        merged(_WRITE_ALIAS, lambda asked: asked.alias, _set),
        "Of two setpoints at the same time only one is sent, and both are told as successes.",
    ),
    _mutant(
        "MU-56dnp",
        "enc",
        "ENC-004",
        "ENC-004",
        told(_READ_ALIAS, change=as_zero),
        "An analog input that is NaN is 0.",
    ),
    _mutant(
        "MU-57dnp",
        "enc",
        "ENC-003",
        "ENC-003",
        told(_READ_ALIAS, change=_six_digits),
        "Of a floating-point number six digits are told.",
    ),
    _mutant(
        "MU-123dl",
        "enc",
        "ENC-006",
        "ENC-006",
        told(_READ_ALIAS, change=beginning),
        "Of an octet string the first 20 characters are read.",
    ),
    _mutant(
        "MU-123d",
        "enc",
        "ENC-006",
        "ENC-006",
        told(_READ_ALIAS, change=stripped),
        "An octet string is read without the spaces around it.",
    ),
    _mutant(
        "MU-124d",
        "enc",
        "ENC-003 ENC-004 ENC-006 ENC-007",
        "ENC-007",
        local_time,
        "started_at of a DNP3 answer is the local time with a Z behind it.",
    ),
    _mutant(
        "MU-93dnp",
        "res",
        "RES-003",
        "MCP-007",
        _ends_on_a_wrong_checksum,
        "A DNP3 frame with a wrong checksum ends the adapter.",
    ),
    _mutant(
        "MU-35dnp",
        "rec",
        "REC-002",
        "REC-002",
        answers_from_memory_when_gone("read_analog_inputs"),
        "While the device is gone, a read of analog inputs succeeds with what was read before.",
    ),
)
