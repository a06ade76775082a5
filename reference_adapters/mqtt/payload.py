"""Sparkplug B payloads (Sparkplug 3.0, section 6.4): strict encoding by datatype, decoding to JSON.

The message types are built from the specification's field table in a descriptor pool of their own, so that they cannot clash
with a generated module of another package. Parts that are only passed on (metadata, properties, data sets, templates) are
declared as bytes, which is the same on the wire.
"""

from __future__ import annotations

import base64
import re
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from typing_extensions import TypedDict

from ..core import AdapterError, exact_in_json, special_name

__all__ = [
    "REBIRTH",
    "Datatype",
    "DecodedMetric",
    "Metric",
    "Payload",
    "check_value",
    "decode",
    "encode",
    "is_rebirth_command",
]

REBIRTH = "Node Control/Rebirth"
"""The metric with which a host asks an edge node for its births (operational-behavior-data-commands-rebirth-name)."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """A metric to be published; the value None is null."""

    name: str
    datatype: Datatype
    value: Any


_NUMBERS: dict[str, int] = {
    **{name: index for index, name in enumerate(("Int8", "Int16", "Int32", "Int64"), 1)},
    **{name: index for index, name in enumerate(("UInt8", "UInt16", "UInt32", "UInt64"), 5)},
    **{name: index for index, name in enumerate(("Float", "Double", "Boolean", "String"), 9)},
    **{name: index for index, name in enumerate(("DateTime", "Text", "UUID"), 13)},
    "Bytes": 17,
}
# Sparkplug 3.0, section 6.4.16. Types that are not in _NUMBERS are only received, as bytes.
_NAMES = {
    **{number: name for name, number in _NUMBERS.items()},
    **dict(enumerate(("DataSet", "Bytes", "File", "Template", "PropertySet", "PropertySetList"), 16)),
    **dict(enumerate((f"{name}Array" for name in (*_NUMBERS,)[:13]), 22)),
}
_SIGNED = ("Int8", "Int16", "Int32", "Int64")
_BITS = {"Int8": 8, "Int16": 16, "Int32": 32, "Int64": 64, "UInt8": 8, "UInt16": 16, "UInt32": 32, "UInt64": 64}
_LARGEST_FLOAT = 3.4028234663852886e38
_UUID = re.compile(r"[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}")

_TABLE = """
Payload  1 uint64 timestamp   3 uint64 seq   4 string uuid   5 bytes body
Metric   1 string name   2 uint64 alias   3 uint64 timestamp   4 uint32 datatype   5 bool is_historical
Metric   6 bool is_transient   7 bool is_null   8 bytes metadata   9 bytes properties
Value    10 uint32 int_value   11 uint64 long_value   12 float float_value   13 double double_value
Value    14 bool boolean_value   15 string string_value   16 bytes bytes_value   17 bytes dataset_value
Value    18 bytes template_value
"""


MAX_TEXT = 65_535
"""Characters of a text, or of the base64 of bytes, in one metric that is published."""

MAX_METRICS = 5000
"""Limit for the metrics of one received payload that are decoded; a megabyte can hold half a million empty ones."""


class DecodedMetric(TypedDict):
    """A metric that was received.

    ``special`` is set where ``value`` is null because JSON has no word for it (NaN, infinities); ``encoding`` is base64
    where ``value`` stands for bytes. Whole numbers that JSON readers would round are decimal strings.
    """

    name: str | None
    alias: int | str | None
    datatype: str | None
    value: Any
    special: str | None
    is_null: bool
    encoding: str | None


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
    """Check that the value is of the datatype and within its range; nothing is coerced.

    Raises:
        AdapterError: ``type_mismatch``, ``range_overflow``, or ``limit_exceeded`` for a text.
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
        if abs(value) > (_LARGEST_FLOAT if datatype == "Float" else sys.float_info.max):
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
    elif len(value) > MAX_TEXT:
        raise AdapterError("limit_exceeded", f"a text has at most {MAX_TEXT} characters", field=field)
    elif datatype == "UUID":
        if not _UUID.fullmatch(value):
            raise mismatch("text as 123e4567-e89b-12d3-a456-426614174000")
    elif datatype == "Bytes":
        try:
            base64.b64decode(value, validate=True)
        except ValueError:
            raise mismatch("base64 text") from None


def encode(metrics: Iterable[Metric], seq: int | None) -> bytes:
    """Return the bytes of a payload with checked metrics; ``seq`` is None where the specification has none."""
    now = time.time_ns() // 1_000_000
    payload = _Payload(timestamp=now)
    if seq is not None:
        payload.seq = seq
    for told in metrics:
        datatype, value = told.datatype, told.value
        metric = payload.metrics.add(name=told.name, timestamp=now, datatype=_NUMBERS[datatype])
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Payload:
    """A payload that was received.

    Attributes:
        seq, timestamp: None where the payload has none.
        metrics: the first :data:`MAX_METRICS`, in their order.
        total: number of metrics that it holds.
    """

    seq: int | None
    timestamp: int | None
    metrics: list[DecodedMetric]
    total: int


def decode(data: bytes, births: Mapping[str | int, DecodedMetric] | None = None) -> Payload:
    """Decode a payload.

    Args:
        data: the bytes of the payload.
        births: metrics of the birth by name and by alias; data messages may leave out names and datatypes.

    Raises:
        AdapterError: ``invalid_input``: not a Sparkplug payload.
    """
    payload = _Payload()
    try:
        payload.ParseFromString(data)
    except DecodeError:
        raise AdapterError("invalid_input", "not a Sparkplug B payload", field="/payload") from None
    return Payload(
        seq=payload.seq if payload.HasField("seq") else None,
        timestamp=payload.timestamp if payload.HasField("timestamp") else None,
        metrics=[_decoded(metric, births or {}) for metric in payload.metrics[:MAX_METRICS]],
        total=len(payload.metrics),
    )


def is_rebirth_command(data: bytes) -> bool:
    """Tell whether the payload of an NCMD asks for the births; bytes that are no payload do not."""
    try:
        metrics = decode(data).metrics
    except AdapterError:
        return False
    return any(metric["name"] == REBIRTH and metric["value"] is True for metric in metrics)


def _decoded(metric: Any, births: Mapping[str | int, DecodedMetric]) -> DecodedMetric:
    name = metric.name if metric.HasField("name") else None
    alias = metric.alias if metric.HasField("alias") else None
    born = births.get(alias if name is None and alias is not None else name or "")
    datatype = _NAMES.get(metric.datatype) if metric.HasField("datatype") else born and born["datatype"]
    member = metric.WhichOneof("value")
    value = None if member is None or metric.is_null else getattr(metric, member)
    special = encoding = None
    if isinstance(value, bytes):
        value, encoding = base64.b64encode(value).decode(), "base64"
    elif isinstance(value, float):
        special = special_name(value)
        value = value if special is None else None
    elif isinstance(value, int) and not isinstance(value, bool):
        bits = 64 if member == "long_value" else 32
        if datatype in _SIGNED and value >= 2 ** (bits - 1):
            value -= 2**bits
        value = exact_in_json(value)
    return {
        "name": born["name"] if name is None and born else name,
        "alias": exact_in_json(alias),
        "datatype": datatype,
        "value": value,
        "special": special,
        "is_null": bool(metric.is_null),
        "encoding": encoding,
    }
