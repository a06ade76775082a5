"""Values of the elementary data types of CIP, little-endian, and of the STRING of Logix controllers.

A STRING is a structure: LEN, a DINT, and DATA, 82 SINT, padded to 88 bytes. Other structures are read and written by their members.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal, cast, get_args

from typing_extensions import TypedDict

from ..core import AdapterError, exact_in_json, special_name

__all__ = ["DataType", "Plain", "TagType", "Value", "decode", "encode", "tag_type", "type_name"]

# fmt: off
DataType = Literal[
    "BOOL", "SINT", "INT", "DINT", "LINT", "USINT", "UINT", "UDINT", "ULINT", "REAL", "LREAL", "STRING",
]
# fmt: on
Plain = bool | int | float | str

_CODES = {
    0xC1: "BOOL",
    0xC2: "SINT",
    0xC3: "INT",
    0xC4: "DINT",
    0xC5: "LINT",
    0xC6: "USINT",
    0xC7: "UINT",
    0xC8: "UDINT",
    0xC9: "ULINT",
    0xCA: "REAL",
    0xCB: "LREAL",
}
_FORMATS = {
    "SINT": "<b",
    "INT": "<h",
    "DINT": "<i",
    "LINT": "<q",
    "USINT": "<B",
    "UINT": "<H",
    "UDINT": "<I",
    "ULINT": "<Q",
    "REAL": "<f",
    "LREAL": "<d",
}
_STRUCTURE, _PACKED_BOOLS = 0xA0, 0xD3
_STRING_HANDLE = 0x0FCE
"""Of the STRING that every controller has; a string type of the user's own has another one, and another length."""
_LONGEST_STRING = 82
_STRING = struct.Struct("<i82s2x")


@dataclass(frozen=True, slots=True, kw_only=True)
class TagType:
    """The type of a tag, as the controller tells it before the tag's values.

    Attributes:
        wire: the bytes that say it.
        name: a name of :data:`DataType`.
        size: bytes of one value.
    """

    wire: bytes
    name: DataType
    size: int

    @property
    def bits(self) -> int:
        """Number of bits that have addresses of their own; 0 for a type without."""
        return 8 * self.size if "INT" in self.name else 0


class Value(TypedDict):
    """A value: ``special`` is NaN, Infinity or -Infinity where ``value`` is null for want of a JSON number; integers beyond
    2^53 - 1 are decimal strings; ``raw`` is its bytes in hexadecimal."""

    type: str
    value: bool | int | float | str | None
    special: str | None
    raw: str
    quality: str


def tag_type(data: bytes, outcome: str) -> TagType | None:
    """Return the type that the data of an answer to a read begins with; None for one that is not told whole.

    Args:
        data: of the answer.
        outcome: of a call that fails for its type.

    Raises:
        AdapterError: ``unsupported_operation``, values of this type are not read as they are.
    """
    if len(data) < 2:
        return None
    if data[0] == _STRUCTURE:
        if len(data) < 4 or data[1] != 2:
            return None
        if int.from_bytes(data[2:4], "little") != _STRING_HANDLE:
            message = "the tag is a structure; read and write its members, such as Recipe.Rate"
            raise AdapterError("unsupported_operation", message, outcome=outcome)
        return TagType(wire=data[:4], name="STRING", size=_STRING.size)
    if data[0] == _PACKED_BOOLS:
        # An index would be that of 32 of them.
        message = "the tag is an array of BOOL, which this adapter does not offer"
        raise AdapterError("unsupported_operation", message, outcome=outcome)
    if data[0] not in _CODES or data[1]:
        message = f"values of the type {data[0]:02X} are not offered by this adapter"
        raise AdapterError("unsupported_operation", message, outcome=outcome)
    name = cast(DataType, _CODES[data[0]])
    return TagType(wire=data[:2], name=name, size=1 if name == "BOOL" else struct.calcsize(_FORMATS[name]))


def type_name(symbol_type: int) -> str:
    """Return the name of a type as a tag list tells it; the controller's number of it where it has no name."""
    if symbol_type & 0x8000:
        return "STRING" if symbol_type & 0xFFF == _STRING_HANDLE else "STRUCT"
    code = symbol_type & 0xFF
    return "BOOL" if code == _PACKED_BOOLS else _CODES.get(code, f"{code:02X}")


def decode(content: bytes, kind: DataType) -> Value:
    """Return the value that these bytes hold.

    Raises:
        AdapterError: ``bad_quality``, a STRING whose length is not one that it can have.
    """
    value: Plain
    special = None
    if kind == "BOOL":
        value = content != b"\0"
    elif kind == "STRING":
        length, text = _STRING.unpack(content)
        if not 0 <= length <= _LONGEST_STRING:
            raise AdapterError(
                "bad_quality", f"the STRING tells a length of {length} characters, it has {_LONGEST_STRING}"
            )
        value = text[:length].decode("latin-1")
    else:
        (number,) = struct.unpack(_FORMATS[kind], content)
        value, special = number, special_name(number)
    return {
        "type": kind,
        "value": exact_in_json(value) if special is None else None,
        "special": special,
        "raw": content.hex(),
        "quality": "good",
    }


def encode(value: Plain, kind: DataType, field: str = "/value") -> bytes:
    """Return the bytes of a value.

    Raises:
        AdapterError: ``type_mismatch``, the type has no such values; ``range_overflow`` or ``limit_exceeded``, it has none so large.
    """
    assert kind in get_args(DataType)
    if kind == "BOOL":
        # pylogix writes 5 as true.
        if not isinstance(value, bool):
            raise AdapterError("type_mismatch", "a BOOL is true or false", field=field)
        return b"\xff" if value else b"\0"
    if kind == "STRING":
        return _string(value, field)
    if isinstance(value, bool | str):
        raise AdapterError("type_mismatch", f"the value of a {kind} is a number", field=field)
    if kind not in ("REAL", "LREAL"):
        if value != int(value):
            raise AdapterError("type_mismatch", f"{kind} holds whole numbers only", field=field)
        value = int(value)
    try:
        return struct.pack(_FORMATS[kind], value)
    except (struct.error, OverflowError):
        raise AdapterError("range_overflow", f"the value does not fit into {kind}", field=field) from None


def _string(value: Plain, field: str) -> bytes:
    try:
        if not isinstance(value, str):
            raise ValueError
        content = value.encode("latin-1")
    except ValueError:
        message = "the value of a STRING is a text of characters of ISO 8859-1"
        raise AdapterError("type_mismatch", message, field=field) from None
    # pylogix cuts longer texts off.
    if len(content) > _LONGEST_STRING:
        raise AdapterError("limit_exceeded", f"a STRING has at most {_LONGEST_STRING} characters", field=field)
    return _STRING.pack(len(content), content)
