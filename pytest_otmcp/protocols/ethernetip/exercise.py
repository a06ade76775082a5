"""What checks for every protocol do on EtherNet/IP: tags that belong to the clients, of every elementary type, and a STRING."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any

from ..exercise import Asked, DeviceText, Exercise, Limited, Texts, every_change, number_in_json
from ..journal import JournalEntry
from ..point import Point, different_bytes, half, large
from .entries import as_ethernetip
from .points import ARRAY, ELEMENT, KINDS, LEVEL, TARGET, array, elements, poke, tag

__all__ = ["EXERCISE"]

_WRITTEN, _CONTENDED, _BIT_TAG = "HeaterPower", "BatchTarget", "Flags"
_HEATER, _VALVE = tag(_WRITTEN), tag("ValvePosition", alias="otmcp_valve")
_LONGEST_TEXT = 82
"""Characters of a STRING."""
_TEXT = tag("FreeString", "STRING")
_SIGNED, _UNSIGNED = ("SINT", "INT", "DINT", "LINT"), ("USINT", "UINT", "UDINT", "ULINT")


def _free(kind: str) -> Point:
    return tag(f"Free{kind.capitalize()}", kind)


def _exact_bits(kind: str) -> int:
    """Return the bits of a whole number that every JSON number has exactly."""
    return min(8 * KINDS[kind].size, 53)


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    return tuple(tag(name, ELEMENT).any(rng) for name in elements(0, count))


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    values = [KINDS[ELEMENT].any(rng) for _ in range(6)]
    block = array(8, len(values)).read(values)
    level, step = half(rng), rng.randrange(2**31)
    return (
        block,
        Asked(
            operation="read_tags",
            inputs={"tags": [f"{ARRAY}[8]", f"{ARRAY}[10]", f"{ARRAY}[9]"]},
            outputs={"values": [values[0], values[2], values[1]]},
            pokes=block.pokes,
        ),
        LEVEL.read(level),
        tag("Program:MainProgram.Step").read(step),
        tag("Recipe.Rate").read(level),
        *map(_free("BOOL").read, (True, False)),
        *(_free(kind).read(-rng.randrange(1, 2 ** (_exact_bits(kind) - 1))) for kind in _SIGNED),
        # With a sign each of them would be another value.
        *(_free(kind).read(2 ** (_exact_bits(kind) - 1) + 1) for kind in _UNSIGNED),
        *(_free(kind).read(half(rng)) for kind in ("REAL", "LREAL")),
    )


def _clock(second: int) -> Asked:
    moment = datetime(2031, 5, 17, 8, 30, second, tzinfo=UTC).isoformat()
    return Asked(operation="set_clock", inputs={"time": moment}, points={"Clock": moment})


def _batch(values: Mapping[str, object], *, before: object = None) -> Asked:
    items = [{"tag_name": name, "value": value} for name, value in values.items()]
    pokes = () if before is None else tuple(poke(name, before) for name in values)
    return Asked(operation="write_tags", inputs={"items": items}, pokes=pokes, points=values)


def _in_a_batch(name: str, value: float) -> Asked:
    return _batch({name: value})


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value, first, second, bit = (rng.randrange(2, 0x8000) for _ in range(4))
    bit %= 16
    flags = rng.randrange(2**16) & ~(1 << bit)
    values = [rng.randrange(1, 0x8000) for _ in range(3)]
    # Neighbours have values of their own, so that one that is written as well is noticed.
    around = array(19, 5).pokes([rng.randrange(-0x8000, 0) for _ in range(5)])
    return (
        _HEATER.write(value, before=1),
        replace(
            tag(f"{_BIT_TAG}.{bit}", "BOOL").writes(True),
            pokes=(poke(_BIT_TAG, flags),),
            points={_BIT_TAG: flags | 1 << bit},
        ),
        replace(array(20, 3).write(values), pokes=around),
        _batch({_WRITTEN: first, _CONTENDED: second}, before=1),
        _VALVE.write(value, before=1),
        _clock(rng.randrange(60)),
    )


def _asks_for(entry: JournalEntry) -> object:
    items = as_ethernetip(entry).get("items", [])
    if len(items) != 1 or items[0].get("asks") != "write" or "data" not in items[0]:
        return None
    return int.from_bytes(bytes.fromhex(items[0]["data"]), "little", signed=True)


def _float(kind: str, value: float) -> Asked:
    return _free(kind).read(number_in_json(value))


def _bounds() -> tuple[tuple[Asked, object], ...]:
    # Bounds of 64 bits are no numbers of JSON that every client keeps.
    kinds = (*_SIGNED[:3], *_UNSIGNED[:3])
    return *(pair for kind in kinds for pair in _free(kind).bounds()), _free("REAL").bounds()[0]


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    return _HEATER.misfits(), _free("REAL").misfits(), (_free("BOOL").write(True), ("false", "off", 5, None))


def _write_text(text: str) -> Asked:
    return _TEXT.write(text, before="")


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # HeaterPower and the elements 20 to 22 are what a list can allow.
    def numbers(count: int) -> list[int]:
        return [rng.randrange(1, 0x8000) for _ in range(count)]

    def block(first: int, count: int) -> Asked:
        return array(first, count).write(numbers(count))

    def batch(*tags: str) -> Asked:
        return _batch(dict(zip(tags, numbers(len(tags)), strict=True)))

    one, other, another, valve = numbers(4)
    free = "FreeDint"
    return (
        _HEATER.write(one),
        block(20, 3),
        block(19, 2),
        block(22, 2),
        tag(f"{ARRAY}[19]", ELEMENT).write(other),
        tag(f"{ARRAY}[23]", ELEMENT).write(another),
        batch(_WRITTEN, f"{ARRAY}[21]"),
        batch(_WRITTEN, free),
        batch(free, _WRITTEN),
        _VALVE.write(valve),
        _free("BOOL").write(True),
        _clock(0),
    )


def _listed(text: str) -> Asked:
    return Asked(operation="list_tags", inputs={}, pokes=({"create": text},))


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (
        DeviceText(place="a STRING", ask=_TEXT.read, longest=82, encoding="latin-1"),
        DeviceText(place="the name of a tag", ask=_listed, longest=200, encoding="latin-1"),
    )


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    if operation == "write_tag":
        return {inputs["tag"]: inputs["value"]}
    items = inputs["items"] if operation == "write_tags" else ()
    return {item["tag_name"]: item["value"] for item in items}


def _refusals(entry: JournalEntry) -> list[str]:
    told = as_ethernetip(entry)
    found = []
    for part in (told, *told.get("items", [])):
        status, extended = part.get("status"), part.get("extended")
        if status is not None:
            found += [f"{status:02X}", *([] if extended is None else [f"{status:02X}/{extended:04X}"])]
    return found


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read_tag",
    read=tag("FanSpeed").any,
    writing="write_tag",
    write=lambda rng: _HEATER.write(rng.randrange(2, 2**31)),
    number="value",
    bounded=(),
    done=every_change,
    reads=({"service": "read"},),
    writes=({"service": "write"},),
    refusals=_refusals,
    silent=({"action": {"drop": True}},),
    reset=({"action": {"reset": True}},),
    refused=({"action": {"status": 0x0F}},),
    write_refused=({"status": 0x10}, "device_busy"),
    # Names that no request can carry; an index of 32 bits, or the length of a name, cut down to fit would make known ones of the last two.
    outside={
        "tag": (
            *("", " ", f"{ARRAY}[-1]", f"{ARRAY}[0.5]", f"{ARRAY}[0x14]", f"{ARRAY}[20"),
            *(f"{ARRAY}[{2**32 + 20}]", _WRITTEN + 2**8 * "x"),
        ),
    },
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=lambda rng: TARGET.contended(*different_bytes(rng, "<i")),
    fenced=_fenced,
    limited={
        name: Limited(ways=(tag(name).write, partial(_in_a_batch, name)), unit=1) for name in (_CONTENDED, "FanSpeed")
    },
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    large=large(_free("LINT"), _free("ULINT")),
    floats={"float32": partial(_float, "REAL"), "float64": partial(_float, "LREAL")},
    real=_free("REAL").write,
    texts=Texts(encoding="latin-1", longest=_LONGEST_TEXT, read=_TEXT.read, write=_write_text),
    device_texts=_device_texts,
)
