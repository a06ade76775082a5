"""Sparkplug B payloads, encoded without any adapter's code (Sparkplug 3.0, section 6.4; Protocol Buffers encoding)."""

from __future__ import annotations

import struct
from collections.abc import Iterable

__all__ = ["DOUBLE", "INT64", "UINT64", "payload_of"]

INT64, UINT64, DOUBLE = 4, 8, 10
"""Data types of metrics."""

_VARINT, _EIGHT_BYTES, _LENGTH = 0, 1, 2
_TIMESTAMP = 1_795_000_000_000


def _varint(number: int) -> bytes:
    data = bytearray()
    while number > 0x7F:
        data.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*data, number])


def _field(number: int, wire: int, data: bytes) -> bytes:
    prefix = _varint(number << 3 | wire)
    return prefix + (_varint(len(data)) + data if wire == _LENGTH else data)


def payload_of(metrics: Iterable[tuple[str, int, float]]) -> bytes:
    """Return a payload with these metrics: name, data type and value."""
    encoded = b"".join(_field(2, _LENGTH, _metric(*metric)) for metric in metrics)
    return _field(1, _VARINT, _varint(_TIMESTAMP)) + encoded + _field(3, _VARINT, _varint(1))


def _metric(name: str, datatype: int, value: float) -> bytes:
    data = _field(1, _LENGTH, name.encode()) + _field(4, _VARINT, _varint(datatype))
    if datatype == DOUBLE:
        return data + _field(13, _EIGHT_BYTES, struct.pack("<d", value))
    # A negative number is the unsigned one that has its bits.
    return data + _field(11, _VARINT, _varint(int(value) & 0xFFFF_FFFF_FFFF_FFFF))
