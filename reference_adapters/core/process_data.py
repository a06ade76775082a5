"""Numbers in process data of PROFIBUS and PROFINET, big-endian, as the profiles of both have them."""

from __future__ import annotations

import struct
from typing import Any, Literal

from typing_extensions import TypedDict

from .errors import AdapterError
from .numbers import exact_in_json, special_name

__all__ = ["DataType", "Value", "decode", "encode", "width"]

# fmt: off
DataType = Literal[
    "UINT8", "UINT16", "UINT32", "UINT64", "INT8", "INT16", "INT32", "INT64", "FLOAT32", "FLOAT64",
]
# fmt: on
_FORMATS = {
    "UINT8": ">B",
    "UINT16": ">H",
    "UINT32": ">I",
    "UINT64": ">Q",
    "INT8": ">b",
    "INT16": ">h",
    "INT32": ">i",
    "INT64": ">q",
    "FLOAT32": ">f",
    "FLOAT64": ">d",
}


class Value(TypedDict):
    """A number: ``special`` is NaN, Infinity or -Infinity where ``value`` is null for want of a JSON number; integers beyond 2^53 - 1 are
    decimal strings; ``raw`` is its bytes in hexadecimal."""

    type: str
    value: int | float | str | None
    special: str | None
    raw: str


def width(kind: DataType) -> int:
    """Return the number of bytes of a number."""
    return struct.calcsize(_FORMATS[kind])


def decode(content: bytes, kind: DataType) -> Value:
    """Return the number that these bytes hold."""
    (number,) = struct.unpack(_FORMATS[kind], content)
    special = special_name(number)
    return {
        "type": kind,
        "value": exact_in_json(number) if special is None else None,
        "special": special,
        "raw": content.hex(),
    }


def encode(value: Any, kind: DataType) -> bytes:
    """Return the bytes of a number.

    Raises:
        AdapterError: ``type_mismatch``, the type has no such values; ``range_overflow``, the value is outside of its range.
    """
    if type(value) not in (int, float):
        raise AdapterError("type_mismatch", f"the value of {kind} is a number", field="/value", outcome="not_sent")
    if not kind.startswith("FLOAT"):
        if value != int(value):
            message = f"{kind} holds whole numbers only"
            raise AdapterError("type_mismatch", message, field="/value", outcome="not_sent")
        value = int(value)
    try:
        return struct.pack(_FORMATS[kind], value)
    except (struct.error, OverflowError):
        message = f"the value does not fit into {kind}"
        raise AdapterError("range_overflow", message, field="/value", outcome="not_sent") from None
