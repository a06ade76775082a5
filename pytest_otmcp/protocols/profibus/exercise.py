"""What checks for every protocol do on PROFIBUS: inputs of slaves 5 and 8 that are read, their outputs that are written."""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from ..exercise import LARGEST_FLOAT32, NO_INTEGERS, NO_REALS, Asked, Contended, Exercise, Limited
from ..journal import Entries, JournalEntry
from .entries import as_profibus, points
from .oracle import outputs_sent

__all__ = ["EXERCISE"]

_SMALL, _LARGE = 5, 8
"""Stations: two bytes of inputs and two of outputs; eight of each."""
_WIDTH = 8
_SPEED, _COUNTER, _SIGNED, _DOUBLE = "otmcp_speed", "otmcp_counter", "otmcp_signed", "otmcp_double"
_SETPOINT, _LIMIT = "otmcp_setpoint", "otmcp_limit"
"""Names that a launch of an adapter with names of its own has: for the inputs of station 8 from byte 0 a FLOAT32, a UINT64, an INT64
and a FLOAT64; for its outputs an INT16 from byte 0 and a FLOAT32 from byte 4."""
_INPUTS = {"service": "rd_inp"}
_NEW_OUTPUTS = {"service": "data_exchange", "changes": True}
"""Conditions of a fault plan."""


def _inputs(station: int, content: bytes) -> Asked:
    return Asked(
        operation="read_inputs",
        inputs={"slave": station},
        outputs={"values": list(content)},
        pokes=({"station": station, "inputs": content.hex()},),
        condition={"station": station},
    )


def _outputs(station: int, content: bytes) -> Asked:
    return Asked(
        operation="write_outputs",
        inputs={"slave": station, "data": list(content)},
        outputs={"values": list(content)},
        points=points(station, "output", content),
    )


def _bytes(rng: random.Random, size: int) -> bytes:
    return bytes(rng.randrange(1, 0x100) for _ in range(size))


def _read(rng: random.Random) -> Asked:
    return _inputs(_SMALL, _bytes(rng, 2))


def _write(rng: random.Random) -> Asked:
    return _outputs(_SMALL, _bytes(rng, 2))


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    return outputs_sent(entries)


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    known = [_inputs(station, _bytes(rng, size)) for station, size in ((_SMALL, 2), (_LARGE, _WIDTH), (9, 1))]
    return tuple(known[index % len(known)] for index in range(count))


def _alias(name: str, content: bytes, outputs: dict[str, object]) -> Asked:
    return Asked(
        operation="read_alias",
        inputs={"name": name},
        outputs=outputs,
        pokes=({"station": _LARGE, "inputs": content.ljust(_WIDTH, b"\0").hex()},),
    )


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    # Halves below 2 to the 20 are exact in both.
    real = rng.randrange(-(2**20), 2**20) + 0.5
    return (
        _inputs(_SMALL, _bytes(rng, 2)),
        _inputs(_LARGE, _bytes(rng, _WIDTH)),
        _alias(_SPEED, struct.pack(">f", real), {"value": real}),
        _alias(_DOUBLE, struct.pack(">d", real), {"value": real}),
        _alias(_COUNTER, struct.pack(">Q", 2**40 + 7), {"value": 2**40 + 7}),
        _alias(_SIGNED, struct.pack(">q", -(2**40) - 7), {"value": -(2**40) - 7}),
    )


def _large_numbers(values: Sequence[int], signed: bool) -> tuple[Asked, ...]:
    name = _SIGNED if signed else _COUNTER
    return tuple(_alias(name, value.to_bytes(8, "big", signed=signed), {"value": value}) for value in values)


def _float(alias: str, form: str, value: float) -> Asked:
    return _alias(alias, struct.pack(form, value), {"value": value})


def _named(name: str, value: object, offset: int, content: bytes) -> Asked:
    return Asked(
        operation="write_alias",
        inputs={"name": name, "value": value},
        outputs={"value": value},
        points=points(_LARGE, "output", content, offset),
    )


def _setpoint(value: int) -> Asked:
    return _named(_SETPOINT, value, 0, struct.pack(">h", value))


def _real(value: float) -> Asked:
    return _named(_LIMIT, value, 4, struct.pack(">f", value))


def _bounds() -> tuple[tuple[Asked, object], ...]:
    return (
        (_setpoint(-(2**15)), -(2**15) - 1),
        (_setpoint(2**15 - 1), 2**15),
        (_real(LARGEST_FLOAT32), 1e39),
        (_real(-LARGEST_FLOAT32), -1e39),
    )


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    return (
        (_setpoint(7), NO_INTEGERS),
        (_real(7.5), NO_REALS),
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    # No byte is zero, as those of a slave are that has no master yet.
    setpoint = rng.randrange(0x101, 0x7F00)
    return (
        _outputs(_SMALL, _bytes(rng, 2)),
        _outputs(_LARGE, _bytes(rng, _WIDTH)),
        _setpoint(setpoint),
        _real(rng.randrange(1, 2**20) + 0.5),
    )


def _contended(rng: random.Random) -> Contended:
    old, *new = rng.sample(range(0x101, 0x7F00), 3)
    return Contended(
        old=old,
        new=tuple(new),
        # A master repeats its outputs: others that were set at the slave would not stay.
        pokes=(),
        first=_setpoint(old),
        read=Asked(operation="read_alias", inputs={"name": _SETPOINT}),
        output="value",
        writes=tuple(map(_setpoint, new)),
    )


def _asks_for(entry: JournalEntry) -> object:
    sent = as_profibus(entry)
    if sent.get("service") != "data_exchange" or sent["station"] != _LARGE:
        return None
    (setpoint,) = struct.unpack_from(">h", bytes.fromhex(sent["data"]))
    return int(setpoint)


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The outputs of the small slave are what a list can allow.
    return (
        _outputs(_SMALL, _bytes(rng, 2)),
        _outputs(_LARGE, _bytes(rng, _WIDTH)),
        _real(rng.randrange(1, 2**20) + 0.5),
    )


def _setting(value: float) -> Asked:
    return _named(_SETPOINT, value, 0, struct.pack(">h", value))


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    return points(inputs["slave"], "output", bytes(inputs["data"])) if operation == "write_outputs" else {}


def _refusals(entry: JournalEntry) -> list[str]:
    return [str(as_profibus(entry).get("status"))] if entry["kind"] == "response" else []


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read_inputs",
    read=_read,
    writing="write_outputs",
    write=_write,
    number=None,
    bounded=("slave",),
    done=_done,
    reads=(_INPUTS, {"service": "data_exchange", "changes": False}),
    writes=(_NEW_OUTPUTS,),
    refusals=_refusals,
    unanswered={"slave": (126, 127)},
    silent=({"action": {"drop": True}},),
    # A line has no connection that could be reset: what comes nearest is that the answer to the outputs, or the inputs, are lost. A write
    # asks for more than that, and what is lost before the outputs are sent leaves them unsent.
    reset=tuple({**condition, "action": {"drop": True}} for condition in (_NEW_OUTPUTS, _INPUTS)),
    refused=({"action": {"error": 1}},),
    write_refused=({"error": 1}, "device_failure"),
    # An address has 7 bits, and 126 and 127 are no slave's.
    outside={"slave": (-1, 126, 127, 128 + _SMALL, 2**8 + _SMALL, 2**31, 5.5, "0x5")},
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={"8.output.0": Limited(ways=(_setting,), unit=1)},
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    large=_large_numbers,
    floats={"float32": partial(_float, _SPEED, ">f"), "float64": partial(_float, _DOUBLE, ">d")},
    real=_real,
)
