"""The payloads of Sparkplug B, from the specification's field table.

The protobuf schema is built when it is first needed, in a descriptor pool of its own: no generated file, no clash with
another package's ``sparkplug_b_pb2``, and no code shared with the adapter whose payloads are judged.
Field names, numbers and types: Sparkplug 3.0.0, section 6.4.1 (Copyright Eclipse Foundation, used under the Eclipse
Foundation Specification License v1.1). The four empty ``...Extension`` messages are left out; they hold nothing.
"""

from __future__ import annotations

import base64
import math
import struct
from dataclasses import dataclass
from functools import cache
from typing import Any

__all__ = [
    "DATA_TYPES",
    "Topic",
    "decode_message",
    "decode_payload",
    "message_fields",
    "parse_topic",
    "payload_class",
    "payload_times",
]

NAMESPACE = "spBv1.0"
NODE_TYPES = frozenset({"NBIRTH", "NDEATH", "NDATA", "NCMD"})
DEVICE_TYPES = frozenset({"DBIRTH", "DDEATH", "DDATA", "DCMD"})

DATA_TYPES = (
    *("Unknown", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32", "UInt64", "Float", "Double"),
    *("Boolean", "String", "DateTime", "Text", "UUID", "DataSet", "Bytes", "File", "Template", "PropertySet"),
    *("PropertySetList", "Int8Array", "Int16Array", "Int32Array", "Int64Array", "UInt8Array", "UInt16Array"),
    *("UInt32Array", "UInt64Array", "FloatArray", "DoubleArray", "BooleanArray", "StringArray", "DateTimeArray"),
)
"""Names of the data types; the index is the number on the wire."""

_VALUES = ("uint32 int_value", "uint64 long_value", "float float_value", "double double_value")
_TEXTS = ("bool boolean_value", "string string_value")

# Message to fields: (number, "type name"), "*" marks a repeated field, "=" a member of the oneof `value`.
_SCHEMA: dict[str, tuple[tuple[int, str], ...]] = {
    "Payload": (
        (1, "uint64 timestamp"),
        (2, "*Metric metrics"),
        (3, "uint64 seq"),
        (4, "string uuid"),
        (5, "bytes body"),
    ),
    "Metric": (
        (1, "string name"),
        (2, "uint64 alias"),
        (3, "uint64 timestamp"),
        (4, "uint32 datatype"),
        (5, "bool is_historical"),
        (6, "bool is_transient"),
        (7, "bool is_null"),
        (8, "MetaData metadata"),
        (9, "PropertySet properties"),
        *((10 + i, "=" + field) for i, field in enumerate((*_VALUES, *_TEXTS))),
        (16, "=bytes bytes_value"),
        (17, "=DataSet dataset_value"),
        (18, "=Template template_value"),
    ),
    "MetaData": (
        (1, "bool is_multi_part"),
        (2, "string content_type"),
        (3, "uint64 size"),
        (4, "uint64 seq"),
        (5, "string file_name"),
        (6, "string file_type"),
        (7, "string md5"),
        (8, "string description"),
    ),
    "PropertySet": ((1, "*string keys"), (2, "*PropertyValue values")),
    "PropertySetList": ((1, "*PropertySet propertyset"),),
    "PropertyValue": (
        (1, "uint32 type"),
        (2, "bool is_null"),
        *((3 + i, "=" + field) for i, field in enumerate((*_VALUES, *_TEXTS))),
        (9, "=PropertySet propertyset_value"),
        (10, "=PropertySetList propertysets_value"),
    ),
    "DataSet": ((1, "uint64 num_of_columns"), (2, "*string columns"), (3, "*uint32 types"), (4, "*Row rows")),
    "Row": ((1, "*DataSetValue elements"),),
    "DataSetValue": tuple((1 + i, "=" + field) for i, field in enumerate((*_VALUES, *_TEXTS))),
    "Template": (
        (1, "string version"),
        (2, "*Metric metrics"),
        (3, "*Parameter parameters"),
        (4, "string template_ref"),
        (5, "bool is_definition"),
    ),
    "Parameter": (
        (1, "string name"),
        (2, "uint32 type"),
        *((3 + i, "=" + field) for i, field in enumerate((*_VALUES, *_TEXTS))),
    ),
}


@cache
def payload_class() -> Any:
    """Return the message class ``Payload``."""
    # Imported here, so that a run without Sparkplug does not spend time on protobuf.
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    field_type = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(
        name="otmcp_witness_sparkplug.proto", package="otmcp.witness", syntax="proto2"
    )
    for message_name, fields in _SCHEMA.items():
        message = file.message_type.add(name=message_name)
        if any(text.startswith("=") for _, text in fields):
            message.oneof_decl.add(name="value")
        for number, text in fields:
            kind, name = text.lstrip("*=").split(" ")
            field = message.field.add(name=name, number=number)
            field.label = field_type.LABEL_REPEATED if text.startswith("*") else field_type.LABEL_OPTIONAL
            if text.startswith("="):
                field.oneof_index = 0
            if kind in _SCHEMA:
                field.type = field_type.TYPE_MESSAGE
                field.type_name = f".otmcp.witness.{kind}"
            else:
                field.type = getattr(field_type, f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("otmcp.witness.Payload"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic of section 4.1: ``spBv1.0/group/type/edge_node[/device]``."""

    group: str
    type: str
    edge_node: str
    device: str | None


def parse_topic(topic: str) -> Topic | None:
    """Return the parts of a Sparkplug topic with a protobuf payload, or None for any other topic (STATE among them)."""
    namespace, *parts = topic.split("/")
    if namespace != NAMESPACE or not all(parts):
        return None
    if len(parts) == 3 and parts[1] in NODE_TYPES:
        return Topic(group=parts[0], type=parts[1], edge_node=parts[2], device=None)
    if len(parts) == 4 and parts[1] in DEVICE_TYPES:
        return Topic(group=parts[0], type=parts[1], edge_node=parts[2], device=parts[3])
    return None


def decode_message(topic: str, payload: bytes) -> dict[str, Any] | None:
    """Return the Sparkplug message of a PUBLISH, JSON-safe; None when the topic is not one of Sparkplug.

    The result has group, type, edge_node, device, seq, timestamp and metrics, or ``error`` with one sentence when the
    payload is no Sparkplug payload.
    """
    parts = parse_topic(topic)
    if parts is None:
        return None
    try:
        content = decode_payload(payload)
    except ValueError as error:
        return {"error": str(error)}
    return {
        "group": parts.group,
        "type": parts.type,
        "edge_node": parts.edge_node,
        "device": parts.device,
        **content,
    }


def message_fields(topic: str, payload: bytes) -> dict[str, Any]:
    """Return what journal entries have of the content of a message: the payload as base64, and the Sparkplug message that it is."""
    fields: dict[str, Any] = {"payload": base64.b64encode(payload).decode()}
    if sparkplug := decode_message(topic, payload):
        fields["sparkplug"] = sparkplug
    return fields


def decode_payload(payload: bytes) -> dict[str, Any]:
    """Return ``{"seq", "timestamp", "metrics": [{"name", "alias", "datatype", "value", "is_null"}]}``, JSON-safe.

    A field that is absent on the wire is None. Signed integers are returned signed (section 6.4.16: two's complement),
    DateTime as milliseconds, Bytes and File as base64, NaN and infinities as their names, a DataSet as
    ``{"columns", "rows"}``, a Template as ``{"template_ref", "metrics"}``.

    Raises:
        ValueError: the bytes are no payload, or a value does not fit its data type; the message is one sentence.
    """
    from google.protobuf.message import DecodeError

    message = payload_class()()
    try:
        message.ParseFromString(payload)
    except (DecodeError, UnicodeDecodeError):
        raise ValueError("the payload is not the protobuf message of Sparkplug B") from None
    return {
        "seq": _given(message, "seq"),
        "timestamp": _given(message, "timestamp"),
        "metrics": [_metric(metric) for metric in message.metrics],
    }


def payload_times(payload: bytes) -> tuple[int | None, dict[str, int]]:
    """Return the time of a payload, and those of its metrics by name or ``alias N``, in milliseconds since 1970 (section 6.4.5).

    A metric without a time, or one that is marked as historical, is left out. The bytes are a payload.
    """
    message = payload_class()()
    message.ParseFromString(payload)
    current = [one for one in message.metrics if one.HasField("timestamp") and not one.is_historical]
    times = {_given(one, "name") or f"alias {_given(one, 'alias')}": one.timestamp for one in current}
    return _given(message, "timestamp"), times


def _given(message: Any, field: str) -> Any:
    return _legal(getattr(message, field)) if message.HasField(field) else None


def _legal(value: Any) -> Any:
    # One implementation of protobuf gives text that is not UTF-8 as bytes, another raises.
    if isinstance(value, bytes):
        raise ValueError("a text of the payload is not UTF-8")
    return value


def _metric(metric: Any) -> dict[str, Any]:
    datatype = _given(metric, "datatype")
    name = None if datatype is None else DATA_TYPES[datatype] if datatype < len(DATA_TYPES) else str(datatype)
    label = _given(metric, "name") or f"alias {_given(metric, 'alias')}"
    return {
        "name": _given(metric, "name"),
        "alias": _given(metric, "alias"),
        "datatype": datatype,
        "value": None if metric.is_null else _value(metric, name, label),
        "is_null": metric.is_null,
    }


# Sparkplug 3.0.0, section 6.4.16: data types and the fields that carry them. UInt32 has two fields, since Tahu's Java code
# and its C code differ and consumers have to accept both.
_CARRIERS = {
    name: carriers
    for names, carriers in (
        (("Int8", "Int16", "Int32", "UInt8", "UInt16"), {"int_value"}),
        (("UInt32",), {"int_value", "long_value"}),
        (("Int64", "UInt64", "DateTime"), {"long_value"}),
        (("Float",), {"float_value"}),
        (("Double",), {"double_value"}),
        (("Boolean",), {"boolean_value"}),
        (("String", "Text", "UUID"), {"string_value"}),
        (("DataSet",), {"dataset_value"}),
        (("Template",), {"template_value"}),
        (("Bytes", "File", *(name for name in DATA_TYPES if name.endswith("Array"))), {"bytes_value"}),
    )
    for name in names
}


def _value(metric: Any, datatype: str | None, label: str) -> Any:
    carrier = metric.WhichOneof("value")
    if carrier is None:
        return None
    if datatype in _CARRIERS and carrier not in _CARRIERS[datatype]:
        raise ValueError(f"metric {label}: {datatype} must not be carried by the field {carrier}")
    value = getattr(metric, carrier)
    if carrier in ("int_value", "long_value"):
        return _integer(value, datatype, 32 if carrier == "int_value" else 64, label)
    if carrier in ("float_value", "double_value"):
        return _finite(value)
    if carrier == "bytes_value":
        if datatype is not None and datatype.endswith("Array"):
            return _array(value, datatype.removesuffix("Array"), label)
        return base64.b64encode(value).decode()
    if carrier == "dataset_value":
        rows = [[_cell(element) for element in row.elements] for row in value.rows]
        return {"columns": list(map(_legal, value.columns)), "rows": rows}
    if carrier == "template_value":
        return {"template_ref": _given(value, "template_ref"), "metrics": [_metric(inner) for inner in value.metrics]}
    return _legal(value)


def _integer(value: int, datatype: str | None, carried: int, label: str) -> int:
    signed = datatype is not None and datatype.startswith("Int")
    unsigned = datatype is not None and datatype.startswith("UInt")
    if not signed and not unsigned:
        return value
    assert datatype is not None
    width = int(datatype.removeprefix("U").removeprefix("Int"))
    # A negative Int8 or Int16 occurs both in its own width and extended to the width of its field.
    if signed and value >> (carried - 1) and value >= (1 << carried) - (1 << (width - 1)):
        return value - (1 << carried)
    if value >> width:
        raise ValueError(f"metric {label}: {value} does not fit {datatype}")
    return value - (1 << width) if signed and value >> (width - 1) else value


def _finite(value: float) -> float | str:
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def _cell(element: Any) -> Any:
    carrier = element.WhichOneof("value")
    value = None if carrier is None else getattr(element, carrier)
    return _finite(value) if isinstance(value, float) else _legal(value)


_FORMATS = {"Int8": "b", "Int16": "h", "Int32": "i", "Int64": "q", "UInt8": "B", "UInt16": "H", "UInt32": "I"}
_FORMATS |= {"UInt64": "Q", "Float": "f", "Double": "d", "DateTime": "Q"}


def _array(data: bytes, element: str, label: str) -> list[Any]:
    """Read an array (section 6.4.17): packed little-endian; booleans as a count and bits, most significant first; strings end
    with NUL."""
    if element == "String":
        if data and data[-1]:
            raise ValueError(f"metric {label}: the last string of the array is not ended by NUL")
        return [part.decode("utf-8", "replace") for part in data.split(b"\0")[:-1]]
    if element == "Boolean":
        count = int.from_bytes(data[:4], "little") if len(data) >= 4 else -1
        if len(data) != 4 + (count + 7) // 8:
            raise ValueError(f"metric {label}: the array's length does not match its count")
        return [bool(data[4 + i // 8] & (0x80 >> i % 8)) for i in range(count)]
    code = _FORMATS[element]
    if len(data) % struct.calcsize(code):
        raise ValueError(f"metric {label}: {len(data)} bytes are no array of {element}")
    values = [value for (value,) in struct.iter_unpack("<" + code, data)]
    return [_finite(value) for value in values] if code in "fd" else values
