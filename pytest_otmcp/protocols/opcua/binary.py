"""Reader of the built-in types of OPC UA Binary (OPC 10000-6, section 5.2.2) into JSON-safe values. Pure.

It is written from the specification, not from the library that adapter and mock use.
"""

from __future__ import annotations

import base64
import math
import struct
import uuid
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

from ...wire.framing import MalformedError
from .status_codes import SYMBOLS

__all__ = ["BinaryReader", "symbol"]

_EPOCH = datetime(1601, 1, 1, tzinfo=UTC)
_DEEPEST = 32

VARIANT_TYPES = (
    *("Null", "Boolean", "SByte", "Byte", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Float", "Double"),
    *("String", "DateTime", "Guid", "ByteString", "XmlElement", "NodeId", "ExpandedNodeId", "StatusCode"),
    *("QualifiedName", "LocalizedText", "ExtensionObject", "DataValue", "Variant", "DiagnosticInfo"),
)
"""Names of the built-in types; the index is the type's number in a Variant (section 5.1.2)."""

_NUMBERS = {2: "b", 3: "B", 4: "h", 5: "H", 6: "i", 7: "I", 8: "q", 9: "Q", 10: "f", 11: "d"}


def symbol(status: int) -> str:
    """Return the symbol of a status code by its upper 16 bits (the lower ones are information); hexadecimal when unknown."""
    return SYMBOLS.get(status >> 16, f"0x{status:08X}")


class BinaryReader:
    """Reader of one message body, from its beginning to its end."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0
        self._depth = 0

    @property
    def left(self) -> int:
        """Bytes that have not been read."""
        return len(self._data) - self._at

    def take(self, count: int) -> bytes:
        """Return the next bytes.

        Raises:
            MalformedError: fewer bytes are left.
        """
        if count < 0 or self._at + count > len(self._data):
            raise MalformedError("the message ends in the middle of a field")
        part = self._data[self._at : self._at + count]
        self._at += count
        return part

    def unpack(self, code: str) -> Any:
        """Read one number of :mod:`struct` format ``code``."""
        return struct.unpack("<" + code, self.take(struct.calcsize(code)))[0]

    def byte_string(self) -> bytes | None:
        """Read a ByteString; length -1 is null."""
        length = self.unpack("i")
        return None if length == -1 else self.take(length)

    def string(self) -> str | None:
        """Read a String; bytes that are no UTF-8 are replaced."""
        data = self.byte_string()
        return None if data is None else data.decode("utf-8", "replace")

    def array(self, element: Callable[[], object]) -> list[Any] | None:
        """Read an array; length -1 is null."""
        count = self.unpack("i")
        if count == -1:
            return None
        # Every element has a byte at least: a larger count is wrong and must not cost memory.
        if not 0 <= count <= self.left:
            raise MalformedError(f"an array of {count} elements does not fit the message")
        return [element() for _ in range(count)]

    def node_id(self) -> str:
        """Read a NodeId (section 5.2.2.9) or an ExpandedNodeId (section 5.2.2.10), written as in section 5.3.1.10.

        Namespace 0 is left out, a namespace URI replaces the index, a server index is ignored. A library may write an ExpandedNodeId where
        a NodeId belongs, as asyncua does with a node that is named by its namespace URI, and servers do read it.
        """
        encoding = self.unpack("B")
        text = self._node_id(encoding & 0x3F)
        if encoding & 0x80:
            text = f"nsu={self.string()};{text.rpartition(';')[2]}"
        if encoding & 0x40:
            self.unpack("I")
        return text

    def _node_id(self, encoding: int) -> str:
        if encoding == 0:
            namespace, identifier = 0, f"i={self.unpack('B')}"
        elif encoding == 1:
            namespace, identifier = self.unpack("B"), f"i={self.unpack('H')}"
        elif encoding == 2:
            namespace, identifier = self.unpack("H"), f"i={self.unpack('I')}"
        elif encoding == 3:
            namespace, identifier = self.unpack("H"), f"s={self.string()}"
        elif encoding == 4:
            namespace, identifier = self.unpack("H"), f"g={self.guid()}"
        elif encoding == 5:
            namespace = self.unpack("H")
            identifier = f"b={base64.b64encode(self.byte_string() or b'').decode()}"
        else:
            raise MalformedError(f"{encoding:#04x} is no encoding of a NodeId")
        return f"ns={namespace};{identifier}" if namespace else identifier

    def guid(self) -> str:
        """Read a Guid (section 5.2.2.6)."""
        return str(uuid.UUID(bytes_le=self.take(16)))

    def date_time(self) -> str | None:
        """Read a DateTime (section 5.2.2.5): 100 ns since 1601; 0, and a time that Python cannot represent, is null."""
        ticks = self.unpack("q")
        try:
            return None if ticks <= 0 else (_EPOCH + timedelta(microseconds=ticks // 10)).isoformat()
        except OverflowError:
            return None

    def qualified_name(self) -> str:
        """Read a QualifiedName as ``2:Temperature``; namespace 0 is left out."""
        namespace, name = self.unpack("H"), self.string()
        return f"{namespace}:{name}" if namespace else str(name)

    def localized_text(self) -> str | None:
        """Read a LocalizedText: the text without its locale."""
        mask = self.unpack("B")
        if mask & 1:
            self.string()
        return self.string() if mask & 2 else None

    def extension_object(self) -> dict[str, Any]:
        """Read an ExtensionObject: the node id of its type, and its body, undecoded, as base64."""
        type_id, encoding = self.node_id(), self.unpack("B")
        body = self.byte_string() if encoding else None
        return {"type_id": type_id, "body": None if body is None else base64.b64encode(body).decode()}

    def diagnostic_info(self) -> None:
        """Skip a DiagnosticInfo (section 5.2.2.12)."""
        mask = self.unpack("B")
        for bit in (1, 2, 8, 4):
            if mask & bit:
                self.unpack("i")
        if mask & 16:
            self.string()
        if mask & 32:
            self.unpack("I")
        if mask & 64:
            self._nested(self.diagnostic_info)

    def data_value(self) -> dict[str, Any]:
        """Read a DataValue (section 5.2.2.17): ``value``, ``variant_type``, ``status`` (symbol), ``has_status`` and
        ``has_timestamp``."""
        mask = self.unpack("B")
        variant_type, value = self.variant() if mask & 1 else (None, None)
        status = self.unpack("I") if mask & 2 else 0
        for bit, code in ((4, "q"), (16, "H"), (8, "q"), (32, "H")):
            if mask & bit:
                self.unpack(code)
        return {
            "value": value,
            "variant_type": variant_type,
            "status": symbol(status),
            # A Good that is written out means the same as one that is left out.
            "has_status": status != 0,
            "has_timestamp": bool(mask & 12),
        }

    def variant(self) -> tuple[str, Any]:
        """Read a Variant (section 5.2.2.16): the name of its type, and its value; a matrix is a list of lists."""
        mask = self.unpack("B")
        number = mask & 0x3F
        if number >= len(VARIANT_TYPES):
            raise MalformedError(f"there is no built-in type {number}")
        if mask & 0x80:
            value = self.array(lambda: self._nested(lambda: self._scalar(number)))
            if mask & 0x40:
                value = _shaped(value, self.array(lambda: self.unpack("i")) or [])
        else:
            value = self._nested(lambda: self._scalar(number))
        return VARIANT_TYPES[number], value

    def _nested(self, read: Callable[[], object]) -> Any:
        # Section 5.1.5: a decoder need not accept more than 100 levels; no message of a plant needs more than these.
        if self._depth >= _DEEPEST:
            raise MalformedError("the message is nested too deeply")
        self._depth += 1
        try:
            return read()
        finally:
            self._depth -= 1

    def _scalar(self, number: int) -> Any:
        if number in _NUMBERS:
            value = self.unpack(_NUMBERS[number])
            return _finite(value) if isinstance(value, float) else value
        readers: dict[int, Callable[[], object]] = {
            0: lambda: None,
            1: lambda: self.unpack("B") != 0,
            12: self.string,
            13: self.date_time,
            14: self.guid,
            16: self.string,
            17: self.node_id,
            18: self.node_id,
            19: lambda: symbol(self.unpack("I")),
            20: self.qualified_name,
            21: self.localized_text,
            22: self.extension_object,
            23: self.data_value,
            24: lambda: self.variant()[1],
            25: self.diagnostic_info,
        }
        if number == 15:
            data = self.byte_string()
            return None if data is None else base64.b64encode(data).decode()
        return readers[number]()


def _shaped(values: list[Any] | None, lengths: list[int]) -> list[Any] | None:
    """Return a flat list as a matrix with dimensions of these lengths; as it is where it is none."""
    if values is None or math.prod(lengths) != len(values):
        return values
    for length in reversed(lengths[1:]):
        values = [values[at : at + length] for at in range(0, len(values), length)] if length else []
    return values


def _finite(value: float) -> float | str:
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
