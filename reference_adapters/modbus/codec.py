"""Typed values in registers: width, sign, byte and word order (MODBUS Application Protocol V1.1b3, section 4.2).

``ABCD`` is the specification's order: most significant byte and word first. ``CDAB`` swaps the words, ``BADC`` the bytes
of each word, ``DCBA`` both.
"""

from __future__ import annotations

import math
import struct
from typing import Literal

from typing_extensions import TypedDict

from ..core import AdapterError, exact_in_json, special_name

__all__ = ["DataType", "Order", "Value", "decode", "encode", "width"]

DataType = Literal["int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]
Order = Literal["ABCD", "CDAB", "BADC", "DCBA"]

_FORMATS = {
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


class Value(TypedDict):
    """A value object: ``special`` is NaN, Infinity or -Infinity where ``value`` is null for want of a JSON number;
    integers beyond 2^53 - 1 are decimal strings; ``raw`` is the registers' bytes in hexadecimal."""

    type: str
    value: int | float | str | None
    special: str | None
    raw: str
    quality: str


def width(kind: DataType) -> int:
    """Return the number of registers that a value of this type occupies."""
    return struct.calcsize(f">{_FORMATS[kind]}") // 2


def _arranged(data: bytes, order: Order) -> bytes:
    words = [data[i : i + 2] for i in range(0, len(data), 2)]
    if order in ("CDAB", "DCBA"):
        words.reverse()
    if order in ("BADC", "DCBA"):
        words = [word[::-1] for word in words]
    return b"".join(words)


def decode(registers: list[int], kind: DataType, order: Order) -> Value:
    """Return the value in these registers."""
    raw = struct.pack(f">{len(registers)}H", *registers)
    (value,) = struct.unpack(f">{_FORMATS[kind]}", _arranged(raw, order))
    special = special_name(value)
    value = exact_in_json(value) if special is None else None
    return {"type": kind, "value": value, "special": special, "raw": raw.hex(), "quality": "good"}


def encode(value: float, kind: DataType, order: Order) -> list[int]:
    """Return the registers of a value: an int for the integer types, a finite number for the others.

    Raises:
        AdapterError: ``range_overflow``, the value is outside the type's range.
    """
    try:
        if not math.isfinite(value):
            raise OverflowError
        data = struct.pack(f">{_FORMATS[kind]}", value)
    except (struct.error, OverflowError):
        raise AdapterError("range_overflow", f"the value does not fit into {kind}", field="/value") from None
    return list(struct.unpack(f">{len(data) // 2}H", _arranged(data, order)))
