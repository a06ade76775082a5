"""JSON values to OPC UA variants and back, strictly by the node's own data type (OPC 10000-6, 5.1.2)."""

from __future__ import annotations

import base64
import math
import uuid
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from enum import Enum
from typing import Any

from asyncua import ua

from ..core import AdapterError, exact_in_json, special_name
from .shapes import ValueObject

__all__ = ["from_variant", "timestamp", "to_variant"]

_Type = ua.VariantType

_INTEGERS = {
    _Type.SByte: (-(2**7), 2**7 - 1),
    _Type.Byte: (0, 2**8 - 1),
    _Type.Int16: (-(2**15), 2**15 - 1),
    _Type.UInt16: (0, 2**16 - 1),
    _Type.Int32: (-(2**31), 2**31 - 1),
    _Type.UInt32: (0, 2**32 - 1),
    _Type.Int64: (-(2**63), 2**63 - 1),
    _Type.UInt64: (0, 2**64 - 1),
}
_LARGEST = {_Type.Float: 3.4028234663852886e38, _Type.Double: 1.7976931348623157e308}
_FIRST_YEAR = 1601


def to_variant(value: Any, kind: ua.VariantType, rank: int, dimensions: Sequence[int], field: str) -> ua.Variant:
    """Return the variant to write.

    Args:
        value: the JSON value.
        kind: the node's built-in type.
        rank: the node's ValueRank: n dimensions, 0 at least one, -1 none, -2 any number, -3 none or one.
        dimensions: the node's ArrayDimensions; 0 is any length.
        field: JSON Pointer to the value in the arguments.

    Raises:
        AdapterError: ``type_mismatch`` or ``range_overflow``; nothing is coerced.
    """
    shape = _shape(value, field)
    if not shape:
        if rank >= 0:
            raise _mismatch("the node holds an array, not a single value", field)
        return ua.Variant(_scalar(value, kind, field), kind)
    if rank == -1:
        raise _mismatch("the node holds a single value, not an array", field)
    if (rank == -3 and len(shape) > 1) or (rank > 0 and len(shape) != rank):
        raise _mismatch(f"the node holds an array of {max(rank, 1)} dimension(s), not {len(shape)}", field)
    if any(fixed not in (0, length) for fixed, length in zip(dimensions, shape, strict=False)):
        raise _mismatch(f"the node holds an array of {' x '.join(map(str, dimensions))}", field)
    return ua.Variant(_members(value, kind, field), kind, is_array=True)


def _shape(value: Any, field: str) -> list[int]:
    if not isinstance(value, list):
        return []
    shapes = [_shape(member, field) for member in value]
    if any(shape != shapes[0] for shape in shapes):
        raise _mismatch("the rows of the array differ in length", field)
    return [len(value), *(shapes[0] if shapes else [])]


def _members(value: list[Any], kind: ua.VariantType, field: str) -> list[Any]:
    return [
        _members(member, kind, f"{field}/{index}")
        if isinstance(member, list)
        else _scalar(member, kind, f"{field}/{index}")
        for index, member in enumerate(value)
    ]


def _mismatch(message: str, field: str) -> AdapterError:
    return AdapterError("type_mismatch", message, outcome="not_sent", field=field)


def _overflow(message: str, field: str, **allowed: float) -> AdapterError:
    return AdapterError("range_overflow", message, field=field, allowed=allowed or None)


