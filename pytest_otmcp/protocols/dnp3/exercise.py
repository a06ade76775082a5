"""What checks for every protocol do on DNP3: analog inputs that are read, latches and setpoints that are operated."""

from __future__ import annotations

import random
from collections.abc import Mapping
from functools import partial
from typing import Any

from ..exercise import (
    LARGEST_FLOAT32,
    NO_INTEGERS,
    NO_REALS,
    Asked,
    Contended,
    DeviceText,
    Exercise,
    Limited,
    Texts,
    number_in_json,
)
from ..journal import Entries, JournalEntry
from .entries import DIRECT_OPERATE, OPERATE, as_dnp3, changes, commands, objects
from .oracle import LATCH_OFF, LATCH_ON

__all__ = ["EXERCISE"]

_OUTSTATION, _INPUT, _OUTPUT = 10, 1, 2
_WRITE = 2
_LATCHES, _EVENTLESS = range(5), range(1, 6)
"""Outputs that are latches; analog inputs that hold whole numbers and make no events."""
_PULSED, _TRIP_CLOSE = 6, 7
"""Outputs that take pulses only, and trip and close only."""
_LONGEST_TEXT = 255
"""Bytes of an octet string, whose variation is its length."""
_LEVEL, _EXACT, _PUMP = "otmcp_level", "otmcp_exact", "otmcp_pump"
_SETPOINT, _BATCH, _TEXT = "otmcp_setpoint", "otmcp_batch", "otmcp_text"
"""Names that a launch of an adapter with names of its own has: the analog input 1, the analog input 7 (a double), the binary output 2,
the analog output 0 (a float), the analog output 3 (a whole number of 32 bits) and the octet string 0."""


def _whole(rng: random.Random) -> int:
    return rng.randrange(-(2**31), 2**31)


def _half(rng: random.Random) -> float:
    # Halves below 2 to the 20 are exact in a float; the signs tell a number from its bits.
    return rng.randrange(-(2**20), 2**20) + 0.5


def _at(start: int, count: int = 1) -> dict[str, object]:
    return {"outstation": _OUTSTATION, "start": start, "count": count}


def _analog(index: int, value: float) -> Asked:
    name = f"analog_input/{index}"
    return Asked(
        operation="read_analog",
        inputs=_at(index),
        outputs={"values": [value]},
        pokes=({"point": name, "value": value},),
        condition={"function": 1, "group": 30, "index": index},
    )


def _read(rng: random.Random) -> Asked:
    return _analog(_INPUT, _whole(rng))


def _latch(index: int, value: bool) -> Asked:
    name = f"binary_output/{index}"
    return Asked(
        operation="write_binary",
        inputs={"outstation": _OUTSTATION, "index": index, "value": value},
        outputs={"value": value},
        pokes=({"point": name, "value": not value},),
        points={name: value},
    )


def _write(rng: random.Random) -> Asked:
    return _latch(rng.choice(_LATCHES), rng.random() < 0.5)


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    return [entry for entry in changes(entries) if as_dnp3(entry).get("function") in (OPERATE, DIRECT_OPERATE, _WRITE)]


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    known = [_analog(index, _whole(rng)) for index in _EVENTLESS]
    return tuple(known[number % len(known)] for number in range(count))


def _named(name: str, point: str, value: object, **outputs: object) -> Asked:
    return Asked(
        operation="read_alias",
        inputs={"name": name},
        outputs=outputs or {"value": value},
        pokes=({"point": point, "value": value},),
    )


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    # Inputs that make no events: the others would be reported with the next poll.
    states = [bool(rng.getrandbits(1)) for _ in range(8)]
    values = [-abs(_whole(rng)), _whole(rng), 2**31 - 1, -(2**31)]
    return (
        Asked(
            operation="read_binary",
            inputs=_at(8, 8),
            outputs={"values": states},
            pokes=tuple({"point": f"binary_input/{8 + place}", "value": state} for place, state in enumerate(states)),
        ),
        Asked(
            operation="read_analog",
            inputs=_at(1, 4),
            outputs={"values": values},
            pokes=tuple({"point": f"analog_input/{1 + place}", "value": value} for place, value in enumerate(values)),
        ),
        _analog(7, _half(rng)),
        _named(_LEVEL, "analog_input/1", -abs(_whole(rng))),
        _named(_EXACT, "analog_input/7", rng.uniform(-1e9, 1e9)),
        _named(_PUMP, "binary_output/2", True),
        _named(_SETPOINT, "analog_output/0", _half(rng)),
        _named(_BATCH, "analog_output/3", -abs(_whole(rng))),
    )


