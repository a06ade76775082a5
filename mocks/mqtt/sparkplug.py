"""The Sparkplug B payload (Sparkplug 3.0, section 6.4), from a table of its fields.

The descriptors are built at import in a pool of their own: no generated code, no clash with another package's copy of
the same schema. Field names and numbers are those of the Eclipse Sparkplug specification (EFSL); members this kit only
has to keep (metadata, properties, data sets, templates) are declared as bytes, which is the same on the wire.
"""

from __future__ import annotations

import struct
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

__all__ = ["DATATYPES", "decode_message", "encode_payload", "topic_parts"]

_F = descriptor_pb2.FieldDescriptorProto
_PAYLOAD = (
    ("timestamp", 1, _F.TYPE_UINT64),
    ("seq", 3, _F.TYPE_UINT64),
    ("uuid", 4, _F.TYPE_STRING),
    ("body", 5, _F.TYPE_BYTES),
)
_METRIC = (
    ("name", 1, _F.TYPE_STRING),
    ("alias", 2, _F.TYPE_UINT64),
    ("timestamp", 3, _F.TYPE_UINT64),
    ("datatype", 4, _F.TYPE_UINT32),
    ("is_historical", 5, _F.TYPE_BOOL),
    ("is_transient", 6, _F.TYPE_BOOL),
    ("is_null", 7, _F.TYPE_BOOL),
    ("metadata", 8, _F.TYPE_BYTES),
    ("properties", 9, _F.TYPE_BYTES),
)
_VALUE = (
    ("int_value", 10, _F.TYPE_UINT32),
    ("long_value", 11, _F.TYPE_UINT64),
    ("float_value", 12, _F.TYPE_FLOAT),
    ("double_value", 13, _F.TYPE_DOUBLE),
    ("boolean_value", 14, _F.TYPE_BOOL),
    ("string_value", 15, _F.TYPE_STRING),
    ("bytes_value", 16, _F.TYPE_BYTES),
    ("dataset_value", 17, _F.TYPE_BYTES),
    ("template_value", 18, _F.TYPE_BYTES),
)

DATATYPES = {
    "Int8": 1,
    "Int16": 2,
    "Int32": 3,
    "Int64": 4,
    "UInt8": 5,
    "UInt16": 6,
    "UInt32": 7,
    "UInt64": 8,
    "Float": 9,
    "Double": 10,
    "Boolean": 11,
    "String": 12,
    "DateTime": 13,
    "Text": 14,
    "UUID": 15,
    "Bytes": 17,
}
_SIGNED = {1: 32, 2: 32, 3: 32, 4: 64}


def _build() -> Any:
    file = descriptor_pb2.FileDescriptorProto(
        name="otmcp_mock_sparkplug_b.proto", package="otmcp.mock", syntax="proto2"
    )
    payload = file.message_type.add(name="Payload")
    metric = payload.nested_type.add(name="Metric")
    metric.oneof_decl.add(name="value")
    for name, number, kind in _METRIC:
        metric.field.add(name=name, number=number, type=kind, label=_F.LABEL_OPTIONAL)
    for name, number, kind in _VALUE:
        metric.field.add(name=name, number=number, type=kind, label=_F.LABEL_OPTIONAL, oneof_index=0)
    for name, number, kind in _PAYLOAD:
        payload.field.add(name=name, number=number, type=kind, label=_F.LABEL_OPTIONAL)
    payload.field.add(
        name="metrics",
        number=2,
        type=_F.TYPE_MESSAGE,
        type_name=".otmcp.mock.Payload.Metric",
        label=_F.LABEL_REPEATED,
    )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("otmcp.mock.Payload"))


_Payload = _build()


def encode_payload(metrics: list[dict[str, Any]], *, timestamp: int, seq: int | None) -> bytes:
    """The bytes of a payload.

    Args:
        metrics: each with name, datatype (a key of :data:`DATATYPES`) and value.
        timestamp: milliseconds since the epoch, of the payload and of every metric.
        seq: sequence number, None for NDEATH.
    """
    payload = _Payload(timestamp=timestamp)
    if seq is not None:
        payload.seq = seq
    for source in metrics:
        number = DATATYPES[source["datatype"]]
        metric = payload.metrics.add(name=source["name"], timestamp=timestamp, datatype=number)
        _set_value(metric, number, source["value"])
    data: bytes = payload.SerializeToString()
    return data


def _set_value(metric: Any, number: int, value: Any) -> None:
    if number in (1, 2, 3, 5, 6, 7):
        metric.int_value = value & 0xFFFFFFFF
    elif number in (4, 8, 13):
        metric.long_value = value & 0xFFFFFFFFFFFFFFFF
    elif number == 9:
        metric.float_value = value
    elif number == 10:
        metric.double_value = value
    elif number == 11:
        metric.boolean_value = value
    elif number == 17:
        metric.bytes_value = value
    else:
        metric.string_value = value


def topic_parts(topic: str) -> tuple[str, str, str, str | None] | None:
    """(group, type, edge node, device) of a Sparkplug topic, or None."""
    parts = topic.split("/")
    if len(parts) not in (4, 5) or parts[0] != "spBv1.0":
        return None
    return parts[1], parts[2], parts[3], parts[4] if len(parts) == 5 else None


def decode_message(topic: str, data: bytes) -> dict[str, Any]:
    """A Sparkplug message for the journal, or ``{"error": …}``."""
    parts = topic_parts(topic)
    if parts is None:
        return {"error": "not a Sparkplug topic"}
    payload = _Payload()
    try:
        payload.ParseFromString(data)
    except Exception as error:  # protobuf's DecodeError differs between its implementations
        return {"error": f"not a Sparkplug payload: {error}"}
    group, kind, node, device = parts
    return {
        "group": group,
        "type": kind,
        "edge_node": node,
        "device": device,
        "seq": payload.seq if payload.HasField("seq") else None,
        "timestamp": payload.timestamp if payload.HasField("timestamp") else None,
        "metrics": [_metric(metric) for metric in payload.metrics],
    }


def _metric(metric: Any) -> dict[str, Any]:
    member = metric.WhichOneof("value")
    value = None if member is None else getattr(metric, member)
    if isinstance(value, bytes):
        value = value.hex()
    elif isinstance(value, int) and not isinstance(value, bool) and metric.datatype in _SIGNED:
        # Negative numbers travel as two's complement in an unsigned field (section 6.4.16).
        size = _SIGNED[metric.datatype]
        value = struct.unpack("q" if size == 64 else "i", struct.pack("Q" if size == 64 else "I", value))[0]
    return {
        "name": metric.name if metric.HasField("name") else None,
        "alias": metric.alias if metric.HasField("alias") else None,
        "datatype": metric.datatype if metric.HasField("datatype") else None,
        "value": value,
        "is_null": metric.is_null,
    }
