"""Reading of BACnet's tagged data (ASHRAE 135, clause 20.2), written from the standard's description alone. Pure."""

from __future__ import annotations

import struct
from dataclasses import dataclass

__all__ = ["NotTagged", "Reader", "Shown", "identifier"]

Shown = dict[str, object]
"""A value as journals have it: ``type`` and ``value``."""

_TYPES = (
    "null boolean unsigned integer real double octet-string character-string bit-string enumerated date time object-identifier"
).split()
_ENCODINGS = {0: "utf-8", 4: "utf-16-be", 5: "iso-8859-1"}


class NotTagged(Exception):
    """The bytes are no tagged data, or not those that were expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tag:
    number: int
    role: str
    start: int
    end: int
    boolean: bool = False


class Reader:
    """Tags from left to right; each method raises :class:`NotTagged` where the data are not as it expects."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    @property
    def done(self) -> bool:
        """Whether everything has been read."""
        return self._position >= len(self._data)

    def _at(self, position: int, count: int) -> bytes:
        if position + count > len(self._data):
            raise NotTagged
        return self._data[position : position + count]

    def _tag(self) -> _Tag:
        position = self._position
        octet = self._at(position, 1)[0]
        position += 1
        number, length = octet >> 4, octet & 0b111
        if number == 0b1111:
            number = self._at(position, 1)[0]
            position += 1
        if octet & 0b1000:
            if length >= 6:
                return _Tag(number=number, role="open" if length == 6 else "close", start=position, end=position)
            role = "context"
        elif number == 1:
            if length > 1:
                raise NotTagged
            return _Tag(number=1, role="application", start=position, end=position, boolean=bool(length))
        elif length >= 6:
            raise NotTagged
        else:
            role = "application"
        if length == 5:
            length = self._at(position, 1)[0]
            position += 1
            if length >= 254:
                size = 2 if length == 254 else 4
                length = int.from_bytes(self._at(position, size))
                position += size
        self._at(position, length)
        return _Tag(number=number, role=role, start=position, end=position + length)

    def _next(self) -> _Tag:
        tag = self._tag()
        self._position = tag.end
        return tag

    def sees(self, role: str, number: int) -> bool:
        """Tell whether the next tag has this role (``context``, ``open`` or ``close``) and number."""
        if self.done:
            return False
        tag = self._tag()
        return (tag.role, tag.number) == (role, number)

    def passes(self, role: str, number: int) -> None:
        """Go past the next tag, which has this role and number."""
        if not self.sees(role, number):
            raise NotTagged
        self._next()

    def unsigned(self, number: int) -> int:
        """Read a number in a context tag."""
        return int.from_bytes(self._content(number))

    def identifier(self, number: int) -> list[int]:
        """Read an object identifier, as type and instance, in a context tag."""
        return identifier(self._content(number))

    def text(self, number: int) -> str:
        """Read a character string in a context tag."""
        return _text(self._content(number))

    def _content(self, number: int) -> bytes:
        if not self.sees("context", number):
            raise NotTagged
        tag = self._next()
        if tag.end == tag.start:
            raise NotTagged
        return self._data[tag.start : tag.end]

    def values(self, number: int, *, constructed: bool = False) -> list[Shown]:
        """Read what stands between the opening and the closing tag of this number.

        Args:
            constructed: accept data that are no primitive values, each of which becomes one value of the type ``constructed``.
        """
        self.passes("open", number)
        found: list[Shown] = []
        while not self.sees("close", number):
            found.append(self.value() if self._tag().role == "application" else self._construction(constructed))
        self.passes("close", number)
        return found

    def _construction(self, accepted: bool) -> Shown:
        if not accepted:
            raise NotTagged
        start, depth = self._position, 0
        while True:
            tag = self._next()
            depth += (tag.role == "open") - (tag.role == "close")
            if depth < 0:
                raise NotTagged
            if not depth:
                return {"type": "constructed", "value": self._data[start : self._position].hex()}

    def value(self) -> Shown:
        """Read a primitive value in an application tag."""
        tag = self._next()
        if tag.role != "application" or tag.number >= len(_TYPES):
            raise NotTagged
        kind = _TYPES[tag.number]
        return {
            "type": kind,
            "value": tag.boolean if kind == "boolean" else _decoded(kind, self._data[tag.start : tag.end]),
        }


def identifier(content: bytes) -> list[int]:
    """Return type and instance of an object identifier."""
    if len(content) != 4:
        raise NotTagged
    (number,) = struct.unpack(">I", content)
    return [number >> 22, number & 0x3FFFFF]


def _text(content: bytes) -> str:
    try:
        return content[1:].decode(_ENCODINGS[content[0]])
    except (IndexError, KeyError, UnicodeDecodeError):
        raise NotTagged from None


def _decoded(kind: str, content: bytes) -> object:
    if kind == "null":
        if content:
            raise NotTagged
        return None
    if kind == "object-identifier":
        return identifier(content)
    if kind in ("date", "time"):
        if len(content) != 4:
            raise NotTagged
        return content.hex()
    if kind == "octet-string":
        return content.hex()
    if kind == "character-string":
        return _text(content)
    if not content:
        raise NotTagged
    if kind in ("real", "double"):
        layout = ">f" if kind == "real" else ">d"
        if struct.calcsize(layout) != len(content):
            raise NotTagged
        (number,) = struct.unpack(layout, content)
        # JSON has no number for what is not finite.
        return number if abs(number) < float("inf") else str(number)
    if kind == "bit-string":
        unused = content[0]
        if unused > 7 or (unused and len(content) == 1):
            raise NotTagged
        bits = "".join(f"{octet:08b}" for octet in content[1:])
        return bits[: len(bits) - unused]
    return int.from_bytes(content, signed=kind == "integer")
