"""What checks for every protocol do on BACnet: an analog input that is read, a commandable output that is written."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from ..exercise import Asked, Clamped, Contended, DeviceText, Exercise, Limited, Texts
from ..journal import Entries, JournalEntry
from ..point import Point, half, large
from .entries import as_bacnet, changes
from .points import DEVICE, LEVEL, MODE, PRIORITY, SUPPLY, VALVE, ZONE, alias, positive_half, setting, value_of

__all__ = ["EXERCISE"]

_ZONE, _SUPPLY, _VALVE = map(value_of, (ZONE, SUPPLY, VALVE))
_ZONE_ALIAS, _VALVE_ALIAS = alias("otmcp_zone", ZONE), alias("otmcp_valve", VALVE)


def _further(kind: str) -> Point:
    """Return an object of a datatype that few devices have."""
    return value_of((kind, 1), further=True)


_TEXT = _further("characterstring-value")


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    return changes(entries)


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    # Objects that the device has from the start: an adapter may have listed them then.
    reals = [point.read(half(rng)) for point in (_ZONE, _SUPPLY, _VALVE)]
    known = [*reals, LEVEL.read(rng.randrange(20) / 2), MODE.read(rng.randrange(1, 4))]
    return tuple(known[index % len(known)] for index in range(count))


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    value = half(rng)
    return (
        _SUPPLY.read(half(rng)),
        _SUPPLY.read(-abs(half(rng))),
        LEVEL.read(rng.randrange(20) / 2),
        *map(MODE.read, (1, 2, 3)),
        _ZONE_ALIAS.read(value),
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value, limit, state = rng.randrange(1, 2**20) + 0.5, rng.randrange(1, 20) / 2, rng.randrange(2, 4)
    slot = {f"analog-output,1/priority-array/{PRIORITY}": value}
    return (
        # Objects without a priority array: an adapter that takes no priority changes no other points than these.
        LEVEL.write(limit, before=0.0),
        MODE.write(state, before=1),
        replace(
            _VALVE_ALIAS.write(value),
            pokes=(setting(VALVE, None, PRIORITY),),
            points={**_VALVE.held(value), **slot},
        ),
    )


def _clamped(rng: random.Random) -> Clamped:
    highest = rng.randrange(1, 10) / 2
    asked = LEVEL.write(highest + 2.5, before=0.0)
    return Clamped(write=asked, output="value", held=highest, action={"clamp": [0, highest]})


def _contended(rng: random.Random) -> Contended:
    return LEVEL.contended(*(value / 2 for value in rng.sample(range(20), 3)))


def _asks_for(entry: JournalEntry) -> object:
    writes = as_bacnet(entry).get("writes", [])
    return writes[0]["values"][0]["value"] if len(writes) == 1 and len(writes[0]["values"]) == 1 else None


_real = partial(_VALVE.write, before=0.0)


def _bounds() -> tuple[tuple[Asked, object], ...]:
    # The device itself limits what the states of a multi-state object may be; its type is Unsigned.
    return *_VALVE.bounds(before=0.0), (MODE.write(1, before=2), -1)


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    # Null is no misfit: it gives the priority up.
    return (
        (_real(7.5), ("abc", "7.5", True, [7.5])),
        (MODE.write(2, before=1), (1.5, "abc", [2])),
    )


def _write_text(text: str) -> Asked:
    return _TEXT.write(text, before="")


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The multi-state value is what a list can allow.
    value = rng.randrange(1, 2**20) + 0.5
    return MODE.write(rng.randrange(2, 4)), _VALVE.write(value), _VALVE_ALIAS.write(value)


def _listed(text: str) -> Asked:
    pokes = ({"object": "analog-input,2", "name": text},)
    return Asked(operation="list_objects", inputs={"device": DEVICE}, pokes=pokes)


def _found(text: str) -> Asked:
    return Asked(operation="discover", inputs={}, pokes=({"object": f"device,{DEVICE}", "name": text},))


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (
        DeviceText(place="a characterstring value", ask=_TEXT.read, longest=200),
        DeviceText(place="the name of an object", ask=_listed, longest=200),
        DeviceText(place="the name of the device", ask=_found, longest=200),
    )


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    if operation != "write":
        return {}
    target = f"{inputs['type']},{inputs['instance']}"
    commandable = str(inputs["type"]).endswith("-output")
    at_priority = {f"{target}/priority-array/{inputs['priority']}": inputs["value"]} if commandable else {}
    return {f"{target}/present-value": inputs["value"], **at_priority}


def _refusals(entry: JournalEntry) -> list[str]:
    told = as_bacnet(entry)
    errors = [part["error"] for part in (told, *told.get("results", [])) if "error" in part]
    reasons = [f"{kind}-{told[kind]}" for kind in ("reject", "abort") if kind in told]
    return [*(f"{error[0]},{error[1]}" for error in errors), *reasons]


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read",
    read=lambda rng: _ZONE.read(positive_half(rng)),
    writing="write",
    write=lambda rng: _VALVE.write(positive_half(rng)),
    number="value",
    # A value is a number, a text, a state or null, as the property has it.
    bounded=("device", "instance", "priority"),
    done=_done,
    reads=({"service": 12}, {"service": 14}),
    writes=({"service": 15}, {"service": 16}),
    refusals=_refusals,
    silent=({"action": {"drop": True}},),
    # Datagrams have no connection that could be reset: what comes nearest is an answer that is lost.
    reset=({"action": {"drop": True}},),
    refused=({"action": {"error": [0, 25]}},),
    write_refused=({"error": [0, 25]}, "device_failure"),
    # An instance has 22 bits (clause 20.2.14).
    outside={
        "device": (-1, 2**22 + DEVICE, 2**31, 12345.5, "0x3039"),
        "instance": (-1, 2**22 + 1, 2**31, 1.5, "0x1"),
        "priority": (-1, 0, 17, 2**8 + PRIORITY, 8.5, "0x8"),
    },
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    clamped=_clamped,
    contended=_contended,
    fenced=_fenced,
    limited={"analog-value,9/present-value": Limited(ways=(LEVEL.write,), unit=0.5)},
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    large=large(_further("integer-value"), _further("positive-integer-value")),
    floats={"float32": _further("analog-input").read, "float64": _further("large-analog-value").read},
    real=_real,
    texts=Texts(encoding="utf-8", longest=200, limited=False, read=_TEXT.read, write=_write_text),
    device_texts=_device_texts,
)
