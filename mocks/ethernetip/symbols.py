"""The lists by which a client learns tags and structures: symbol objects (class 6B) and templates (class 6C)."""

from __future__ import annotations

import struct

from pytest_otmcp.wire.ethernetip.messages import SUCCESS, TOO_LITTLE_DATA, Path, Refusal

from .plant import PROGRAM, Plant
from .tags import ACCESS, Tag
from .types import Structure

__all__ = ["symbol_list", "template_attributes", "template_part"]

_PARTIAL = 0x06
_ATTRIBUTE_ERROR, _NO_SUCH_ATTRIBUTE = 0x0A, 0x14
_PROGRAM_SYMBOL = 0x1068
"""Type of the symbol that stands for a program; bit 12 marks what belongs to the system."""
_BASE_TAG = 1 << 26
"""Bit of the software control: the tag is no alias."""


def symbol_list(plant: Plant, path: Path, data: bytes, most: int) -> tuple[bytes, int]:
    """Return the attributes of symbols from an instance on, as far as they fit, and the status.

    Args:
        most: bytes that the answer's data can have.

    Raises:
        Refusal: there is no such program, or a symbol has no such attribute.
    """
    program = plant.program(path.names[0]) if path.names else None
    if len(data) < 2 or len(data) != 2 + 2 * int.from_bytes(data[:2], "little"):
        raise Refusal(TOO_LITTLE_DATA)
    numbers = struct.unpack_from(f"<{len(data) // 2 - 1}H", data, 2)
    rows = [(tag.instance, _tag_attributes(tag)) for tag in plant.listed(program)]
    if program is None:
        rows.append((plant.program_instance, _program_attributes()))
    found = b""
    for instance, attributes in sorted(rows):
        if instance < (path.instance or 0):
            continue
        if any(number not in attributes for number in numbers):
            raise Refusal(_ATTRIBUTE_ERROR)
        row = struct.pack("<I", instance) + b"".join(attributes[number] for number in numbers)
        if len(found) + len(row) > most:
            return found, _PARTIAL
        found += row
    return found, SUCCESS


def _row(name: str, kind: int, size: int, dimension: int, access: int) -> dict[int, bytes]:
    """Return attributes of a symbol: name, type, address, object address, software control, size, dimensions, external access."""
    text = name.encode("latin-1")
    return {
        1: struct.pack("<H", len(text)) + text,
        2: struct.pack("<H", kind),
        3: struct.pack("<I", 0),
        5: struct.pack("<I", 0),
        6: struct.pack("<I", _BASE_TAG),
        7: struct.pack("<H", size),
        8: struct.pack("<III", dimension, 0, 0),
        10: bytes([access]),
    }


def _tag_attributes(tag: Tag) -> dict[int, bytes]:
    return _row(tag.name, tag.symbol_type, tag.kind.size, tag.dimension, ACCESS[tag.access])


def _program_attributes() -> dict[int, bytes]:
    return _row(f"Program:{PROGRAM}", _PROGRAM_SYMBOL, 0, 0, 0)


def template_attributes(structure: Structure, data: bytes) -> tuple[bytes, int]:
    """Return attributes of a template: 1 handle, 2 number of members, 4 size of its definition in words, 5 size in bytes.

    Raises:
        Refusal: the list of attributes is none.
    """
    if len(data) < 2 or len(data) != 2 + 2 * int.from_bytes(data[:2], "little"):
        raise Refusal(TOO_LITTLE_DATA)
    known = {
        1: struct.pack("<H", structure.handle),
        2: struct.pack("<H", len(structure.members) + len(structure.hidden)),
        # Undocumented; pylogix asks for it and takes two bytes.
        3: struct.pack("<H", 0),
        4: struct.pack("<I", structure.words()),
        5: struct.pack("<I", structure.size),
    }
    numbers = struct.unpack_from(f"<{len(data) // 2 - 1}H", data, 2)
    found = struct.pack("<H", len(numbers))
    for number in numbers:
        content = known.get(number)
        status = SUCCESS if content is not None else _NO_SUCH_ATTRIBUTE
        found += struct.pack("<HH", number, status) + (content or b"")
    return found, SUCCESS if all(number in known for number in numbers) else _ATTRIBUTE_ERROR


def template_part(structure: Structure, data: bytes, most: int) -> tuple[bytes, int]:
    """Return a part of a template's definition, and the status.

    Raises:
        Refusal: the request does not say which part.
    """
    if len(data) != 6:
        raise Refusal(TOO_LITTLE_DATA)
    start, wanted = struct.unpack("<IH", data)
    # Clients ask for as many bytes as the size in words makes, which is more than there are.
    definition = structure.definition().ljust(structure.words() * 4 - 20, b"\0")
    part = definition[start : start + wanted]
    return (part[:most], _PARTIAL) if len(part) > most else (part, SUCCESS)
