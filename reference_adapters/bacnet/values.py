"""Values between JSON and BACnet's primitive datatypes. The datatype of a write is that of the property, never a guess from the value."""

from __future__ import annotations

import struct
from typing import Any

from bacpypes3.constructeddata import Any as AnyValue
from bacpypes3.primitivedata import (
    Atomic,
    BitString,
    Boolean,
    CharacterString,
    Date,
    Double,
    Enumerated,
    Integer,
    Null,
    ObjectIdentifier,
    ObjectType,
    OctetString,
    PropertyIdentifier,
    Real,
    TagClass,
    Time,
    Unsigned,
)
from bacpypes3.vendor import get_vendor_info

from ..core import AdapterError, exact_in_json, special_name

__all__ = ["Read", "encoded", "known_property", "object_type", "primitives", "same"]

Read = tuple[str, Any]
"""Datatype and value of one primitive; a number that JSON does not have, or not exactly for everybody, is a text."""

_NAMES: list[tuple[type[Atomic], str]] = [
    (Null, "null"),
    (Boolean, "boolean"),
    (Enumerated, "enumerated"),
    (Unsigned, "unsigned"),
    (Integer, "integer"),
    (Double, "double"),
    (Real, "real"),
    (CharacterString, "character-string"),
    (BitString, "bit-string"),
    (OctetString, "octet-string"),
    (Date, "date"),
    (Time, "time"),
    (ObjectIdentifier, "object-identifier"),
]


def object_type(name: str) -> ObjectType:
    """Return an object type by its name."""
    return ObjectType(name)


def known_property(name: str) -> PropertyIdentifier:
    """Return a property by its name.

    Raises:
        AdapterError: the standard has none of this name.
    """
    try:
        return PropertyIdentifier(name)
    except ValueError:
        message = "the standard has no such property"
        raise AdapterError("invalid_input", message, field="/property_id", outcome="not_sent") from None


def primitives(value: AnyValue) -> list[Read]:
    """Return the primitive values that an answer has, one after the other.

    Raises:
        AdapterError: the answer has constructed data, or bytes that are no value.
    """
    found = []
    # The tags that enclose the value come first and last.
    for tag in list(value.tagList or [])[1:-1]:
        if tag.tag_class != TagClass.application:
            message = "the property has constructed data, which this adapter does not read"
            raise AdapterError("unsupported_operation", message)
        try:
            decoded = tag.app_to_object()
        except Exception:
            # The library has no class of its own for what it cannot decode: struct.error, ValueError, DecodingError and more.
            raise AdapterError("protocol_error", "the answer holds a value that cannot be read") from None
        found.append(_primitive(decoded))
    return found


def _primitive(value: Any) -> Read:
    name = next(name for kind, name in _NAMES if isinstance(value, kind))
    match name:
        case "null":
            return name, None
        case "boolean":
            return name, bool(value)
        case "unsigned" | "integer" | "enumerated":
            return name, exact_in_json(int(value))
        case "real" | "double":
            number = float(value)
            return name, special_name(number) or number
        case "bit-string":
            return name, "".join(str(int(bit)) for bit in value)
        case "octet-string":
            return name, bytes(value).hex()
        case "object-identifier":
            return name, f"{ObjectType(value[0])},{value[1]}"
    return name, str(value)


def encoded(kind: ObjectType, number: PropertyIdentifier, index: int | None, value: Any) -> Atomic:
    """Return a value as the property holds it.

    Raises:
        AdapterError: the property has no primitive datatype that is known, or the value is none of it.
    """
    if value is None:
        return Null(())
    wanted = get_vendor_info(0).get_object_class(kind).get_property_type(number)
    if wanted is not None and index is not None:
        wanted = getattr(wanted, "_subtype", None)
    if wanted is None or not issubclass(wanted, Atomic):
        message = "the datatype of this property is not known, so nothing can be written to it"
        raise AdapterError("unsupported_operation", message, outcome="not_sent")
    if issubclass(wanted, Enumerated):
        return wanted(_state(wanted, value))
    if issubclass(wanted, Boolean):
        return wanted(_of_kind(value, bool, "true or false"))
    if issubclass(wanted, CharacterString):
        return wanted(_of_kind(value, str, "a text"))
    if issubclass(wanted, (Real, Double)):
        return wanted(_number(value, ">f" if issubclass(wanted, Real) else ">d"))
    if issubclass(wanted, (Unsigned, Integer)):
        return wanted(_whole(value, signed=not issubclass(wanted, Unsigned)))
    raise AdapterError("unsupported_operation", "this adapter writes no value of this datatype", outcome="not_sent")


def _of_kind(value: Any, kind: type, expected: str) -> Any:
    if type(value) is not kind:
        raise AdapterError("type_mismatch", f"the property holds {expected}", field="/value", outcome="not_sent")
    return value


def _number(value: Any, layout: str) -> float:
    if type(value) not in (int, float):
        raise AdapterError("type_mismatch", "the property holds a number", field="/value", outcome="not_sent")
    try:
        struct.pack(layout, value)
        return float(value)
    except (OverflowError, struct.error):
        message = "the value does not fit into the property"
        raise AdapterError("range_overflow", message, field="/value", outcome="not_sent") from None


def _whole(value: Any, *, signed: bool) -> int:
    number = int(_of_kind(value, int, "a whole number"))
    low, high = (-(2**31), 2**31 - 1) if signed else (0, 2**32 - 1)
    if not low <= number <= high:
        bounds = {"ge": low, "le": high}
        message = "the value does not fit into the property"
        raise AdapterError("range_overflow", message, field="/value", allowed=bounds, outcome="not_sent")
    return number


def _state(wanted: type[Enumerated], value: Any) -> Any:
    if type(value) not in (int, str):
        raise AdapterError("type_mismatch", "the property holds a state", field="/value", outcome="not_sent")
    known = wanted._enum_map
    if value not in known and value not in known.values():
        code = "type_mismatch" if isinstance(value, str) else "range_overflow"
        names = ", ".join(sorted(known)[:10])
        raise AdapterError(code, f"the property has the states {names}", field="/value", outcome="not_sent")
    return value


def same(asked: Atomic, found: Read) -> bool:
    """Tell whether a value that was read is the one that was written."""
    kind, value = found
    if isinstance(asked, (Real, Double)):
        layout = ">f" if isinstance(asked, Real) else ">d"
        return isinstance(value, float) and struct.pack(layout, float(asked)) == struct.pack(layout, value)
    return (kind, value) == _primitive(asked)