def _set(name: str, index: int, value: object, *, before: float) -> Asked:
    point = f"analog_output/{index}"
    return Asked(
        operation="write_alias",
        inputs={"name": name, "value": value},
        pokes=({"point": point, "value": before},),
        points={point: value},
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value = rng.random() < 0.5
    text = f"text-{rng.getrandbits(32):08x}"
    return (
        *(_latch(index, value) for index in (_OUTPUT, 4)),
        _latch(_OUTPUT, not value),
        _set(_SETPOINT, 0, abs(_half(rng)), before=0.0),
        _set(_BATCH, 3, rng.randrange(1, 2**31), before=0),
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
        inputs={"outstation": _OUTSTATION, "index": index, "value": value, "control": control, **inputs},
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
    old, *new = (number + 0.5 for number in rng.sample(range(2**20), 3))
    return Contended(
        old=old,
        new=tuple(new),
        pokes=({"point": "analog_output/0", "value": old},),
        read=Asked(operation="read_alias", inputs={"name": _SETPOINT}),
        output="value",
        writes=tuple(_set(_SETPOINT, 0, value, before=old) for value in new),
    )


def _asks_for(entry: JournalEntry) -> object:
    given = commands(entry)
    return given[0].get("value") if len(given) == 1 else None


def _float(name: str, point: str, value: float) -> Asked:
    return _named(name, point, number_in_json(value))


def _real(value: float) -> Asked:
    return _set(_SETPOINT, 0, value, before=0.0)


def _bounds() -> tuple[tuple[Asked, object], ...]:
    return (
        (_set(_BATCH, 3, 2**31 - 1, before=0), 2**31),
        (_set(_BATCH, 3, -(2**31), before=0), -(2**31) - 1),
        (_set(_SETPOINT, 0, LARGEST_FLOAT32, before=0.0), 1e39),
        (_set(_SETPOINT, 0, -LARGEST_FLOAT32, before=0.0), -1e39),
    )


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    return (
        (_latch(_OUTPUT, True), ("false", "off", 1, [True], None)),
        (_set(_BATCH, 3, 7, before=0), NO_INTEGERS),
        (_set(_SETPOINT, 0, 7.5, before=0.0), NO_REALS),
    )


def _read_text(text: str) -> Asked:
    return _named(_TEXT, "octet_string/0", text)


def _write_text(text: str) -> Asked:
    return Asked(
        operation="write_alias",
        inputs={"name": _TEXT, "value": text},
        pokes=({"point": "octet_string/0", "value": "before"},),
        points={"octet_string/0": text},
    )


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The binary output 2 is what a list can allow.
    def named(name: str, point: str, value: object) -> Asked:
        return Asked(operation="write_alias", inputs={"name": name, "value": value}, points={point: value})

    return (
        *(_latch(index, rng.random() < 0.5) for index in (_OUTPUT, 1, 3)),
        named("otmcp_limited", "analog_output/2", rng.randrange(1, 100) + 0.5),
        named(_TEXT, "octet_string/0", f"text-{rng.getrandbits(32):08x}"),
    )


def _setting(name: str, index: int, value: float) -> Asked:
    return Asked(
        operation="write_alias", inputs={"name": name, "value": value}, points={f"analog_output/{index}": value}
    )


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (DeviceText(place="an octet string", ask=_read_text, longest=200, encoding="utf-8"),)


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
    read=_read,
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
        "outstation": (-1, 2**16, 2**16 + _OUTSTATION, 2**31, 10.5, "0x0a"),
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
        "analog_output/3": Limited(ways=(partial(_setting, _BATCH, 3),), unit=1),
        "analog_output/0": Limited(ways=(partial(_setting, _SETPOINT, 0),), unit=0.5),
    },
    commands=_commands,
    says=_says,
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    floats={
        "float32": partial(_float, _SETPOINT, "analog_output/0"),
        "float64": partial(_float, _EXACT, "analog_input/7"),
    },
    real=_real,
    texts=Texts(encoding="utf-8", longest=_LONGEST_TEXT, read=_read_text, write=_write_text),
    device_texts=_device_texts,
)
