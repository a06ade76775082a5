"""The tags of the controller: their memory, and the place within it that a path names. It handles bytes only."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from pytest_otmcp.wire.ethernetip.messages import BAD_PATH, Refusal

from .types import STRING, Elementary, Structure

__all__ = ["ACCESS", "NO_SUCH_PLACE", "PRIVILEGE", "Place", "Tag", "located", "shown", "store", "walk"]

NO_SUCH_PLACE, PRIVILEGE = 0x05, 0x0F
ACCESS = {"read_write": 0, "read_only": 2, "none": 3}
"""External access to the number that the symbol's attribute 10 has for it."""


@dataclass(slots=True, kw_only=True)
class Tag:
    """A tag.

    Attributes:
        name: without the program.
        instance: of its symbol object, unique in its scope.
        dimension: number of elements of an array, 0 for none.
        access: key of :data:`ACCESS`.
        program: name of the program that it belongs to; None for the controller.
    """

    name: str
    instance: int
    kind: Elementary | Structure
    dimension: int = 0
    access: str = "read_write"
    program: str | None = None
    memory: bytearray = field(default_factory=bytearray)

    def __post_init__(self) -> None:
        self.memory = bytearray(self.kind.size * (self.dimension or 1))

    @property
    def label(self) -> str:
        """Name with the program, as Logix writes it."""
        return self.name if self.program is None else f"Program:{self.program}.{self.name}"

    @property
    def symbol_type(self) -> int:
        """The type as the symbol's attribute 2 has it; bit 13 stands for one dimension."""
        return self.kind.symbol_type | (0x2000 if self.dimension else 0)

    def whole(self) -> Place:
        """Return the place of the tag from its first element on."""
        return Place(tag=self, kind=self.kind, offset=0, count=self.dimension or 1, array=bool(self.dimension))


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Elements of one type in the memory of a tag.

    Attributes:
        offset: of the first byte.
        count: number of elements from there on.
        array: the path may go on with an index.
        bit: number of the bit that a BOOL member is; None for other places.
    """

    tag: Tag
    kind: Elementary | Structure
    offset: int
    count: int = 1
    array: bool = False
    bit: int | None = None

    def read(self, count: int) -> bytes:
        """Return the bytes of so many elements."""
        if self.bit is not None:
            return b"\xff" if self.tag.memory[self.offset] >> self.bit & 1 else b"\0"
        return bytes(self.tag.memory[self.offset : self.offset + count * self.kind.size])

    def write(self, content: bytes, start: int = 0) -> None:
        """Store bytes, from byte ``start`` of the place on."""
        if self.bit is not None:
            mask = 1 << self.bit
            held = self.tag.memory[self.offset]
            self.tag.memory[self.offset] = held | mask if any(content) else held & ~mask & 0xFF
            return
        if self.kind.name == "BOOL":
            # A BOOL is 0 or 255 in the controller, whatever else stands for true in a request.
            content = bytes(0xFF if byte else 0 for byte in content)
        self.tag.memory[self.offset + start : self.offset + start + len(content)] = content


def located(tag: Tag, steps: Sequence[str | int]) -> Place:
    """Return the place that names of members and indexes lead to.

    Raises:
        Refusal: there is none.
    """
    place = tag.whole()
    for step in steps:
        place = _element(place, step) if isinstance(step, int) else _member(place, step)
    return place


def _element(place: Place, index: int) -> Place:
    if not place.array:
        raise Refusal(BAD_PATH, 0)
    if index >= place.count:
        raise Refusal(NO_SUCH_PLACE, 0)
    offset = place.offset + index * place.kind.size
    return Place(tag=place.tag, kind=place.kind, offset=offset, count=place.count - index)


def _member(place: Place, name: str) -> Place:
    if not isinstance(place.kind, Structure) or place.array:
        raise Refusal(BAD_PATH, 0)
    member = place.kind.member(name)
    if member is None:
        raise Refusal(NO_SUCH_PLACE, 0)
    return Place(
        tag=place.tag,
        kind=member.kind,
        offset=place.offset + member.offset,
        count=member.count or 1,
        array=bool(member.count),
        bit=member.bit,
    )


def walk(place: Place, name: str) -> Iterator[tuple[str, Place]]:
    """Yield each value at a place under its name: elements and members; a STRING is one value."""
    if place.array:
        for index in range(place.count):
            yield from walk(_element(place, index), f"{name}[{index}]")
    elif isinstance(place.kind, Structure) and place.kind is not STRING:
        for member in place.kind.members:
            yield from walk(_member(place, member.name), f"{name}.{member.name}")
    else:
        yield name, place


def shown(place: Place) -> Any:
    """Return the value at a place, as JSON has it."""
    content = place.read(1)
    if isinstance(place.kind, Structure):
        (length,) = struct.unpack_from("<i", content)
        return content[4 : 4 + max(0, min(length, 82))].decode("latin-1")
    return place.kind.decode(content)


def store(place: Place, value: Any) -> None:
    """Set the value at a place, as JSON has it.

    Raises:
        ValueError: the type cannot hold it.
    """
    if isinstance(place.kind, Elementary):
        place.write(place.kind.encode(value))
        return
    text = value.encode("latin-1", "replace") if isinstance(value, str) else None
    if place.kind is not STRING or text is None or len(text) > 82:
        raise ValueError(f"{place.kind.name} cannot hold {value!r}")
    place.write((struct.pack("<i", len(text)) + text).ljust(STRING.size, b"\0"))
