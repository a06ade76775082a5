"""What checks for every protocol do on S7: values of the data block that belongs to the clients, and one bit of the flags."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator, Mapping, Sequence
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
)
from ..journal import JournalEntry
from .entries import as_s7, points

__all__ = ["EXERCISE"]

_BLOCK, _READ, _WRITTEN = 10, 6, 2
_TARGET = 12
"""Byte of a DINT that the plant does not follow."""
_FREE, _LARGE, _FIRST = 48, 1, 20
"""First byte of those that nothing uses; number of a larger data block, and the first byte there that the plant leaves alone."""
_FORMS = {"BYTE": "B", "WORD": "H", "DWORD": "I", "INT": "h", "DINT": "i", "REAL": "f", "LREAL": "d"}
_MARKER = 3
_TEXT, _DECLARED = 160, 60
"""First byte of a STRING in the larger data block, and the length that it is declared with."""


def _read(rng: random.Random) -> Asked:
    value = rng.randrange(-0x8000, 0x8000)
    poke = {"area": f"DB{_BLOCK}", "byte": _READ, "data": value.to_bytes(2, "big", signed=True).hex()}
    return Asked(
        operation="read_typed",
        inputs={"db": _BLOCK, "start": _READ, "type": "INT"},
        outputs={"value": value},
        pokes=(poke,),
    )


def _write(rng: random.Random) -> Asked:
    value = rng.randrange(2, 0x8000)
    return Asked(
        operation="write_db",
        inputs={"db": _BLOCK, "start": _WRITTEN, "type": "INT", "value": value},
        outputs={"value": value},
        points=points(f"DB{_BLOCK}", _WRITTEN, value.to_bytes(2, "big")),
    )


def _poke(byte: int, content: bytes, area: str = f"DB{_BLOCK}") -> dict[str, object]:
    return {"area": area, "byte": byte, "data": content.hex()}


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    values = [rng.randrange(-0x8000, 0x8000) for _ in range(count)]
    return tuple(
        Asked(
            operation="read_typed",
            inputs={"db": _LARGE, "start": start, "type": "INT"},
            outputs={"value": value},
            pokes=(_poke(start, struct.pack(">h", value), f"DB{_LARGE}"),),
            condition={"service": "read", "db": _LARGE, "byte": start},
        )
        for start, value in zip(range(_FIRST, _FIRST + 2 * count, 2), values, strict=True)
    )


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    content = rng.randbytes(6)
    return (
        Asked(
            operation="read_db",
            inputs={"db": _BLOCK, "start": _FREE, "size": len(content)},
            outputs={"values": list(content)},
            pokes=(_poke(_FREE, content),),
        ),
        *(
            Asked(
                operation="read_typed",
                inputs={"db": _BLOCK, "start": _FREE, "type": kind},
                outputs={"value": value},
                pokes=(_poke(_FREE, held),),
            )
            for kind, value, held in _typed(rng)
        ),
    )


def _typed(rng: random.Random) -> Iterator[tuple[str, object, bytes]]:
    """Yield values of each type, with their bytes; read with another sign, or as another type, each would be another value."""
    # The other bits of a BOOL's byte are somebody else's.
    yield "BOOL", True, b"\x01"
    yield "BOOL", False, b"\xfe"
    for kind, form in (("BYTE", "B"), ("WORD", "H"), ("DWORD", "I"), ("USINT", "B"), ("UINT", "H"), ("UDINT", "I")):
        bits = 8 * struct.calcsize(f">{form}")
        value = rng.randrange(2 ** (bits - 1), 2**bits)
        yield kind, value, struct.pack(f">{form}", value)
    for kind, form in (("SINT", "b"), ("INT", "h"), ("DINT", "i")):
        value = -rng.randrange(1, 2 ** (8 * struct.calcsize(f">{form}") - 1))
        yield kind, value, struct.pack(f">{form}", value)
    for kind, form in (("REAL", "f"), ("LREAL", "d")):
        # Halves below 2 to the 20 are exact in both.
        real = rng.randrange(-(2**20), 2**20) + 0.5
        yield kind, real, struct.pack(f">{form}", real)


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value, bit = rng.randrange(2, 0x8000), rng.randrange(8)
    # Neighbours have values of their own, so that one that is written as well is noticed.
    around = rng.randbytes(4)
    flags = rng.randrange(0x100) & ~(1 << bit)
    return (
        Asked(
            operation="write_db",
            inputs={"db": _BLOCK, "start": _WRITTEN, "type": "INT", "value": value},
            pokes=(_poke(_WRITTEN - 2, around[:2] + bytes(2) + around[2:]),),
            points=points(f"DB{_BLOCK}", _WRITTEN, struct.pack(">h", value)),
        ),
        Asked(
            operation="write_marker",
            inputs={"byte": _MARKER, "bit": bit, "value": True},
            pokes=(_poke(_MARKER - 1, bytes([around[0], flags, around[1]]), "M"),),
            points=points("M", _MARKER, bytes([flags | 1 << bit])),
        ),
        Asked(operation="set_cpu_state", inputs={"state": "STOP"}, pokes=({"cpu": "RUN"},), points={"CPU": "STOP"}),
        Asked(operation="set_cpu_state", inputs={"state": "RUN"}, pokes=({"cpu": "STOP"},), points={"CPU": "RUN"}),
    )


def _contended(rng: random.Random) -> Contended:
    # Each byte differs, so that a value of parts of two is none of them.
    old, *new = (struct.unpack(">i", bytes(rng.randrange(low, low + 80) for _ in range(4)))[0] for low in (1, 81, 161))
    inputs = {"db": _BLOCK, "start": _TARGET, "type": "DINT"}
    return Contended(
        old=old,
        new=tuple(new),
        pokes=(_poke(_TARGET, struct.pack(">i", old)),),
        read=Asked(operation="read_typed", inputs=inputs),
        output="value",
        writes=tuple(
            Asked(
                operation="write_db",
                inputs={**inputs, "value": value},
                points=points(f"DB{_BLOCK}", _TARGET, struct.pack(">i", value)),
            )
            for value in new
        ),
    )


def _asks_for(entry: JournalEntry) -> object:
    items = as_s7(entry).get("items", [])
    if len(items) != 1 or "data" not in items[0]:
        return None
    return int.from_bytes(bytes.fromhex(items[0]["data"]), "big", signed=True)


def _held(kind: str, content: bytes, outputs: dict[str, object]) -> Asked:
    return Asked(
        operation="read_typed",
        inputs={"db": _BLOCK, "start": _FREE, "type": kind},
        outputs=outputs,
        pokes=(_poke(_FREE, content),),
    )


def _large_numbers(values: Sequence[int], signed: bool) -> tuple[Asked, ...]:
    kind = "LINT" if signed else "ULINT"
    return tuple(_held(kind, value.to_bytes(8, "big", signed=signed), {"value": value}) for value in values)


def _float(kind: str, form: str, value: float) -> Asked:
    return _held(kind, struct.pack(form, value), {"value": value})


def _real(value: float) -> Asked:
    return _write_typed("REAL", ">f", value)


_WHOLE = {"SINT": ">b", "USINT": ">B", "INT": ">h", "UINT": ">H", "DINT": ">i", "UDINT": ">I"}
"""Types of whole numbers to their formats of ``struct``."""


def _write_typed(kind: str, form: str, value: float) -> Asked:
    return Asked(
        operation="write_db",
        inputs={"db": _BLOCK, "start": _FREE, "type": kind, "value": value},
        outputs={"value": value},
        points=points(f"DB{_BLOCK}", _FREE, struct.pack(form, value)),
    )


def _bounds() -> tuple[tuple[Asked, object], ...]:
    found: list[tuple[Asked, object]] = []
    for kind, form in _WHOLE.items():
        bits = 8 * struct.calcsize(form)
        lowest, highest = (0, 2**bits - 1) if kind.startswith("U") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        found += [
            (_write_typed(kind, form, lowest), lowest - 1),
            (_write_typed(kind, form, highest), highest + 1),
        ]
    return (*found, (_write_typed("REAL", ">f", LARGEST_FLOAT32), 1e39))


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    flag = Asked(operation="write_marker", inputs={"byte": _MARKER, "bit": 0, "value": True})
    return (
        (_write_typed("INT", ">h", 7), NO_INTEGERS),
        (_write_typed("REAL", ">f", 7.5), NO_REALS),
        (flag, ("false", "off", None)),
    )


def _string(text: str) -> dict[str, object]:
    content = text.encode("latin-1")
    return _poke(_TEXT, bytes([_DECLARED, len(content)]) + content, f"DB{_LARGE}")


def _read_text(text: str) -> Asked:
    return Asked(
        operation="read_typed",
        inputs={"db": _LARGE, "start": _TEXT, "type": "STRING"},
        outputs={"value": text},
        pokes=(_string(text),),
    )


def _write_text(text: str) -> Asked:
    content = text.encode("latin-1", "replace")
    return Asked(
        operation="write_db",
        inputs={"db": _LARGE, "start": _TEXT, "type": "STRING", "value": text},
        pokes=(_string(""),),
        points=points(f"DB{_LARGE}", _TEXT, bytes([_DECLARED, len(content)]) + content),
    )


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The INT from byte 2 on is what a list can allow.
    kinds = {"INT": ">h", "DINT": ">i"}
    places = ((_BLOCK, 2, "INT"), (_BLOCK, 1, "INT"), (_BLOCK, 3, "INT"), (_BLOCK, 4, "INT"), (_BLOCK, 2, "DINT"))
    found = []
    for db, start, kind in (*places, (_BLOCK, 0, "DINT"), (_LARGE, _FIRST, "INT")):
        content = rng.randbytes(struct.calcsize(kinds[kind]))
        (value,) = struct.unpack(kinds[kind], content)
        inputs = {"db": db, "start": start, "type": kind, "value": value}
        found.append(Asked(operation="write_db", inputs=inputs, points=points(f"DB{db}", start, content)))
    return (
        *found,
        Asked(
            operation="write_marker",
            inputs={"byte": _MARKER, "bit": 2, "value": True},
            points=points("M", _MARKER, bytes([1 << 2])),
        ),
        Asked(operation="set_cpu_state", inputs={"state": "STOP"}, points={"CPU": "STOP"}),
    )


def _whole(start: int, kind: str, value: float) -> Asked:
    return Asked(
        operation="write_db",
        inputs={"db": _BLOCK, "start": start, "type": kind, "value": value},
        points=points(f"DB{_BLOCK}", start, struct.pack(_WHOLE[kind], value)),
    )


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (DeviceText(place="a STRING", ask=_read_text, longest=_DECLARED, encoding="latin-1"),)


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    form = _FORMS.get(str(inputs.get("type"))) if operation == "write_db" else None
    try:
        content = b"" if form is None else struct.pack(f">{form}", inputs["value"])
    except struct.error:
        # The type has no such value.
        content = b""
    return points(f"DB{inputs.get('db')}", inputs["start"], content) if content else {}


def _refusals(entry: JournalEntry) -> list[str]:
    told = as_s7(entry)
    return [
        str(code) for code in (told.get("error"), told.get("code"), *(one.get("code") for one in told.get("items", [])))
    ]


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read_typed",
    read=_read,
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
        "db": (-1, 2**16, 2**16 + _BLOCK, 2**31, 10.5, "0x0a"),
        "start": (-1, 2**21 + _WRITTEN, 2**31, 6.5, "0x6"),
    },
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={
        "DB10.DBD12": Limited(ways=(partial(_whole, _TARGET, "DINT"),), unit=1),
        "DB10.DBW48": Limited(ways=(partial(_whole, _FREE, "INT"),), unit=1),
    },
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    large=_large_numbers,
    floats={"float32": partial(_float, "REAL", ">f"), "float64": partial(_float, "LREAL", ">d")},
    real=_real,
    texts=Texts(encoding="latin-1", longest=_DECLARED, read=_read_text, write=_write_text),
    device_texts=_device_texts,
)
