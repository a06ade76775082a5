"""Values of the elementary data types of S7 (IEC 61131-3), big-endian, and of STRING.

A STRING has two bytes before its characters: the length that was declared, and the length that it has. A write leaves the first one
alone.
"""

from __future__ import annotations

import struct
from typing import Literal

from typing_extensions import TypedDict

from ..core import AdapterError, exact_in_json, special_name

__all__ = ["DataType", "Plain", "Value", "decode", "encode", "width"]

# fmt: off
DataType = Literal[
    "BOOL", "BYTE", "WORD", "DWORD", "LWORD", "SINT", "USINT", "INT", "UINT", "DINT", "UDINT", "LINT", "ULINT", "REAL", "LREAL",
    "CHAR", "STRING",
]
# fmt: on
Plain = bool | int | float | str

_FORMATS = {
    "BYTE": "B",
    "WORD": "H",
    "DWORD": "I",
    "LWORD": "Q",
    "SINT": "b",
    "USINT": "B",
    "INT": "h",
    "UINT": "H",
    "DINT": "i",
    "UDINT": "I",
    "LINT": "q",
    "ULINT": "Q",
    "REAL": "f",
    "LREAL": "d",
}
_LONGEST_STRING = 254


class Value(TypedDict):
    """A value: ``special`` is NaN, Infinity or -Infinity where ``value`` is null for want of a JSON number; integers beyond
    2^53 - 1 are decimal strings; ``raw`` is its bytes in hexadecimal."""

    type: str
    value: bool | int | float | str | None
    special: str | None
    raw: str
    quality: str


def width(kind: DataType, string_length: int | None = None) -> int:
    """Return the number of bytes of a value; of a STRING without a declared length, of the longest one."""
    if kind == "STRING":
        return 2 + (_LONGEST_STRING if string_length is None else string_length)
    return struct.calcsize(f">{_FORMATS[kind]}") if kind in _FORMATS else 1


def decode(content: bytes, kind: DataType) -> Value:
    """Return the value that these bytes hold.

    Raises:
        AdapterError: ``bad_quality``, a STRING whose lengths contradict each other.
    """
    value: Plain
    special = None
    if kind == "BOOL":
        value = bool(content[0] & 1)
    elif kind == "CHAR":
        value = content.decode("latin-1")
    elif kind == "STRING":
        if content[1] > min(content[0], len(content) - 2):
            raise AdapterError(
                "bad_quality", "there is no STRING of this length at the address: its lengths do not fit"
            )
        content = content[: 2 + content[1]]
        value = content[2:].decode("latin-1")
    else:
        (number,) = struct.unpack(f">{_FORMATS[kind]}", content)
        value, special = number, special_name(number)
    return {
        "type": kind,
        "value": exact_in_json(value) if special is None else None,
        "special": special,
        "raw": content.hex(),
        "quality": "good",
    }


def encode(value: Plain, kind: DataType, field: str = "/value") -> bytes:
    """Return the bytes of a value; of a STRING those from its second length on.

    Raises:
        AdapterError: ``type_mismatch``, the type has no such values; ``range_overflow``, the value is outside of its range.
    """
    if kind == "BOOL":
        if not isinstance(value, bool):
            raise AdapterError("type_mismatch", "a BOOL is true or false", field=field)
        return bytes([value])
    if kind in ("CHAR", "STRING"):
        return _text(value, kind, field)
    if isinstance(value, bool | str):
        raise AdapterError("type_mismatch", f"the value of a {kind} is a number", field=field)
    if kind not in ("REAL", "LREAL"):
        if value != int(value):
            raise AdapterError("type_mismatch", f"{kind} holds whole numbers only", field=field)
        value = int(value)
    try:
        return struct.pack(f">{_FORMATS[kind]}", value)
    except (struct.error, OverflowError):
        raise AdapterError("range_overflow", f"the value does not fit into {kind}", field=field) from None


def _text(value: Plain, kind: DataType, field: str) -> bytes:
    try:
        if not isinstance(value, str):
            raise ValueError
        content = value.encode("latin-1")
    except ValueError:
        message = f"the value of a {kind} is a text of characters of ISO 8859-1"
        raise AdapterError("type_mismatch", message, field=field) from None
    if kind == "STRING":
        if len(content) > _LONGEST_STRING:
            raise AdapterError("limit_exceeded", f"a STRING has at most {_LONGEST_STRING} characters", field=field)
        return bytes([len(content)]) + content
    if len(content) != 1:
        raise AdapterError("type_mismatch", "a CHAR is one character", field=field)
    return content
