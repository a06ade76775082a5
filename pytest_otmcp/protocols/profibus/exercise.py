"""What checks for every protocol do on PROFIBUS: inputs of slaves 5 and 8 that are read, their outputs that are written."""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..exercise import Asked, Contended, Exercise, Limited
from ..journal import Entries, JournalEntry
from ..point import FLOAT32, FLOAT64, INT16, INT64, UINT64, half, large
from .entries import as_profibus, points
from .oracle import outputs_sent
from .points import DRIVE, OTHERS, VALVES, bytes_of, input_named, inputs_of, output_named, outputs_of

__all__ = ["EXERCISE"]

_SMALL_INPUTS, _SMALL_OUTPUTS = inputs_of(VALVES), outputs_of(VALVES)
_LARGE_INPUTS, _LARGE_OUTPUTS = inputs_of(DRIVE), outputs_of(DRIVE)
_SPEED, _DOUBLE = input_named("otmcp_speed", FLOAT32), input_named("otmcp_double", FLOAT64)
_COUNTER, _SIGNED = input_named("otmcp_counter", UINT64), input_named("otmcp_signed", INT64)
_SETPOINT, _LIMIT = output_named("otmcp_setpoint", INT16, 0), output_named("otmcp_limit", FLOAT32, 4)
_INPUTS = {"service": "rd_inp"}
_NEW_OUTPUTS = {"service": "data_exchange", "changes": True}
"""Conditions of a fault plan."""


def _small_outputs(rng: random.Random) -> Asked:
    return _SMALL_OUTPUTS.write(bytes_of(rng, VALVES))


def _large_outputs(rng: random.Random) -> Asked:
    return _LARGE_OUTPUTS.write(bytes_of(rng, DRIVE))


def _limit(rng: random.Random) -> Asked:
    return _LIMIT.write(rng.randrange(1, 2**20) + 0.5)


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    return outputs_sent(entries)


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    known = [inputs_of(station).read(bytes_of(rng, station)) for station in (VALVES, DRIVE, OTHERS)]
    return tuple(known[index % len(known)] for index in range(count))


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    real = half(rng)
    return (
        _SMALL_INPUTS.read(bytes_of(rng, VALVES)),
        _LARGE_INPUTS.read(bytes_of(rng, DRIVE)),
        _SPEED.read(real),
        _DOUBLE.read(real),
        _COUNTER.read(2**40 + 7),
        _SIGNED.read(-(2**40) - 7),
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    # No byte is zero, as those of a slave are that has no master yet.
    setpoint = _SETPOINT.write(rng.randrange(0x101, 0x7F00))
    return _small_outputs(rng), _large_outputs(rng), setpoint, _limit(rng)


def _contended(rng: random.Random) -> Contended:
    old, *new = rng.sample(range(0x101, 0x7F00), 3)
    return replace(_SETPOINT.contended(old, *new), first=_SETPOINT.write(old))


def _asks_for(entry: JournalEntry) -> object:
    sent = as_profibus(entry)
    if sent.get("service") != "data_exchange" or sent["station"] != DRIVE:
        return None
    (setpoint,) = struct.unpack_from(">h", bytes.fromhex(sent["data"]))
    return int(setpoint)


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The outputs of the small slave are what a list can allow.
    return _small_outputs(rng), _large_outputs(rng), _limit(rng)


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    return points(inputs["slave"], "output", bytes(inputs["data"])) if operation == "write_outputs" else {}


def _refusals(entry: JournalEntry) -> list[str]:
    return [str(as_profibus(entry).get("status"))] if entry["kind"] == "response" else []


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read_inputs",
    read=lambda rng: _SMALL_INPUTS.read(bytes_of(rng, VALVES)),
    writing="write_outputs",
    write=_small_outputs,
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
    outside={"slave": (-1, 126, 127, 128 + VALVES, 2**8 + VALVES, 2**31, 5.5, "0x5")},
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={"8.output.0": Limited(ways=(_SETPOINT.write,), unit=1)},
    asks_for=_asks_for,
    bounds=lambda: (*_SETPOINT.bounds(), *_LIMIT.bounds()),
    misfits=lambda: (_SETPOINT.misfits(), _LIMIT.misfits()),
    large=large(_SIGNED, _COUNTER),
    floats={"float32": _SPEED.read, "float64": _DOUBLE.read},
    real=_LIMIT.write,
)
