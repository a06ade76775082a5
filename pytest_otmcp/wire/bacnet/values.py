"""Application data: the thirteen primitive datatypes and their tags (ASHRAE 135, clause 20.2).

A value is encoded with an application tag, which names its datatype, or inside of a context tag, which does not.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..framing import MalformedError

__all__ = ["KINDS", "Tag", "Tags", "Value", "context", "enclosed", "encode", "value_of"]

KINDS = (
    "null",
    "boolean",
    "unsigned",
    "integer",
    "real",
    "double",
    "octet-string",
    "character-string",
    "bit-string",
    "enumerated",
    "date",
    "time",
    "object-identifier",
)
"""Datatypes by the number of their application tag."""

_OPENING, _CLOSING = 6, 7
_FIXED = {"real": 4, "double": 8, "date": 4, "time": 4, "object-identifier": 4}
_UTF_8, _UTF_16, _ISO_8859_1 = 0, 4, 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """One primitive value, JSON-safe.

    Attributes:
        kind: its datatype, one of :data:`KINDS`.
        value: None, a bool, a number, or a text. Octets, dates and times are hexadecimal digits, bits are ``0`` and ``1``, an object
            identifier is a list of type and instance. A number that JSON does not have is a text such as ``nan``.
    """

    kind: str
    value: Any

    def shown(self) -> dict[str, Any]:
        """Return the value for journal entries and images."""
        return {"type": self.kind, "value": self.value}


@dataclass(frozen=True, slots=True, kw_only=True)
class Tag:
    """A tag and its content. The content of an application tagged boolean is in the tag: it is one byte here."""

    number: int
    is_context: bool
    is_opening: bool = False
    is_closing: bool = False
    content: bytes = b""


class Tags:
    """A reader of tags, one after the other.

    Raises:
        MalformedError: by every method, where the bytes end too early.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def at_end(self) -> bool:
        """Tell whether no tag is left."""
        return self._at == len(self._data)

    def _take(self, count: int) -> bytes:
        taken = self._data[self._at : self._at + count]
        if len(taken) < count:
            raise MalformedError("the data end inside a tag")
        self._at += count
        return taken

    def next(self) -> Tag:
        """Return the next tag."""
        (first,) = self._take(1)
        number, is_context, length = first >> 4, bool(first & 8), first & 7
        if number == 15:
            (number,) = self._take(1)
        if is_context and length in (_OPENING, _CLOSING):
            return Tag(number=number, is_context=True, is_opening=length == _OPENING, is_closing=length == _CLOSING)
        if not is_context and number == KINDS.index("boolean"):
            return Tag(number=number, is_context=False, content=bytes([length]))
        if length > 5:
            raise MalformedError("an application tag opens or closes nothing")
        if length == 5:
            (length,) = self._take(1)
            if length == 254:
                length = int.from_bytes(self._take(2))
            elif length == 255:
                length = int.from_bytes(self._take(4))
        return Tag(number=number, is_context=is_context, content=self._take(length))

    def peek(self) -> Tag | None:
        """Return the next tag without passing it; None at the end."""
        if self.at_end:
            return None
        at = self._at
        try:
            return self.next()
        finally:
            self._at = at

    def is_next(self, number: int, *, opening: bool = False) -> bool:
        """Tell whether the next tag is this context tag."""
        tag = self.peek()
        return (
            tag is not None
            and tag.is_context
            and not tag.is_closing
            and (tag.number, tag.is_opening) == (number, opening)
        )

    def inside(self, number: int) -> Iterator[Tag]:
        """Return the tags behind this opening tag, up to its closing tag, which is passed as well."""
        depth = 0
        while True:
            tag = self.next()
            if tag.is_closing and not depth:
                if tag.number != number:
                    raise MalformedError(f"tag {number} is closed by {tag.number}")
                return
            depth += tag.is_opening - tag.is_closing
            yield tag

    def construction(self) -> bytes:
        """Return the bytes of the next tag, or of everything from this opening tag to its closing tag, and pass them."""
        start, depth = self._at, 0
        while True:
            tag = self.next()
            depth += tag.is_opening - tag.is_closing
            if depth < 0:
                raise MalformedError("a tag is closed that was not opened")
            if not depth:
                return self._data[start : self._at]


