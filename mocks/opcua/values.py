"""The conversion of values between JSON and OPC UA (OPC 10000-6, 5.1.2), for the control channel and the journal."""

from __future__ import annotations

import base64
import math
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

__all__ = ["finite", "fits", "shape_of", "to_json", "variant"]

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
_FROM_TEXT: dict[ua.VariantType, Callable[[str], Any]] = {
    _Type.String: str,
    _Type.LocalizedText: ua.LocalizedText,
    _Type.DateTime: lambda text: datetime.fromisoformat(text).astimezone(UTC),
    _Type.Guid: uuid.UUID,
    _Type.ByteString: lambda text: base64.b64decode(text, validate=True),
    _Type.XmlElement: ua.XmlElement,
    _Type.NodeId: ua.NodeId.from_string,
    _Type.ExpandedNodeId: ua.ExpandedNodeId.from_string,
    _Type.QualifiedName: ua.QualifiedName.from_string,
    _Type.StatusCode: lambda symbol: ua.StatusCode(getattr(ua.StatusCodes, symbol)),
}
_NOT_IN_JSON = frozenset({"NaN", "Infinity", "-Infinity", "-0.0"})
"""Numbers of Float and Double that JSON does not have, by name."""
_STRUCTURES = {"Range": ua.Range, "EUInformation": ua.EUInformation, "Argument": ua.Argument}


def variant(value: Any, kind: ua.VariantType) -> ua.Variant:
    """Return a JSON value as a variant of this type; lists become arrays, lists of lists matrices, and null the null variant.

    ``"NaN"``, ``"Infinity"``, ``"-Infinity"`` and ``"-0.0"`` are numbers. An ExtensionObject is ``{"Range": {"Low": 0, "High": 1}}`` or,
    of a type that nobody knows, its encoding's node id with its bytes: ``{"ns=2;i=4711": "AP8="}``. A StatusCode is its symbol.

    Raises:
        ValueError: the value does not fit.
    """
    if isinstance(value, list):
        return ua.Variant(_members(value, kind), kind, is_array=True)
    if value is None:
        return ua.Variant(None, _Type.Null)
    return ua.Variant(_scalar(value, kind), kind)


def _members(value: list[Any], kind: ua.VariantType) -> list[Any]:
    return [_members(member, kind) if isinstance(member, list) else _scalar(member, kind) for member in value]


def _scalar(value: Any, kind: ua.VariantType) -> Any:
    if kind in _FROM_TEXT and isinstance(value, str):
        return _FROM_TEXT[kind](value)
    if kind in (_Type.Float, _Type.Double) and (
        type(value) in (int, float) or (isinstance(value, str) and value in _NOT_IN_JSON)
    ):
        return float(value)
    if kind == _Type.ExtensionObject and isinstance(value, dict) and len(value) == 1:
        [(name, fields)] = value.items()
        if name in _STRUCTURES and isinstance(fields, dict):
            return _STRUCTURES[name](**fields)
        if isinstance(fields, str):
            return ua.ExtensionObject(TypeId=ua.NodeId.from_string(name), Body=base64.b64decode(fields, validate=True))
    if kind == _Type.Boolean and isinstance(value, bool):
        return value
    low, high = _INTEGERS.get(kind, (1, 0))
    if type(value) is int and low <= value <= high:
        return value
    raise ValueError(f"{value!r} does not fit into {kind.name}")


def shape_of(value: Any) -> list[int]:
    """Return the lengths of the dimensions; the list is empty for a scalar."""
    lengths = []
    while isinstance(value, list):
        lengths.append(len(value))
        value = value[0] if value else None
    return lengths


def fits(value: ua.Variant, kind: ua.VariantType, rank: int, dimensions: list[int]) -> bool:
    """Tell whether a node of this DataType, ValueRank and ArrayDimensions can hold a variant (OPC 10000-3, 5.6.2)."""
    if value.VariantType != kind:
        return False
    if not value.is_array:
        return rank in (-3, -2, -1)
    lengths = list(value.Dimensions or shape_of(value.Value)) or [0]
    if rank == -1 or (rank == -3 and len(lengths) > 1) or (rank > 0 and len(lengths) != rank):
        return False
    # A dimension of length 0 may have any length.
    return not dimensions or all(fixed in (0, length) for fixed, length in zip(dimensions, lengths, strict=False))


def finite(value: Any) -> bool:
    """Tell whether every number in a value is finite."""
    if isinstance(value, list):
        return all(map(finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def to_json(value: Any) -> Any:
    """Return the value of a variant for journal and image; NaN and infinities by name, because JSON does not have them."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list):
        return [to_json(member) for member in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, ua.LocalizedText):
        return value.Text
    if isinstance(value, ua.NodeId):
        return value.to_string()
    return str(value)
