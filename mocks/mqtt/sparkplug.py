"""The Sparkplug B payload (Sparkplug 3.0, section 6.4), from a table of its fields.

The descriptors are built at import in a pool of their own: no generated code, no clash with another package's copy of
the same schema. Names, numbers and types are those of the Eclipse Sparkplug specification (EFSL). Its empty extension
messages are left out: their content is kept as unknown fields.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

__all__ = ["DATATYPES", "decode_message", "encode_payload", "topic_parts"]

_SCALARS = (
    ("int_value", "uint32"),
    ("long_value", "uint64"),
    ("float_value", "float"),
    ("double_value", "double"),
    ("boolean_value", "bool"),
    ("string_value", "string"),
)
_SCHEMA: dict[str, tuple[Sequence[tuple[str, str]], Sequence[tuple[str, str]]]] = {
    # Message: its fields, then those of its oneof "value", numbered from 1 in this order. A star repeats.
    "Payload": (
        (
            ("timestamp", "uint64"),
            ("metrics", "Metric*"),
            ("seq", "uint64"),
            ("uuid", "string"),
            ("body", "bytes"),
        ),
        (),
    ),
    "Metric": (
        (
            ("name", "string"),
            ("alias", "uint64"),
            ("timestamp", "uint64"),
            ("datatype", "uint32"),
            ("is_historical", "bool"),
            ("is_transient", "bool"),
            ("is_null", "bool"),
            ("metadata", "MetaData"),
            ("properties", "PropertySet"),
        ),
        (
            *_SCALARS,
            ("bytes_value", "bytes"),
            ("dataset_value", "DataSet"),
            ("template_value", "Template"),
        ),
    ),
    "MetaData": (
        (
            ("is_multi_part", "bool"),
            ("content_type", "string"),
            ("size", "uint64"),
            ("seq", "uint64"),
            ("file_name", "string"),
            ("file_type", "string"),
            ("md5", "string"),
            ("description", "string"),
        ),
        (),
    ),
    "PropertySet": ((("keys", "string*"), ("values", "PropertyValue*")), ()),
    "PropertySetList": ((("propertyset", "PropertySet*"),), ()),
    "PropertyValue": (
        (("type", "uint32"), ("is_null", "bool")),
        (*_SCALARS, ("propertyset_value", "PropertySet"), ("propertysets_value", "PropertySetList")),
    ),
    "DataSet": (
        (("num_of_columns", "uint64"), ("columns", "string*"), ("types", "uint32*"), ("rows", "Row*")),
        (),
    ),
    "Row": ((("elements", "DataSetValue*"),), ()),
    "DataSetValue": ((), _SCALARS),
    "Template": (
        (
            ("version", "string"),
            ("metrics", "Metric*"),
            ("parameters", "Parameter*"),
            ("template_ref", "string"),
            ("is_definition", "bool"),
        ),
        (),
    ),
    "Parameter": ((("name", "string"), ("type", "uint32")), _SCALARS),
}

_NAMES = "Int8 Int16 Int32 Int64 UInt8 UInt16 UInt32 UInt64 Float Double Boolean String DateTime Text UUID DataSet Bytes File"
DATATYPES = {name: number for number, name in enumerate(_NAMES.split(), start=1)}
"""Datatype indexes (section 6.4.16), as far as values are set or read here."""

_SIGNED = {DATATYPES[name] for name in ("Int8", "Int16", "Int32", "Int64")}
_MEMBERS = {
    **dict.fromkeys(("Int8", "Int16", "Int32", "UInt8", "UInt16", "UInt32"), "int_value"),
    **dict.fromkeys(("Int64", "UInt64", "DateTime"), "long_value"),
    **dict.fromkeys(("String", "Text", "UUID"), "string_value"),
    "Float": "float_value",
    "Double": "double_value",
    "Boolean": "boolean_value",
    "Bytes": "bytes_value",
    "File": "bytes_value",
}
_BITS = {"int_value": 32, "long_value": 64}


def _build() -> Any:
    package = "otmcp.mock.sparkplug"
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="otmcp_mock_sparkplug.proto", package=package, syntax="proto2")
    for message_name, (fields, alternatives) in _SCHEMA.items():
        message = file.message_type.add(name=message_name)
        if alternatives:
            message.oneof_decl.add(name="value")
        for number, (name, declared) in enumerate((*fields, *alternatives), start=1):
            label = kinds.LABEL_REPEATED if declared.endswith("*") else kinds.LABEL_OPTIONAL
            field = message.field.add(name=name, number=number, label=label)
            if number > len(fields):
                field.oneof_index = 0
            kind = declared.rstrip("*")
            if kind in _SCHEMA:
                field.type = kinds.TYPE_MESSAGE
                field.type_name = f".{package}.{kind}"
            else:
                field.type = kinds.Type.Value(f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.Payload"))


_Payload = _build()


def encode_payload(metrics: list[dict[str, Any]], *, timestamp: int, seq: int | None) -> bytes:
    """Return the bytes of a payload.

    Args:
        metrics: each with name, datatype (a key of :data:`DATATYPES`) and value.
        timestamp: milliseconds since the epoch, of the payload and of every metric.
        seq: sequence number, None for NDEATH.
    """
    payload = _Payload(timestamp=timestamp)
    if seq is not None:
        payload.seq = seq
    for source in metrics:
        datatype, value = source["datatype"], source["value"]
        member = _MEMBERS[datatype]
        if member in _BITS:
            # Negative numbers travel as two's complement in an unsigned field (section 6.4.16).
            value &= (1 << _BITS[member]) - 1
        fields = {"name": source["name"], "timestamp": timestamp, "datatype": DATATYPES[datatype], member: value}
        payload.metrics.add(**fields)
    data: bytes = payload.SerializeToString()
    return data


def topic_parts(topic: str) -> tuple[str, str, str, str | None] | None:
    """Return (group, type, edge node, device) of a Sparkplug topic, or None."""
    parts = topic.split("/")
    if len(parts) not in (4, 5) or parts[0] != "spBv1.0":
        return None
    return parts[1], parts[2], parts[3], parts[4] if len(parts) == 5 else None


def decode_message(topic: str, data: bytes) -> dict[str, Any]:
    """Return a Sparkplug message for the journal, or ``{"error": …}``."""
    parts = topic_parts(topic)
    if parts is None:
        return {"error": "not a Sparkplug topic"}
    payload = _Payload()
    try:
        payload.ParseFromString(data)
        metrics = [_metric(metric) for metric in payload.metrics]
    except (DecodeError, UnicodeDecodeError) as error:
        return {"error": f"not a Sparkplug payload: {error}"}
    group, kind, node, device = parts
    return {
        "group": group,
        "type": kind,
        "edge_node": node,
        "device": device,
        "seq": payload.seq if payload.HasField("seq") else None,
        "timestamp": payload.timestamp if payload.HasField("timestamp") else None,
        "metrics": metrics,
    }


def _metric(metric: Any) -> dict[str, Any]:
    return {
        "name": _text(metric.name) if metric.HasField("name") else None,
        "alias": metric.alias if metric.HasField("alias") else None,
        "datatype": metric.datatype if metric.HasField("datatype") else None,
        "value": _value(metric),
        "is_null": metric.is_null,
    }


def _text(value: str | bytes) -> str:
    # One implementation of protobuf gives text that is not UTF-8 as bytes, another raises.
    return value if isinstance(value, str) else value.decode()


def _value(metric: Any) -> Any:
    """Return a value JSON-safe: bytes as base64, data sets and templates as text."""
    member = metric.WhichOneof("value")
    if member is None:
        return None
    value = getattr(metric, member)
    if member == "string_value":
        return _text(value)
    if member == "bytes_value":
        return base64.b64encode(value).decode()
    if member in ("dataset_value", "template_value"):
        return str(value)
    if metric.datatype in _SIGNED and member in _BITS and value >> (_BITS[member] - 1):
        return value - (1 << _BITS[member])
    return value