def _scalar(value: Any, kind: ua.VariantType, field: str) -> Any:
    if kind == _Type.Boolean:
        if not isinstance(value, bool):
            raise _mismatch("the node is Boolean; true or false is needed", field)
        return value
    if kind in _INTEGERS:
        if type(value) is not int:
            raise _mismatch(f"the node is {kind.name}; a whole number is needed", field)
        low, high = _INTEGERS[kind]
        if not low <= value <= high:
            raise _overflow(f"{kind.name} holds {low} to {high}", field, min=low, max=high)
        return value
    if kind in _LARGEST:
        if type(value) not in (int, float):
            raise _mismatch(f"the node is {kind.name}; a number is needed", field)
        # Two comparisons instead of abs(): comparing is exact for integers of any size, converting them is not.
        if not -_LARGEST[kind] <= value <= _LARGEST[kind]:
            raise _overflow(f"{kind.name} holds numbers up to {_LARGEST[kind]:g}", field)
        if float(value) != value:
            raise _mismatch(f"{kind.name} cannot hold this whole number exactly", field)
        return float(value)
    read = _FROM_TEXT.get(kind)
    if read is None:
        raise AdapterError("unsupported_operation", f"writing {kind.name} is not offered", outcome="not_sent")
    if not isinstance(value, str):
        raise _mismatch(f"the node is {kind.name}; a string is needed", field)
    try:
        return read(value)
    except OverflowError:
        raise _overflow(f"{kind.name} begins in the year {_FIRST_YEAR}", field) from None
    except ValueError:
        raise _mismatch(f"the text is no {kind.name}", field) from None


def _moment(text: str) -> datetime:
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError("the time has no offset from UTC")
    moment = moment.astimezone(UTC)
    if moment.year < _FIRST_YEAR:
        raise OverflowError
    return moment


def _guid(text: str) -> uuid.UUID:
    guid = uuid.UUID(text)
    if str(guid) != text.lower():
        raise ValueError("not in the canonical form")
    return guid


_FROM_TEXT: dict[ua.VariantType, Callable[[str], Any]] = {
    _Type.String: str,
    _Type.LocalizedText: ua.LocalizedText,
    _Type.DateTime: _moment,
    _Type.Guid: _guid,
    _Type.ByteString: lambda text: base64.b64decode(text, validate=True),
}


def from_variant(variant: ua.Variant | None, clean: Callable[[str], str]) -> ValueObject:
    """Return the value with its type; ``special`` names a number that JSON cannot represent, at the value's own place.

    Args:
        variant: the received variant.
        clean: cleans a text of the server.
    """
    if variant is None or variant.VariantType == _Type.Null:
        return {"value": None, "data_type": "Null", "special": None}
    value, kind = variant.Value, variant.VariantType
    name = getattr(kind, "name", str(kind))
    if isinstance(value, float):
        special = _special(value)
        return {"value": None if special else value, "data_type": name, "special": special}
    found: ValueObject = {"value": _plain(value, clean), "data_type": name, "special": None}
    if kind in _LARGEST:
        found["special"] = _special(value)
    if kind == _Type.ByteString or isinstance(value, ua.ExtensionObject):
        found["encoding"] = "base64"
    return found


def _special(value: Any) -> Any:
    if isinstance(value, list):
        names = [_special(member) for member in value]
        return names if any(names) else None
    return special_name(value) if isinstance(value, float) else None


def _plain(value: Any, clean: Callable[[str], str]) -> Any:
    if isinstance(value, str):
        return clean(value)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, list):
        return [_plain(member, clean) for member in value]
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, int):
        return exact_in_json(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, datetime):
        return timestamp(value, exact=True)
    return _structure(value, clean)


def _structure(value: Any, clean: Callable[[str], str]) -> Any:
    if isinstance(value, ua.LocalizedText):
        return _plain(value.Text, clean)
    if isinstance(value, ua.NodeId | ua.QualifiedName):
        return clean(value.to_string())
    if isinstance(value, ua.StatusCode):
        return value.name
    if isinstance(value, ua.Variant):
        return _plain(value.Value, clean)
    if isinstance(value, ua.ExtensionObject):
        return {"type_id": value.TypeId.to_string(), "body": _plain(value.Body, clean)}
    if is_dataclass(value):
        members = (field.name for field in fields(value) if field.name != "Encoding")
        return {name: _plain(getattr(value, name), clean) for name in members}
    return clean(str(value))


def timestamp(moment: datetime | None, *, exact: bool = False) -> str | None:
    """Return a time as in RFC 3339, UTC, in milliseconds, with ``exact`` in microseconds where there are any.

    OPC UA times are UTC.
    """
    if moment is None:
        return None
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    precision = "microseconds" if exact and moment.microsecond % 1000 else "milliseconds"
    return moment.isoformat(timespec=precision)[:-6] + "Z"
