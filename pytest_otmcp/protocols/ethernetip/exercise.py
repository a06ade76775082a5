"""What checks for every protocol do on EtherNet/IP: tags that belong to the clients, of every elementary type, and a STRING."""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
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
    every_change,
    number_in_json,
)
from ..journal import JournalEntry
from .entries import as_ethernetip

__all__ = ["EXERCISE"]

_READ, _WRITTEN, _CONTENDED, _BIT_TAG = "FanSpeed", "HeaterPower", "BatchTarget", "Flags"
_ARRAY = "Counts"
_FREE_TEXT = "FreeString"
_LONGEST_TEXT = 82
"""Characters of a STRING."""
_SIGNED = {"SINT": 8, "INT": 16, "DINT": 32, "LINT": 64}
_UNSIGNED = {"USINT": 8, "UINT": 16, "UDINT": 32, "ULINT": 64}
"""Types of whole numbers to their bits."""
_REALS = {"REAL": "<f", "LREAL": "<d"}
_ALIASES = ("otmcp_level", "otmcp_valve")
"""Names that the adapter has for Levels[1] and ValvePosition."""


def _free(kind: str) -> str:
    return f"Free{kind.capitalize()}"


def _poke(tag: str, value: object) -> dict[str, object]:
    return {"tag": tag, "value": value}


def _reading(tag: str, value: object) -> Asked:
    return Asked(
        operation="read_tag",
        inputs={"tag": tag},
        outputs={"value": value},
        pokes=(_poke(tag, value),),
        condition={"service": "read", "tag": tag},
    )


def _writing(tag: str, value: object, kind: str, *, before: object = None) -> Asked:
    return Asked(
        operation="write_tag",
        inputs={"tag": tag, "value": value, "type": kind},
        outputs={"value": value},
        pokes=() if before is None else (_poke(tag, before),),
        points={tag: value},
    )


def _read(rng: random.Random) -> Asked:
    return _reading(_READ, rng.randrange(-(2**31), 2**31))


