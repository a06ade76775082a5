"""What checks for every protocol do on DNP3: analog inputs that are read, latches and setpoints that are operated."""

from __future__ import annotations

import random
from collections.abc import Mapping
from functools import partial
from typing import Any

from ..exercise import Asked, Contended, DeviceText, Exercise, Limited, Texts, number_in_json
from ..journal import Entries, JournalEntry
from ..point import half
from .entries import DIRECT_OPERATE, OPERATE, as_dnp3, changes, commands, objects
from .oracle import LATCH_OFF, LATCH_ON
from .points import NAMES, OUTSTATION, analog, latch, named, several

__all__ = ["EXERCISE"]

_INPUT, _OUTPUT = 1, 2
_WRITE = 2
_LATCHES, _EVENTLESS = range(5), range(1, 6)
"""Outputs that are latches; analog inputs that hold whole numbers and make no events."""
_PULSED, _TRIP_CLOSE = 6, 7
"""Outputs that take pulses only, and trip and close only."""
_LONGEST_TEXT = 255
"""Bytes of an octet string, whose variation is its length."""
_LEVEL, _EXACT, _PUMP, _SETPOINT, _LIMITED, _BATCH, _TEXT = map(named, NAMES)


def _latched(index: int, value: bool) -> Asked:
    return latch(index).write(value, before=not value)


