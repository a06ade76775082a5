"""What checks for every protocol do on BACnet: an analog input that is read, a commandable output that is written."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from ..exercise import LARGEST_FLOAT32, Asked, Clamped, Contended, DeviceText, Exercise, Limited, Texts
from ..journal import Entries, JournalEntry
from .entries import as_bacnet, changes

__all__ = ["EXERCISE"]

_DEVICE, _PRIORITY = 12345, 8
_LIMIT, _MODE = ("analog-value", 9), ("multi-state-value", 1)
_REALS = (("analog-input", 1), ("analog-input", 2), ("analog-output", 1))
"""Objects whose present value is any REAL that is set at the mock."""
_ALIASES = ("otmcp_zone", "otmcp_valve")
"""Names that a launch of an adapter with names of its own has for the analog input 1, and for the analog output 1 at priority 8."""


def _read(rng: random.Random) -> Asked:
    # Halves below 2 to the 20 are exact in a REAL.
    value = rng.randrange(2**20) + 0.5
    return Asked(
        operation="read",
        inputs={"device": _DEVICE, "type": "analog-input", "instance": 1},
        outputs={"value": value},
        pokes=({"object": "analog-input,1", "value": value},),
    )


def _write(rng: random.Random) -> Asked:
    value = rng.randrange(2**20) + 0.5
    return Asked(
        operation="write",
        inputs={
            "device": _DEVICE,
            "type": "analog-output",
            "instance": 1,
            "value": value,
            "priority": _PRIORITY,
        },
        outputs={"value": value},
        points={"analog-output,1/present-value": value},
    )


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    return changes(entries)


def _at(kind: str, instance: int) -> dict[str, object]:
    return {"device": _DEVICE, "type": kind, "instance": instance}


def _value(rng: random.Random) -> float:
    # Halves below 2 to the 20 are exact in a REAL.
    return rng.randrange(-(2**20), 2**20) + 0.5


def _reading(kind: str, instance: int, value: object) -> Asked:
    return Asked(
        operation="read",
        inputs=_at(kind, instance),
        outputs={"value": value},
        pokes=({"object": f"{kind},{instance}", "value": value},),
    )


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    # Objects that the device has from the start: an adapter may have listed them then.
    reals = (_reading(kind, instance, _value(rng)) for kind, instance in _REALS)
    objects = [*reals, _reading(*_LIMIT, rng.randrange(20) / 2), _reading(*_MODE, rng.randrange(1, 4))]
    known = [replace(one, condition={"object": one.pokes[0]["object"]}) for one in objects]
    return tuple(known[index % len(known)] for index in range(count))


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    value = _value(rng)
    return (
        _reading("analog-input", 2, _value(rng)),
        _reading("analog-input", 2, -abs(_value(rng))),
        _reading(*_LIMIT, rng.randrange(20) / 2),
        *(_reading(*_MODE, state) for state in (1, 2, 3)),
        Asked(
            operation="read_alias",
            inputs={"name": _ALIASES[0]},
            outputs={"value": value},
            pokes=({"object": "analog-input,1", "value": value},),
        ),
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value, limit, state = rng.randrange(1, 2**20) + 0.5, rng.randrange(1, 20) / 2, rng.randrange(2, 4)
    return (
        # Objects without a priority array: an adapter that takes no priority changes no other points than these.
        _writing(*_LIMIT, limit, before=0.0),
        _writing(*_MODE, state, before=1),
        Asked(
            operation="write_alias",
            inputs={"name": _ALIASES[1], "value": value},
            pokes=({"object": "analog-output,1", "priority": _PRIORITY, "value": None},),
            points={
                "analog-output,1/present-value": value,
                f"analog-output,1/priority-array/{_PRIORITY}": value,
            },
        ),
    )


def _writing(kind: str, instance: int, value: object, *, before: object) -> Asked:
    return Asked(
        operation="write",
        inputs={**_at(kind, instance), "value": value, "priority": _PRIORITY},
        pokes=({"object": f"{kind},{instance}", "value": before},),
        points={f"{kind},{instance}/present-value": value},
    )


def _clamped(rng: random.Random) -> Clamped:
    highest = rng.randrange(1, 10) / 2
    asked = _writing(*_LIMIT, highest + 2.5, before=0.0)
    return Clamped(write=asked, output="value", held=highest, action={"clamp": [0, highest]})


def _contended(rng: random.Random) -> Contended:
    old, *new = (value / 2 for value in rng.sample(range(20), 3))
    return Contended(
        old=old,
        new=tuple(new),
        pokes=({"object": "analog-value,9", "value": old},),
        read=Asked(operation="read", inputs=_at(*_LIMIT)),
        output="value",
        writes=tuple(_writing(*_LIMIT, value, before=old) for value in new),
    )


def _asks_for(entry: JournalEntry) -> object:
    writes = as_bacnet(entry).get("writes", [])
    return writes[0]["values"][0]["value"] if len(writes) == 1 and len(writes[0]["values"]) == 1 else None


def _further(kind: str, value: object, outputs: dict[str, object]) -> Asked:
    """Return the read of an object of a datatype that few devices have."""
    asked = _reading(kind, 1, value)
    return replace(asked, pokes=({"types": True}, *asked.pokes), outputs=outputs)


def _large(values: Sequence[int], signed: bool) -> tuple[Asked, ...]:
    kind = "integer-value" if signed else "positive-integer-value"
    return tuple(_further(kind, value, {"value": value}) for value in values)


def _float(kind: str, value: float) -> Asked:
    return _further(kind, value if math.isfinite(value) else str(value), {"value": value})


def _real(value: float) -> Asked:
    return _writing("analog-output", 1, value, before=0.0)


def _bounds() -> tuple[tuple[Asked, object], ...]:
    # The device itself limits what the states of a multi-state object may be; its type is Unsigned.
    return (
        (_real(LARGEST_FLOAT32), 1e39),
        (_real(-LARGEST_FLOAT32), -1e39),
        (_writing(*_MODE, 1, before=2), -1),
    )


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    # Null is no misfit: it gives the priority up.
    return (
        (_real(7.5), ("abc", "7.5", True, [7.5])),
        (_writing(*_MODE, 2, before=1), (1.5, "abc", [2])),
    )


def _read_text(text: str) -> Asked:
    return _further("characterstring-value", text, {"value": text})


def _write_text(text: str) -> Asked:
    asked = _writing("characterstring-value", 1, text, before="")
    return replace(asked, pokes=({"types": True}, *asked.pokes))


def _present(kind: str, instance: int, value: object) -> Asked:
    return Asked(
        operation="write",
        inputs={**_at(kind, instance), "value": value, "priority": _PRIORITY},
        points={f"{kind},{instance}/present-value": value},
    )


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The multi-state value is what a list can allow.
    value = rng.randrange(1, 2**20) + 0.5
    return (
        _present(*_MODE, rng.randrange(2, 4)),
        _present("analog-output", 1, value),
        Asked(
            operation="write_alias",
            inputs={"name": _ALIASES[1], "value": value},
            points={"analog-output,1/present-value": value},
        ),
    )


def _listed(text: str) -> Asked:
    pokes = ({"object": "analog-input,2", "name": text},)
    return Asked(operation="list_objects", inputs={"device": _DEVICE}, pokes=pokes)


def _found(text: str) -> Asked:
    return Asked(operation="discover", inputs={}, pokes=({"object": f"device,{_DEVICE}", "name": text},))


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (
        DeviceText(place="a characterstring value", ask=_read_text, longest=200),
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
    read=_read,
    writing="write",
    write=_write,
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
        "device": (-1, 2**22 + _DEVICE, 2**31, 12345.5, "0x3039"),
        "instance": (-1, 2**22 + 1, 2**31, 1.5, "0x1"),
        "priority": (-1, 0, 17, 2**8 + _PRIORITY, 8.5, "0x8"),
    },
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    clamped=_clamped,
    contended=_contended,
    fenced=_fenced,
    limited={"analog-value,9/present-value": Limited(ways=(partial(_present, *_LIMIT),), unit=0.5)},
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    large=_large,
    floats={"float32": partial(_float, "analog-input"), "float64": partial(_float, "large-analog-value")},
    real=_real,
    texts=Texts(encoding="utf-8", longest=200, limited=False, read=_read_text, write=_write_text),
    device_texts=_device_texts,
)