def value_of(kind: str, content: bytes) -> Value:
    """Return the value of this datatype that these bytes are.

    Raises:
        MalformedError: they are none.
    """
    if kind in _FIXED and len(content) != _FIXED[kind]:
        raise MalformedError(f"{kind} has {_FIXED[kind]} bytes, not {len(content)}")
    return Value(kind=kind, value=_read(kind, content))


def _read(kind: str, content: bytes) -> Any:
    match kind:
        case "null" if not content:
            return None
        case "boolean" if content in (b"\0", b"\1"):
            return content == b"\1"
        case "unsigned" | "enumerated" if content:
            return int.from_bytes(content)
        case "integer" if content:
            return int.from_bytes(content, signed=True)
        case "real" | "double":
            (number,) = struct.unpack(">f" if kind == "real" else ">d", content)
            return number if number - number == 0 else str(number)
        case "octet-string" | "date" | "time":
            return content.hex()
        case "character-string" if content:
            return _text(content[0], content[1:])
        case "bit-string" if content and content[0] <= 7 and (len(content) > 1 or not content[0]):
            bits = "".join(f"{byte:08b}" for byte in content[1:])
            return bits[: len(bits) - content[0]]
        case "object-identifier":
            number = int.from_bytes(content)
            return [number >> 22, number & 0x3FFFFF]
    raise MalformedError(f"{content.hex() or 'nothing'} is no {kind}")


def _text(encoding: int, data: bytes) -> str:
    names = {_UTF_8: "utf-8", _UTF_16: "utf-16-be", _ISO_8859_1: "iso-8859-1"}
    try:
        return data.decode(names[encoding])
    except (KeyError, UnicodeDecodeError):
        raise MalformedError(f"a character string in encoding {encoding} cannot be read") from None


def _content(value: Value) -> bytes:
    held = value.value
    match value.kind:
        case "null":
            return b""
        case "boolean":
            return bytes([held])
        case "unsigned" | "enumerated":
            return int(held).to_bytes(max(1, (held.bit_length() + 7) // 8))
        case "integer":
            # As few octets as the sign allows (clause 20.2.5).
            return int(held).to_bytes((held if held >= 0 else ~held).bit_length() // 8 + 1, signed=True)
        case "real":
            return struct.pack(">f", float(held))
        case "double":
            return struct.pack(">d", float(held))
        case "character-string":
            return bytes([_UTF_8]) + str(held).encode()
        case "bit-string":
            padding = -len(held) % 8
            bits = held + "0" * padding
            return bytes([padding]) + bytes(int(bits[at : at + 8], 2) for at in range(0, len(bits), 8))
        case "object-identifier":
            return int(held[0] << 22 | held[1]).to_bytes(4)
    return bytes.fromhex(held)


def _head(number: int, *, is_context: bool, length: int) -> bytes:
    first, extended = (number << 4, b"") if number < 15 else (0xF0, bytes([number]))
    first |= 8 if is_context else 0
    if length < 5:
        return bytes([first | length]) + extended
    if length < 254:
        return bytes([first | 5]) + extended + bytes([length])
    return bytes([first | 5]) + extended + b"\xfe" + length.to_bytes(2)


def encode(value: Value) -> bytes:
    """Return a value with its application tag."""
    number, content = KINDS.index(value.kind), _content(value)
    if value.kind == "boolean":
        return bytes([number << 4 | content[0]])
    return _head(number, is_context=False, length=len(content)) + content


def context(number: int, kind: str, held: Any) -> bytes:
    """Return a value inside of a context tag."""
    content = _content(Value(kind=kind, value=held))
    return _head(number, is_context=True, length=len(content)) + content


def enclosed(number: int, data: bytes) -> bytes:
    """Return data between an opening and a closing context tag."""
    return bytes([number << 4 | 8 | _OPENING]) + data + bytes([number << 4 | 8 | _CLOSING])