def _write(rng: random.Random) -> Asked:
    return _latched(rng.choice(_LATCHES), rng.random() < 0.5)


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    return [entry for entry in changes(entries) if as_dnp3(entry).get("function") in (OPERATE, DIRECT_OPERATE, _WRITE)]


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    known = [analog(index).any(rng) for index in _EVENTLESS]
    return tuple(known[number % len(known)] for number in range(count))


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    def negative() -> int:
        return -abs(int(_LEVEL.kind.any(rng)))

    # Inputs that make no events: the others would be reported with the next poll.
    states = [bool(rng.getrandbits(1)) for _ in range(8)]
    return (
        several("binary", 8, 8).read(states),
        several("analog", 1, 4).read([negative(), _LEVEL.kind.any(rng), 2**31 - 1, -(2**31)]),
        analog(7).read(half(rng)),
        _LEVEL.read(negative()),
        _EXACT.read(rng.uniform(-1e9, 1e9)),
        _PUMP.read(True),
        _SETPOINT.read(half(rng)),
        _BATCH.read(negative()),
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value = rng.random() < 0.5
    text = f"text-{rng.getrandbits(32):08x}"
    return (
        *(_latched(index, value) for index in (_OUTPUT, 4)),
        _latched(_OUTPUT, not value),
        _SETPOINT.write(abs(half(rng)), before=0.0),
        _BATCH.write(rng.randrange(1, 2**31), before=0),
        _write_text(text),
    )


def _commanded(rng: random.Random, index: int, control: str, code: int, *further: str) -> Asked:
    """Return a control of a binary output by its code.

    Args:
        further: inputs beside the code; those of a pulse.
    """
    value = control in ("latch_on", "pulse_on", "close")
    given = {
        "count": rng.randrange(2, 9),
        "on_time_ms": rng.randrange(2000, 9000),
        "off_time_ms": rng.randrange(10, 999),
    }
    inputs = {name: given[name] for name in further}
    told = {"count": "count", "on_time_ms": "on_ms", "off_time_ms": "off_ms"}
    return Asked(
        operation="write_binary",
        inputs={"outstation": OUTSTATION, "index": index, "value": value, "control": control, **inputs},
        points={} if index == _PULSED else {f"binary_output/{index}": value},
        sent={"index": index, "code": code, "count": 1, **{told[name]: number for name, number in inputs.items()}},
    )


def _commands(rng: random.Random) -> tuple[Asked, ...]:
    times = ("on_time_ms", "off_time_ms")
    return (
        _commanded(rng, _OUTPUT, "latch_on", LATCH_ON),
        _commanded(rng, _OUTPUT, "latch_off", LATCH_OFF),
        *(
            _commanded(rng, index, control, code, *further)
            for index, control, code in (
                (_PULSED, "pulse_on", 0x01),
                (_PULSED, "pulse_off", 0x02),
                (_TRIP_CLOSE, "close", 0x41),
                (_TRIP_CLOSE, "trip", 0x81),
            )
            for further in (times[:1], times)
        ),
        _commanded(rng, _PULSED, "pulse_on", 0x01, "count", *times),
    )


def _says(entry: JournalEntry) -> Mapping[str, Any] | None:
    given = commands(entry)
    return given[0] if len(given) == 1 and "code" in given[0] else None


def _contended(rng: random.Random) -> Contended:
    return _SETPOINT.contended(*(number + 0.5 for number in rng.sample(range(2**20), 3)))


def _asks_for(entry: JournalEntry) -> object:
    given = commands(entry)
    return given[0].get("value") if len(given) == 1 else None


def _bounds() -> tuple[tuple[Asked, object], ...]:
    return *reversed(_BATCH.bounds(before=0)), *_SETPOINT.bounds(before=0.0)


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    flag = _latched(_OUTPUT, True), ("false", "off", 1, [True], None)
    return flag, _BATCH.misfits(before=0), _SETPOINT.misfits(before=0.0)


def _write_text(text: str) -> Asked:
    return _TEXT.write(text, before="before")


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The binary output 2 is what a list can allow.
    return (
        *(_latched(index, rng.random() < 0.5) for index in (_OUTPUT, 1, 3)),
        _LIMITED.write(rng.randrange(1, 100) + 0.5),
        _TEXT.write(f"text-{rng.getrandbits(32):08x}"),
    )


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (DeviceText(place="an octet string", ask=_TEXT.read, longest=200, encoding="utf-8"),)


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    latches = operation == "write_binary" and str(inputs.get("control", "latch")).startswith("latch")
    return {f"binary_output/{inputs['index']}": inputs["value"]} if latches else {}


def _refusals(entry: JournalEntry) -> list[str]:
    second = as_dnp3(entry).get("iin", 0) >> 8
    statuses = [point.get("status") for header in objects(entry) for point in header.get("points", [])]
    return [
        *(f"iin2-{bit}" for bit in range(8) if second >> bit & 1),
        *(f"status-{status}" for status in statuses if status and entry["kind"] == "response"),
    ]


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read_analog",
    read=lambda rng: analog(_INPUT).any(rng),
    writing="write_binary",
    write=_write,
    number=None,
    bounded=("outstation", "start", "index"),
    done=_done,
    reads=({"function": 1},),
    # A selection moves nothing: what has its effect is the operation.
    writes=({"function": OPERATE}, {"function": DIRECT_OPERATE}),
    refusals=_refusals,
    silent=({"action": {"drop": True}},),
    reset=({"action": {"reset": True}},),
    refused=({"action": {"iin": 0x0100}},),
    write_refused=({"status": 6}, "device_failure"),
    # A link address and an index have 16 bits; FFF0 to FFFF are no addresses of outstations.
    outside={
        "outstation": (-1, 2**16, 2**16 + OUTSTATION, 2**31, 10.5, "0x0a"),
        "start": (-1, 2**16, 2**16 + _INPUT, 2**31, 1.5, "0x1"),
        "index": (-1, 2**16, 2**16 + _OUTPUT, 2**31, 2.5, "0x2"),
        "count": (-1, 0, 2**16 + 1, 2**31, 1.5, "0x1"),
    },
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={
        "analog_output/3": Limited(ways=(_BATCH.write,), unit=1),
        "analog_output/0": Limited(ways=(_SETPOINT.write,), unit=0.5),
    },
    commands=_commands,
    says=_says,
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    floats={
        "float32": lambda value: _SETPOINT.read(number_in_json(value)),
        "float64": lambda value: _EXACT.read(number_in_json(value)),
    },
    real=partial(_SETPOINT.write, before=0.0),
    texts=Texts(encoding="utf-8", longest=_LONGEST_TEXT, read=_TEXT.read, write=_write_text),
    device_texts=_device_texts,
)
