"""Commands: the objects that select and operate an output, and what an outstation says of them.

dnp3py writes the number of objects as one octet before an index of two, which makes each command of an index above 255 malformed (0.6.0),
writes analog outputs as whole numbers of 32 bits only, and does not compare the echo with the request. So they are built here.
"""

from __future__ import annotations

import struct
from typing import Literal

from dnp3.application.fragment import ObjectBlock

from ..core import AdapterError, BadReply

__all__ = [
    "ON_CODES",
    "AnalogType",
    "ControlName",
    "analog_command",
    "binary_command",
    "echoed_status",
    "octets_written",
]

ControlName = Literal["latch_on", "latch_off", "pulse_on", "pulse_off", "trip", "close"]
AnalogType = Literal["int16", "int32", "float32", "float64"]

# Trip-close code and operation type (IEEE 1815, annex A.8.1).
_CODES = {"latch_on": 0x03, "latch_off": 0x04, "pulse_on": 0x01, "pulse_off": 0x02, "close": 0x41, "trip": 0x81}
ON_CODES = ("latch_on", "pulse_on", "close")
"""Control codes that switch something on; the others switch it off."""
_ANALOG = {"int32": (1, "<i"), "int16": (2, "<h"), "float32": (3, "<f"), "float64": (4, "<d")}
ANALOG_VARIATIONS = {kind: variation for kind, (variation, _) in _ANALOG.items()}
"""Variations of analog output blocks (g41) and, the same, of analog output statuses (g40)."""
_CROB, _ANALOG_BLOCK, _OCTETS = 12, 41, 110
_LONGEST = 255


def binary_command(index: int, code: ControlName, count: int, on_ms: int, off_ms: int) -> bytes:
    """Return a control relay output block (g12v1) for one output; times are in milliseconds."""
    return _header(_CROB, 1, index) + struct.pack("<BBIIx", _CODES[code], count, on_ms, off_ms)


def analog_command(index: int, kind: AnalogType, value: object) -> bytes:
    """Return an analog output block (g41) for one output.

    Raises:
        AdapterError: ``type_mismatch`` or ``range_overflow``; nothing is rounded or cut.
    """
    variation, layout = _ANALOG[kind]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise AdapterError("type_mismatch", "an analog output holds a number", field="/value", outcome="not_sent")
    if not kind.startswith("float"):
        if value != int(value):
            message = f"this analog output is commanded as {kind}, which has whole numbers only"
            raise AdapterError("type_mismatch", message, field="/value", outcome="not_sent")
        value = int(value)
    try:
        content = struct.pack(layout, value)
    except (OverflowError, struct.error):
        message = f"the value does not fit into {kind}"
        raise AdapterError("range_overflow", message, field="/value", outcome="not_sent") from None
    return _header(_ANALOG_BLOCK, variation, index) + content + b"\0"


def octets_written(index: int, value: object) -> bytes:
    """Return an octet string (g110) for one point, whose variation is its length.

    Raises:
        AdapterError: the value is no text, or one that an octet string cannot hold.
    """
    if not isinstance(value, str):
        raise AdapterError("type_mismatch", "an octet string holds a text", field="/value", outcome="not_sent")
    content = value.encode()
    if not 1 <= len(content) <= _LONGEST:
        code, message = "limit_exceeded", f"an octet string has 1 to {_LONGEST} bytes of UTF-8"
        raise AdapterError(code, message, field="/value", outcome="not_sent")
    short = index <= 0xFF
    return bytes([_OCTETS, len(content), not short]) + struct.pack("<BB" if short else "<HH", index, index) + content


def _header(group: int, variation: int, index: int) -> bytes:
    """Return the object header, count and index of one object; the widths of count and index are the same."""
    if index <= 0xFF:
        return struct.pack("<BBBBB", group, variation, 0x17, 1, index)
    return struct.pack("<BBBHH", group, variation, 0x28, 1, index)


def echoed_status(objects: bytes, blocks: list[ObjectBlock]) -> int:
    """Return the status of a command, which is in the echo of its object and nowhere else.

    Raises:
        BadReply: the answer does not repeat the object.
    """
    echo = b"".join(block.to_bytes() for block in blocks)
    if echo[:-1] != objects[:-1] or len(echo) != len(objects):
        raise BadReply("it does not repeat the command")
    return echo[-1] & 0x7F
