"""What checks for every protocol do on PROFINET: inputs that are read, records and outputs that are written."""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any

from ..exercise import Asked, Exercise, Limited, Writing
from ..journal import Entries, JournalEntry
from ..point import FLOAT32, FLOAT64, INT16, INT64, UINT64, half, large
from .entries import as_profinet, points
from .oracle import written
from .points import DRIVE, PUMP, VALVES, bytes_of, input_named, inputs_of, outputs_of, record_named, record_of

__all__ = ["EXERCISE"]

_SETPOINT_INDEX, _LIMIT_INDEX = 4, 5
_LARGE_INPUTS, _SMALL_INPUTS, _OUTPUTS = inputs_of(DRIVE), inputs_of(VALVES), outputs_of(PUMP)
_LARGE_RECORD, _SMALL_RECORD = record_of(DRIVE), record_of(VALVES)
_SPEED, _DOUBLE = input_named("otmcp_speed", FLOAT32), input_named("otmcp_double", FLOAT64)
_COUNTER, _SIGNED = input_named("otmcp_counter", UINT64), input_named("otmcp_signed", INT64)
_SETPOINT = record_named("otmcp_setpoint", INT16, _SETPOINT_INDEX)
_LIMIT = record_named("otmcp_limit", FLOAT32, _LIMIT_INDEX)
_READ = ({"service": "read"}, {"service": "inputs"})
_WRITE = ({"service": "write"}, {"service": "outputs", "changes": True})
"""Conditions of a fault plan."""
# A slot or subslot has 16 bits, and what is above 8000 is the device's own.
_OUTSIDE = (-1, 2**16 + 1, 2**31, 1.5, "0x1")


def _record(rng: random.Random) -> Asked:
    return _LARGE_RECORD.write(bytes_of(rng, DRIVE))


def _small_record(rng: random.Random) -> Asked:
    return _SMALL_RECORD.write(bytes_of(rng, VALVES))


def _outputs(rng: random.Random) -> Asked:
    return _OUTPUTS.write(bytes_of(rng, PUMP))


def _limit(rng: random.Random) -> Asked:
    return _LIMIT.write(rng.randrange(1, 2**20) + 0.5)


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    return written(entries)


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    known = [inputs_of(slot).read(bytes_of(rng, slot)) for slot in (DRIVE, VALVES)]
    return tuple(known[index % len(known)] for index in range(count))


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    return (
        _LARGE_INPUTS.read(bytes_of(rng, DRIVE)),
        _SMALL_INPUTS.read(bytes_of(rng, VALVES)),
        _LARGE_RECORD.read(bytes_of(rng, DRIVE)),
        _SMALL_RECORD.read(bytes_of(rng, VALVES)),
        _SPEED.read(half(rng)),
        _DOUBLE.read(half(rng)),
        _COUNTER.read(2**40 + 7),
        _SIGNED.read(-(2**40) - 7),
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    setpoint = _SETPOINT.write(rng.randrange(0x101, 0x7F00))
    return _record(rng), _small_record(rng), _outputs(rng), setpoint, _limit(rng)


def _asks_for(entry: JournalEntry) -> object:
    sent = as_profinet(entry)
    if sent.get("service") != "write" or sent.get("index") != _SETPOINT_INDEX:
        return None
    return int.from_bytes(bytes.fromhex(sent.get("data", "")), signed=True)


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The records of the slot with valves are what a list can allow.
    return _small_record(rng), _record(rng), _outputs(rng), _limit(rng)


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    which = {"write_outputs": "output", "write_record": f"record.{inputs.get('index')}"}.get(operation)
    return {} if which is None else points(inputs["slot"], which, bytes(inputs["data"]))


def _refusals(entry: JournalEntry) -> list[str]:
    status = as_profinet(entry).get("status")
    return [] if status is None else [status]


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read_inputs",
    read=lambda rng: _SMALL_INPUTS.read(bytes_of(rng, VALVES)),
    writing="write_record",
    write=_small_record,
    otherwise=(Writing(operation="write_outputs", write=_outputs, outside={"slot": _OUTSIDE, "subslot": _OUTSIDE}),),
    number=None,
    bounded=("slot", "subslot"),
    done=_done,
    reads=_READ,
    writes=_WRITE,
    refusals=_refusals,
    silent=({"action": {"drop": True}},),
    # There is no connection that could be reset: what comes nearest is that the answer is lost.
    reset=tuple({**condition, "action": {"drop": True}} for condition in (*_WRITE, *_READ)),
    refused=({"service": "read", "action": {"error": 0xA0}},),
    write_refused=({"error": 0xA1}, "device_failure"),
    outside={"slot": _OUTSIDE, "subslot": _OUTSIDE},
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=lambda rng: _SETPOINT.contended(*rng.sample(range(0x101, 0x7F00), 3)),
    fenced=_fenced,
    limited={f"1.1.record.{_SETPOINT_INDEX}.0": Limited(ways=(_SETPOINT.write,), unit=1)},
    asks_for=_asks_for,
    bounds=lambda: (*_SETPOINT.bounds(), *_LIMIT.bounds()),
    misfits=lambda: (_SETPOINT.misfits(), _LIMIT.misfits()),
    large=large(_SIGNED, _COUNTER),
    floats={"float32": _SPEED.read, "float64": _DOUBLE.read},
    real=_LIMIT.write,
)
