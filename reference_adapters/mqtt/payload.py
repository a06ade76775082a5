"""Sparkplug B payloads (Sparkplug 3.0, section 6.4): strict encoding by datatype, decoding to JSON.

The message types are built from the specification's field table in a descriptor pool of their own, so that no generated
module can clash with another package's. Parts that are only passed on (metadata, properties, data sets, templates) are
declared as bytes: the same on the wire.
"""

from __future__ import annotations

import base64
import math
import time
from typing import Any, Literal

from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

from ..core import AdapterError

__all__ = ["Datatype", "Metric", "check_value", "decode", "encode"]

Datatype = Literal[
    "Int8",
    "Int16",
    "Int32",
    "Int64",
    "UInt8",
    "UInt16",
    "UInt32",
    "UInt64",
    "Float",
    "Double",
    "Boolean",
    "String",
    "DateTime",
    "Text",
    "UUID",
    "Bytes",
]
Metric = tuple[str, Datatype, Any]
"""Name, datatype and value; None is null."""

_NUMBERS: dict[str, int] = {
    **{name: index for index, name in enumerate(("Int8", "Int16", "Int32", "Int64"), 1)},
    **{name: index for index, name in enumerate(("UInt8", "UInt16", "UInt32", "UInt64"), 5)},
    **{name: index for index, name in enumerate(("Float", "Double", "Boolean", "String"), 9)},
    **{name: index for index, name in enumerate(("DateTime", "Text", "UUID"), 13)},
    "Bytes": 17,
}
_NAMES = {number: name for name, number in _NUMBERS.items()}
_BITS = {"Int8": 8, "Int16": 16, "Int32": 32, "Int64": 64, "UInt8": 8, "UInt16": 16, "UInt32": 32, "UInt64": 64}
_LARGEST_FLOAT = 3.4028234663852886e38
_EXACT_IN_JSON = 2**53 - 1

_TABLE = """
Payload  1 uint64 timestamp   3 uint64 seq   4 string uuid   5 bytes body
Metric   1 string name   2 uint64 alias   3 uint64 timestamp   4 uint32 datatype   5 bool is_historical
Metric   6 bool is_transient   7 bool is_null   8 bytes metadata   9 bytes properties
Value    10 uint32 int_value   11 uint64 long_value   12 float float_value   13 double double_value
Value    14 bool boolean_value   15 string string_value   16 bytes bytes_value   17 bytes dataset_value
Value    18 bytes template_value
"""


def _message_class() -> Any:
    file = FileDescriptorProto(name="otmcp_adapter_sparkplug_b.proto", package="otmcp.adapter", syntax="proto2")
    payload = file.message_type.add(name="Payload")
    metric = payload.nested_type.add(name="Metric")
    metric.oneof_decl.add(name="value")
    for line in _TABLE.split("\n"):
        words = line.split()
        for at in range(1, len(words), 3):
            number, kind, name = words[at : at + 3]
            owner = payload if words[0] == "Payload" else metric
            field = owner.field.add(name=name, number=int(number), label=Field.LABEL_OPTIONAL)
            field.type = Field.Type.Value(f"TYPE_{kind.upper()}")
            if words[0] == "Value":
                field.oneof_index = 0
    metrics = payload.field.add(name="metrics", number=2, label=Field.LABEL_REPEATED, type=Field.TYPE_MESSAGE)
    metrics.type_name = ".otmcp.adapter.Payload.Metric"
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("otmcp.adapter.Payload"))


_Payload = _message_class()


def check_value(datatype: Datatype, value: Any, field: str) -> None:
    """The value is of the datatype and within its range; nothing is coerced.

    Raises:
        AdapterError: ``type_mismatch`` or ``range_overflow``.
    """

    def mismatch(needed: str) -> AdapterError:
        return AdapterError("type_mismatch", f"{datatype} needs {needed}", outcome="not_sent", field=field)

    if value is None:
        return
    if datatype == "Boolean":
        if not isinstance(value, bool):
            raise mismatch("true or false")
    elif datatype in ("Float", "Double"):
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise mismatch("a number")
        if not math.isfinite(value) or (datatype == "Float" and abs(value) > _LARGEST_FLOAT):
            raise AdapterError("range_overflow", f"the value does not fit into {datatype}", field=field)
    elif datatype in _BITS or datatype == "DateTime":
        if isinstance(value, bool) or not isinstance(value, int):
            raise mismatch("a whole number")
        bits, signed = _BITS.get(datatype, 64), datatype.startswith("Int")
        low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
        if not low <= value <= high:
            allowed = {"min": low, "max": high}
            raise AdapterError("range_overflow", f"{datatype} holds {low} to {high}", field=field, allowed=allowed)
    elif not isinstance(value, str):
        raise mismatch("a string")
    elif datatype == "Bytes":
        try:
            base64.b64decode(value, validate=True)
        except ValueError:
            raise mismatch("base64 text") from None


def encode(metrics: list[Metric], seq: int | None) -> bytes:
    """The bytes of a payload with checked metrics; ``seq`` is None where the specification has none."""
    now = time.time_ns() // 1_000_000
    payload = _Payload(timestamp=now)
    if seq is not None:
        payload.seq = seq
    for name, datatype, value in metrics:
        metric = payload.metrics.add(name=name, timestamp=now, datatype=_NUMBERS[datatype])
        if value is None:
            metric.is_null = True
        elif datatype in ("Int64", "UInt64", "DateTime"):
            metric.long_value = value & 0xFFFFFFFFFFFFFFFF
        elif datatype in _BITS:
            # Section 6.4.16: negative numbers are two's complement in an unsigned field.
            metric.int_value = value & 0xFFFFFFFF
        elif datatype == "Boolean":
            metric.boolean_value = value
        elif datatype == "Float":
            metric.float_value = value
        elif datatype == "Double":
            metric.double_value = value
        elif datatype == "Bytes":
            metric.bytes_value = base64.b64decode(value)
        else:
            metric.string_value = value
    data: bytes = payload.SerializeToString()
    return data


def decode(data: bytes) -> dict[str, Any]:
    """A payload as JSON.

    Raises:
        AdapterError: ``invalid_input``: not a Sparkplug payload.
    """
    payload = _Payload()
    try:
        payload.ParseFromString(data)
    except DecodeError:
        raise AdapterError("invalid_input", "not a Sparkplug B payload", field="/payload") from None
    return {
        "seq": payload.seq if payload.HasField("seq") else None,
        "timestamp": payload.timestamp if payload.HasField("timestamp") else None,
        "metrics": [_decoded(metric) for metric in payload.metrics],
    }


def _decoded(metric: Any) -> dict[str, Any]:
    datatype = _NAMES.get(metric.datatype)
    member = metric.WhichOneof("value")
    value = None if member is None or metric.is_null else getattr(metric, member)
    special = None
    if isinstance(value, bytes):
        value = base64.b64encode(value).decode()
    elif isinstance(value, float) and not math.isfinite(value):
        special = "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
        value = None
    elif isinstance(value, int) and not isinstance(value, bool):
        bits = 64 if member == "long_value" else 32
        if datatype is not None and datatype.startswith("Int") and value >= 2 ** (bits - 1):
            value -= 2**bits
        if abs(value) > _EXACT_IN_JSON:
            value = str(value)
    return {
        "name": metric.name if metric.HasField("name") else None,
        "alias": metric.alias if metric.HasField("alias") else None,
        "datatype": datatype,
        "value": value,
        "special": special,
        "is_null": bool(metric.is_null),
    }
