"""What checks for every protocol do on S7: values of the data block that belongs to the clients, and one bit of the flags."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from ..exercise import Asked, Contended, DeviceText, Exercise, Limited, Texts, every_change
from ..journal import JournalEntry
from ..point import different_bytes, large
from .entries import as_s7, points
from .points import BLOCK, DECLARED, KINDS, PLANT, of_bytes, value_at

__all__ = ["EXERCISE"]

_READ, _WRITTEN = value_at(6), value_at(2)
_TARGET = value_at(12, "DINT")
"""A value that the plant does not follow."""
_FREE = {kind: value_at(48, kind) for kind in KINDS}
"""Values of each type, in bytes that nothing uses."""
_TEXT = value_at(160, "STRING", PLANT)
_FIRST, _MARKER = 20, 3
"""The first byte of the larger data block that the plant leaves alone; a byte of the flags."""
_WHOLE = ("SINT", "USINT", "INT", "UINT", "DINT", "UDINT")


def _write(rng: random.Random) -> Asked:
    return _WRITTEN.write(rng.randrange(2, 0x8000))


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    places = (value_at(start, db=PLANT) for start in range(_FIRST, _FIRST + 2 * count, 2))
    return tuple(place.read(place.kind.any(rng)) for place in places)


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    return of_bytes(48, 6).read(list(rng.randbytes(6))), *_typed(rng)


def _typed(rng: random.Random) -> Iterator[Asked]:
    yield from map(_FREE["BOOL"].read, (True, False))
    kinds = ("BYTE", "WORD", "DWORD", "USINT", "UINT", "UDINT", "SINT", "INT", "DINT", "REAL", "LREAL")
    yield from (_FREE[kind].read(KINDS[kind].telling(rng)) for kind in kinds)


def _flag(bit: int, before: bytes = b"") -> Asked:
    """Return the write of a bit of the flags.

    Args:
        before: its byte and those beside it, which are set before; none are where it is empty.
    """
    flags = before[1] if before else 0
    return Asked(
        operation="write_marker",
        inputs={"byte": _MARKER, "bit": bit, "value": True},
        pokes=({"area": "M", "byte": _MARKER - 1, "data": before.hex()},) if before else (),
        points=points("M", _MARKER, bytes([flags | 1 << bit])),
    )


def _mode(state: str, *before: str) -> Asked:
    """Return the start or the stop of the CPU."""
    pokes = tuple({"cpu": one} for one in before)
    return Asked(operation="set_cpu_state", inputs={"state": state}, pokes=pokes, points={"CPU": state})


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value, bit = rng.randrange(2, 0x8000), rng.randrange(8)
    # Neighbours have values of their own, so that one that is written as well is noticed.
    first, second, third, fourth = rng.randbytes(4)
    flags = rng.randrange(0x100) & ~(1 << bit)
    around = of_bytes(0, 6).pokes((first, second, 0, 0, third, fourth))
    return (
        replace(_WRITTEN.write(value), pokes=around),
        _flag(bit, bytes([first, flags, second])),
        _mode("STOP", "RUN"),
        _mode("RUN", "STOP"),
    )


def _contended(rng: random.Random) -> Contended:
    return _TARGET.contended(*different_bytes(rng, ">i"))


def _asks_for(entry: JournalEntry) -> object:
    items = as_s7(entry).get("items", [])
    if len(items) != 1 or "data" not in items[0]:
        return None
    return int.from_bytes(bytes.fromhex(items[0]["data"]), "big", signed=True)


def _bounds() -> tuple[tuple[Asked, object], ...]:
    return *(pair for kind in _WHOLE for pair in _FREE[kind].bounds()), _FREE["REAL"].bounds()[0]


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    return _FREE["INT"].misfits(), _FREE["REAL"].misfits(), (_flag(0), ("false", "off", None))


def _write_text(text: str) -> Asked:
    return _TEXT.write(text, before="")


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The INT from byte 2 on is what a list can allow.
    places = [*map(value_at, (2, 1, 3, 4)), value_at(2, "DINT"), value_at(0, "DINT"), value_at(_FIRST, db=PLANT)]
    drawn = (struct.unpack(f">{place.kind.form}", rng.randbytes(place.kind.size))[0] for place in places)
    return *(place.write(value) for place, value in zip(places, drawn, strict=True)), _flag(2), _mode("STOP")


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (DeviceText(place="a STRING", ask=_TEXT.read, longest=DECLARED, encoding="latin-1"),)


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    kind = str(inputs.get("type"))
    if operation != "write_db" or kind not in KINDS or kind in ("BOOL", "STRING"):
        return {}
    try:
        return value_at(inputs["start"], kind, inputs["db"]).held(inputs["value"])
    except struct.error:
        # The type has no such value.
        return {}


def _refusals(entry: JournalEntry) -> list[str]:
    told = as_s7(entry)
    return [
        str(code) for code in (told.get("error"), told.get("code"), *(one.get("code") for one in told.get("items", [])))
    ]


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read_typed",
    read=lambda rng: _READ.read(_READ.kind.any(rng)),
    writing="write_db",
    write=_write,
    number="value",
    bounded=("db", "start"),
    done=every_change,
    reads=({"service": "read"},),
    writes=({"service": "write"},),
    refusals=_refusals,
    silent=({"action": {"drop": True}},),
    reset=({"action": {"reset": True}},),
    refused=({"action": {"error": 0x8104}},),
    write_refused=({"return_code": 1}, "device_failure"),
    # An address has 16 bits for the data block and 21 for the byte.
    outside={
        "db": (-1, 2**16, 2**16 + BLOCK, 2**31, 10.5, "0x0a"),
        "start": (-1, 2**21 + 2, 2**31, 6.5, "0x6"),
    },
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={
        "DB10.DBD12": Limited(ways=(_TARGET.write,), unit=1),
        "DB10.DBW48": Limited(ways=(_FREE["INT"].write,), unit=1),
    },
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    large=large(_FREE["LINT"], _FREE["ULINT"]),
    floats={"float32": _FREE["REAL"].read, "float64": _FREE["LREAL"].read},
    real=_FREE["REAL"].write,
    texts=Texts(encoding="latin-1", longest=DECLARED, read=_TEXT.read, write=_write_text),
    device_texts=_device_texts,
)
