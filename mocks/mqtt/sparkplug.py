"""The Sparkplug B payload (Sparkplug 3.0, section 6.4), from a table of its fields.

The descriptors are built at import in a pool of their own: no generated code, no clash with another package's copy of
the same schema. Names, numbers and types are those of the Eclipse Sparkplug specification (EFSL). Its empty extension
messages are left out: their content is kept as unknown fields.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

__all__ = ["DATATYPES", "DataSet", "decode_message", "encode_payload", "topic_parts"]

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


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSet:
    """A table of values.

    Attributes:
        types: a name of :data:`DATATYPES` for each column.
    """

    columns: tuple[str, ...]
    types: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    @classmethod
    def of(cls, source: Mapping[str, Any], read: Callable[[str, Any], Any]) -> DataSet:
        """Read it from JSON; ``read`` returns a value of a datatype.

        Raises:
            ValueError: it is not understood.
        """
        columns, types, rows = (source.get(name) for name in ("columns", "types", "rows"))
        if not (isinstance(columns, list) and isinstance(types, list) and isinstance(rows, list)):
            raise ValueError(f"a DataSet has lists of columns, types and rows, found {source!r}")
        if len(columns) != len(types) or any(not isinstance(row, list) or len(row) != len(types) for row in rows):
            raise ValueError("a DataSet has as many types, and values in each row, as columns")
        cells = tuple(tuple(map(read, types, row)) for row in rows)
        return cls(columns=tuple(map(str, columns)), types=tuple(types), rows=cells)

    def as_json(self, shown: Callable[[Any], Any]) -> dict[str, Any]:
        """Return it as JSON; ``shown`` makes a value JSON-safe."""
        rows = [[shown(cell) for cell in row] for row in self.rows]
        return {"columns": list(self.columns), "types": list(self.types), "rows": rows}


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
        metrics: each with name, datatype (a key of :data:`DATATYPES`) and value, and optionally an alias. None for a name leaves
            it out, None for a value makes the metric null.
        timestamp: milliseconds since the epoch, of the payload and of every metric.
        seq: sequence number, None for NDEATH.
    """
    payload = _Payload(timestamp=timestamp)
    if seq is not None:
        payload.seq = seq
    for source in metrics:
        added = payload.metrics.add(timestamp=timestamp)
        if source.get("name") is not None:
            added.name = source["name"]
        if source.get("alias") is not None:
            added.alias = source["alias"]
        if source["datatype"] is not None:
            added.datatype = DATATYPES[source["datatype"]]
        if source["value"] is None:
            added.is_null = True
        elif isinstance(source["value"], DataSet):
            _add_data_set(added.dataset_value, source["value"])
        else:
            _set_value(added, source["datatype"], source["value"])
    data: bytes = payload.SerializeToString()
    return data


def _set_value(message: Any, datatype: str, value: Any) -> None:
    member = _MEMBERS[datatype]
    if member in _BITS:
        # Negative numbers travel as two's complement in an unsigned field (section 6.4.16).
        value &= (1 << _BITS[member]) - 1
    setattr(message, member, value)


def _add_data_set(message: Any, table: DataSet) -> None:
    message.num_of_columns = len(table.columns)
    message.columns.extend(table.columns)
    message.types.extend(DATATYPES[name] for name in table.types)
    for row in table.rows:
        added = message.rows.add()
        for datatype, value in zip(table.types, row, strict=True):
            cell = added.elements.add()
            if value is not None:
                _set_value(cell, datatype, value)


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
    """Return a value JSON-safe: bytes as base64, data sets and templates as text, and NaN and infinities by name."""
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
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if metric.datatype in _SIGNED and member in _BITS and value >> (_BITS[member] - 1):
        return value - (1 << _BITS[member])
    return value