def _write(rng: random.Random) -> Asked:
    return _writing(_WRITTEN, rng.randrange(2, 2**31), "DINT")


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    return tuple(_reading(f"{_ARRAY}[{index}]", rng.randrange(-0x8000, 0x8000)) for index in range(count))


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    values = [rng.randrange(-0x8000, 0x8000) for _ in range(6)]
    pokes = tuple(_poke(f"{_ARRAY}[{8 + index}]", value) for index, value in enumerate(values))
    level, step = rng.randrange(-(2**20), 2**20) + 0.5, rng.randrange(2**31)
    return (
        Asked(
            operation="read_array",
            inputs={"tag": f"{_ARRAY}[8]", "count": len(values)},
            outputs={"values": values},
            pokes=pokes,
        ),
        Asked(
            operation="read_tags",
            inputs={"tags": [f"{_ARRAY}[8]", f"{_ARRAY}[10]", f"{_ARRAY}[9]"]},
            outputs={"values": [values[0], values[2], values[1]]},
            pokes=pokes,
        ),
        Asked(
            operation="read_alias",
            inputs={"name": _ALIASES[0]},
            outputs={"value": level},
            pokes=(_poke("Levels[1]", level),),
        ),
        _reading("Program:MainProgram.Step", step),
        _reading("Recipe.Rate", level),
        _reading(_free("BOOL"), True),
        _reading(_free("BOOL"), False),
        *(_reading(_free(kind), -rng.randrange(1, 2 ** (min(bits, 53) - 1))) for kind, bits in _SIGNED.items()),
        # With a sign each of them would be another value.
        *(_reading(_free(kind), 2 ** (min(bits, 53) - 1) + 1) for kind, bits in _UNSIGNED.items()),
        # Halves below 2 to the 20 are exact in both.
        *(_reading(_free(kind), rng.randrange(-(2**20), 2**20) + 0.5) for kind in _REALS),
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value, first, second, bit = (rng.randrange(2, 0x8000) for _ in range(4))
    bit %= 16
    flags = rng.randrange(2**16) & ~(1 << bit)
    values = [rng.randrange(1, 0x8000) for _ in range(3)]
    # Neighbours have values of their own, so that one that is written as well is noticed.
    around = tuple(_poke(f"{_ARRAY}[{index}]", rng.randrange(-0x8000, 0)) for index in range(19, 24))
    moment = datetime(2031, 5, 17, 8, 30, rng.randrange(60), tzinfo=UTC)
    return (
        _writing(_WRITTEN, value, "DINT", before=1),
        Asked(
            operation="write_tag",
            inputs={"tag": f"{_BIT_TAG}.{bit}", "value": True, "type": "BOOL"},
            pokes=(_poke(_BIT_TAG, flags),),
            points={_BIT_TAG: flags | 1 << bit},
        ),
        Asked(
            operation="write_array",
            inputs={"tag": f"{_ARRAY}[20]", "values": values},
            pokes=around,
            points={f"{_ARRAY}[{20 + index}]": one for index, one in enumerate(values)},
        ),
        Asked(
            operation="write_tags",
            inputs={"items": [{"tag_name": _WRITTEN, "value": first}, {"tag_name": _CONTENDED, "value": second}]},
            pokes=(_poke(_WRITTEN, 1), _poke(_CONTENDED, 1)),
            points={_WRITTEN: first, _CONTENDED: second},
        ),
        Asked(
            operation="write_alias",
            inputs={"name": _ALIASES[1], "value": value},
            pokes=(_poke("ValvePosition", 1),),
            points={"ValvePosition": value},
        ),
        Asked(operation="set_clock", inputs={"time": moment.isoformat()}, points={"Clock": moment.isoformat()}),
    )


def _contended(rng: random.Random) -> Contended:
    # Each byte differs, so that a value of parts of two is none of them.
    old, *new = (struct.unpack("<i", bytes(rng.randrange(low, low + 80) for _ in range(4)))[0] for low in (1, 81, 161))
    return Contended(
        old=old,
        new=tuple(new),
        pokes=(_poke(_CONTENDED, old),),
        read=Asked(operation="read_tag", inputs={"tag": _CONTENDED}),
        output="value",
        writes=tuple(_writing(_CONTENDED, value, "DINT") for value in new),
    )


def _asks_for(entry: JournalEntry) -> object:
    items = as_ethernetip(entry).get("items", [])
    if len(items) != 1 or items[0].get("asks") != "write" or "data" not in items[0]:
        return None
    return int.from_bytes(bytes.fromhex(items[0]["data"]), "little", signed=True)


def _large_numbers(values: Sequence[int], signed: bool) -> tuple[Asked, ...]:
    return tuple(_reading(_free("LINT" if signed else "ULINT"), value) for value in values)


def _float(kind: str, value: float) -> Asked:
    return _reading(_free(kind), number_in_json(value))


def _real(value: float) -> Asked:
    return _writing(_free("REAL"), value, "REAL")


def _bounds() -> tuple[tuple[Asked, object], ...]:
    found: list[tuple[Asked, object]] = []
    # Bounds of 64 bits are no numbers of JSON that every client keeps.
    for kind, bits in {**_SIGNED, **_UNSIGNED}.items():
        lowest = 0 if kind in _UNSIGNED else -(2 ** (bits - 1))
        highest = lowest + 2**bits - 1
        if bits < 64:
            found += [
                (_writing(_free(kind), lowest, kind), lowest - 1),
                (_writing(_free(kind), highest, kind), highest + 1),
            ]
    return (*found, (_writing(_free("REAL"), LARGEST_FLOAT32, "REAL"), 1e39))


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    return (
        (_writing(_WRITTEN, 7, "DINT"), NO_INTEGERS),
        (_writing(_free("REAL"), 7.5, "REAL"), NO_REALS),
        (_writing(_free("BOOL"), True, "BOOL"), ("false", "off", 5, None)),
    )


def _read_text(text: str) -> Asked:
    return _reading(_FREE_TEXT, text)


def _write_text(text: str) -> Asked:
    return Asked(
        operation="write_tag",
        inputs={"tag": _FREE_TEXT, "value": text, "type": "STRING"},
        pokes=(_poke(_FREE_TEXT, ""),),
        points={_FREE_TEXT: text},
    )


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # HeaterPower and the elements 20 to 22 are what a list can allow.
    def numbers(count: int) -> list[int]:
        return [rng.randrange(1, 0x8000) for _ in range(count)]

    def elements(first: int, count: int) -> Asked:
        values = numbers(count)
        return Asked(
            operation="write_array",
            inputs={"tag": f"{_ARRAY}[{first}]", "values": values},
            points={f"{_ARRAY}[{first + index}]": value for index, value in enumerate(values)},
        )

    def batch(*tags: str) -> Asked:
        values = dict(zip(tags, numbers(len(tags)), strict=True))
        items = [{"tag_name": tag, "value": value} for tag, value in values.items()]
        return Asked(operation="write_tags", inputs={"items": items}, points=values)

    one, other, another, valve = numbers(4)
    return (
        _writing(_WRITTEN, one, "DINT"),
        elements(20, 3),
        elements(19, 2),
        elements(22, 2),
        _writing(f"{_ARRAY}[19]", other, "INT"),
        _writing(f"{_ARRAY}[23]", another, "INT"),
        batch(_WRITTEN, f"{_ARRAY}[21]"),
        batch(_WRITTEN, _free("DINT")),
        batch(_free("DINT"), _WRITTEN),
        Asked(operation="write_alias", inputs={"name": _ALIASES[1], "value": valve}, points={"ValvePosition": valve}),
        _writing(_free("BOOL"), True, "BOOL"),
        Asked(
            operation="set_clock",
            inputs={"time": "2031-05-17T08:30:00+00:00"},
            points={"Clock": "2031-05-17T08:30:00+00:00"},
        ),
    )


def _in_a_batch(tag: str, value: float) -> Asked:
    items = [{"tag_name": tag, "value": value}]
    return Asked(operation="write_tags", inputs={"items": items}, points={tag: value})


def _number(tag: str, value: float) -> Asked:
    return _writing(tag, value, "DINT")


def _listed(text: str) -> Asked:
    return Asked(operation="list_tags", inputs={}, pokes=({"create": text},))


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (
        DeviceText(place="a STRING", ask=_read_text, longest=82, encoding="latin-1"),
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
    read=_read,
    writing="write_tag",
    write=_write,
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
            *("", " ", f"{_ARRAY}[-1]", f"{_ARRAY}[0.5]", f"{_ARRAY}[0x14]", f"{_ARRAY}[20"),
            *(f"{_ARRAY}[{2**32 + 20}]", _WRITTEN + 2**8 * "x"),
        ),
    },
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={
        tag: Limited(ways=(partial(_number, tag), partial(_in_a_batch, tag)), unit=1)
        for tag in (_CONTENDED, "FanSpeed")
    },
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    large=_large_numbers,
    floats={"float32": partial(_float, "REAL"), "float64": partial(_float, "LREAL")},
    real=_real,
    texts=Texts(encoding="latin-1", longest=_LONGEST_TEXT, read=_read_text, write=_write_text),
    device_texts=_device_texts,
)
