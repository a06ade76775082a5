"""JSON values to OPC UA variants and back, strictly by the node's own data type (OPC 10000-6, 5.1.2)."""

from __future__ import annotations

import base64
import math
import uuid
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from ..core import AdapterError

__all__ = ["from_variant", "timestamp", "to_variant"]

_EXACT_IN_JSON = 2**53 - 1
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
_LARGEST_FLOAT = 3.4028234663852886e38


def to_variant(value: Any, kind: ua.VariantType, rank: int) -> ua.Variant:
    """The variant to write.

    Args:
        value: from JSON.
        kind: the node's built-in type.
        rank: the node's ValueRank; -1 scalar, 1 one dimension, -3 to 0 either.

    Raises:
        AdapterError: ``type_mismatch`` or ``range_overflow``; nothing is coerced.
    """
    if isinstance(value, list):
        if rank == -1:
            raise _mismatch("the node holds a single value, not an array")
        return ua.Variant([_scalar(member, kind) for member in value], kind, is_array=True)
    if rank >= 0:
        raise _mismatch("the node holds an array, not a single value")
    return ua.Variant(_scalar(value, kind), kind)


def _mismatch(message: str) -> AdapterError:
    return AdapterError("type_mismatch", message, outcome="not_sent", field="/value")


def _scalar(value: Any, kind: ua.VariantType) -> Any:
    if kind == _Type.Boolean:
        if not isinstance(value, bool):
            raise _mismatch("the node is Boolean")
        return value
    if kind in _INTEGERS:
        if isinstance(value, bool) or not isinstance(value, int):
            raise _mismatch(f"the node is {kind.name}; a whole number is needed")
        low, high = _INTEGERS[kind]
        if not low <= value <= high:
            raise AdapterError(
                "range_overflow",
                f"{kind.name} holds {low} to {high}",
                field="/value",
                allowed={"min": low, "max": high},
            )
        return value
    if kind in (_Type.Float, _Type.Double):
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _mismatch(f"the node is {kind.name}; a number is needed")
        if not math.isfinite(value) or (kind == _Type.Float and abs(value) > _LARGEST_FLOAT):
            raise AdapterError("range_overflow", f"the value does not fit into {kind.name}", field="/value")
        return float(value)
    if not isinstance(value, str):
        raise _mismatch(f"the node is {kind.name}; a string is needed")
    return _from_text(value, kind)


def _from_text(text: str, kind: ua.VariantType) -> Any:
    try:
        if kind == _Type.String:
            return text
        if kind == _Type.LocalizedText:
            return ua.LocalizedText(text)
        if kind == _Type.DateTime:
            moment = datetime.fromisoformat(text)
            if moment.tzinfo is None:
                raise ValueError
            return moment.astimezone(UTC)
        if kind == _Type.Guid:
            return uuid.UUID(text)
        if kind == _Type.ByteString:
            return base64.b64decode(text, validate=True)
    except ValueError:
        raise _mismatch(f"the text is no {kind.name}") from None
    raise AdapterError("unsupported_operation", f"writing {kind.name} is not offered", outcome="not_sent")


def from_variant(variant: ua.Variant | None) -> dict[str, Any]:
    """``value``, ``data_type`` and, where JSON has no number for it, ``special``."""
    if variant is None or variant.VariantType == _Type.Null:
        return {"value": None, "data_type": "Null", "special": None}
    value, special = variant.Value, None
    if isinstance(value, float) and not math.isfinite(value):
        special = "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return {"value": _plain(value), "data_type": variant.VariantType.name, "special": special}


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(member) for member in value]
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return value if abs(value) <= _EXACT_IN_JSON else str(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, datetime):
        return timestamp(value)
    if isinstance(value, ua.LocalizedText):
        return value.Text
    if isinstance(value, ua.NodeId | ua.QualifiedName):
        return value.to_string()
    return str(value)


def timestamp(moment: datetime | None) -> str | None:
    """RFC 3339 with milliseconds, UTC; OPC UA times carry no zone and are UTC."""
    if moment is None:
        return None
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
