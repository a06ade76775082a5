"""Registers of numbers, computed without any adapter's code: type, byte order, and whether two numbers have the same bits.

``ABCD`` is the order of the specification (MODBUS Application Protocol V1.1b3, section 4.2): most significant byte and register first.
``CDAB`` has the registers in the other order, ``BADC`` the bytes of each register, ``DCBA`` both.
"""

from __future__ import annotations

import re
import struct

from ...core.strict_json import Wide, same_json

__all__ = ["FORMATS", "ORDERS", "WIDE", "registers", "same_bits", "unpacked"]

FORMATS = {
    "int16": ">h",
    "uint16": ">H",
    "int32": ">i",
    "uint32": ">I",
    "int64": ">q",
    "uint64": ">Q",
    "float32": ">f",
    "float64": ">d",
}
"""Types to their formats of ``struct``."""

WIDE = tuple(kind for kind in FORMATS if not kind.endswith("16"))
"""Types of several registers."""

_LONG = re.compile(r"-?\d{16,}")
"""An integer beyond those that every reader of JSON reads alike (RFC 8259, section 6)."""

ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")


def registers(value: float, kind: str, order: str = "ABCD") -> list[int]:
    """Return the registers that hold a number."""
    data = struct.pack(FORMATS[kind], value)
    words = [data[start : start + 2] for start in range(0, len(data), 2)]
    if order in ("CDAB", "DCBA"):
        words.reverse()
    if order in ("BADC", "DCBA"):
        words = [word[::-1] for word in words]
    return [int.from_bytes(word, "big") for word in words]


def unpacked(data: bytes, kind: str) -> float:
    """Return the number that has these bytes."""
    value: float = struct.unpack(FORMATS[kind], data)[0]
    return value


def same_bits(value: object, wanted: float, kind: str) -> bool:
    """Tell whether a number of an answer has the bits of the wanted one in this type."""
    if kind in ("int64", "uint64") and same_json(Wide(int(wanted)), value):
        return True
    if isinstance(value, str) and kind in ("float32", "float64") and _LONG.fullmatch(value):
        # An integer that a text has, and that not every reader of JSON reads alike, is given as its digits.
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return struct.pack(FORMATS[kind], value) == struct.pack(FORMATS[kind], wanted)
    except (struct.error, OverflowError):
        return False
