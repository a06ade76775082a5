"""Values of objects and process data: numbers with the least significant byte first, BOOL as a byte, and texts."""

from __future__ import annotations

import struct
from typing import Any, Literal

from typing_extensions import TypedDict

from ..core import AdapterError, exact_in_json, special_name

__all__ = ["DataType", "Value", "decode", "encode", "width"]

# fmt: off
DataType = Literal[
    "BOOL", "UINT8", "UINT16", "UINT32", "UINT64", "INT8", "INT16", "INT32", "INT64", "FLOAT32", "FLOAT64", "STRING",
]
# fmt: on
_FORMATS = {
    "BOOL": "<?",
    "UINT8": "<B",
    "UINT16": "<H",
    "UINT32": "<I",
    "UINT64": "<Q",
    "INT8": "<b",
    "INT16": "<h",
    "INT32": "<i",
    "INT64": "<q",
    "FLOAT32": "<f",
    "FLOAT64": "<d",
}


class Value(TypedDict):
    """A value: ``special`` is NaN, Infinity or -Infinity where ``value`` is null for want of a JSON number; integers beyond 2^53 - 1 are
    decimal strings; ``raw`` is its bytes in hexadecimal."""

    type: str
    value: bool | int | float | str | None
    special: str | None
    raw: str


def width(kind: DataType) -> int:
    """Return the number of bytes of a value; 0 for a text."""
    return struct.calcsize(_FORMATS[kind]) if kind in _FORMATS else 0


def decode(content: bytes, kind: DataType) -> Value:
    """Return the value that these bytes hold.

    Raises:
        AdapterError: ``type_mismatch``, there are more or fewer bytes than the type has.
    """
    if kind == "STRING":
        text = content.rstrip(b"\0").decode("latin-1")
        return {"type": kind, "value": text, "special": None, "raw": content.hex()}
    if len(content) != width(kind):
        raise AdapterError(
            "type_mismatch", f"the object has {len(content)} bytes, {kind} has {width(kind)}", field="/data_type"
        )
    if kind == "BOOL":
        return {"type": kind, "value": content != b"\0", "special": None, "raw": content.hex()}
    (number,) = struct.unpack(_FORMATS[kind], content)
    special = special_name(number)
    return {
        "type": kind,
        "value": exact_in_json(number) if special is None else None,
        "special": special,
        "raw": content.hex(),
    }


def encode(value: Any, kind: DataType) -> bytes:
    """Return the bytes of a value.

    Raises:
        AdapterError: ``type_mismatch``, the type has no such values; ``range_overflow``, the value is outside of its range.
    """
    if kind in ("BOOL", "STRING"):
        if type(value) is not (bool if kind == "BOOL" else str):
            wanted = "true or false" if kind == "BOOL" else "a text"
            raise AdapterError("type_mismatch", f"the value of {kind} is {wanted}", field="/value", outcome="not_sent")
        try:
            return bytes([value]) if isinstance(value, bool) else str(value).encode("latin-1")
        except UnicodeEncodeError:
            message = "the text has characters that the slave does not have (ISO 8859-1)"
            raise AdapterError("type_mismatch", message, field="/value", outcome="not_sent") from None
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
