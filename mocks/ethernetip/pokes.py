"""What can be changed at the controller past the protocol.

====================  =====================================================================================================
``tag``               ``{"tag": "Levels[2]", "value": 12.5}`` sets a value by its name in the image; a bit is ``Flags.3``. A REAL or
                      LREAL may be ``"NaN"``, ``"Infinity"`` or ``"-Infinity"``
``external_access``   ``{"tag": "Locked", "external_access": "read_write"}``, or ``"read_only"``, or ``"none"``
``create``            ``{"create": "Speed"}``: a further DINT of the controller with this name, whatever characters it has
``connection_limit``  ``{"connection_limit": 4}``: so many CIP connections can be open
``connections``       ``{"connections": "forget"}``: the controller knows none of the open CIP connections any more
``restless``          ``{"restless": [{"tag": "Flags", "bits": 64}]}``: these bits turn just before each request is executed, so between
                      any two requests. The list takes the place of the one before; the image counts the ``changes``
====================  =====================================================================================================
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..fault_rules import TEXT, integer, one_of
from .plant import Plant
from .tags import ACCESS, Place, store
from .types import Elementary

__all__ = ["CONNECTION_LIMIT", "Restless", "checked", "poke", "restless_bits"]

_BIT = re.compile(r"(?P<tag>.+)\.(?P<bit>[0-9]{1,2})")
_ACCESS = one_of(*ACCESS)
CONNECTION_LIMIT = integer(0, 1000)


@dataclass(slots=True, kw_only=True)
class Restless:
    """Bits of a tag that turn by themselves, and how often they have."""

    tag: str
    bits: int
    changes: int = 0

    def move(self, plant: Plant) -> None:
        """Turn the bits once."""
        place = _place(plant, self.tag)
        held = int.from_bytes(place.read(1), "little") ^ self.bits
        place.write(held.to_bytes(place.kind.size, "little"))
        self.changes += 1


def poke(plant: Plant, params: Mapping[str, Any]) -> None:
    """Change a value, or who may access a tag.

    Raises:
        ValueError: no such tag or value.
        KeyError: a parameter is missing.
    """
    if "create" in params:
        plant.create(checked(TEXT, "create", params))
        return
    if "external_access" in params:
        tag = _place(plant, params["tag"]).tag
        tag.access = checked(_ACCESS, "external_access", params)
        return
    name, value = params["tag"], params["value"]
    bit = _BIT.fullmatch(name) if isinstance(name, str) else None
    if bit is None:
        store(_place(plant, name), value)
        return
    place, number = _place(plant, bit["tag"]), int(bit["bit"])
    if not isinstance(place.kind, Elementary) or place.kind.form in "fd" or number >= 8 * place.kind.size:
        raise ValueError(f"there is no bit {name!r}")
    if not isinstance(value, bool):
        raise ValueError(f"a bit cannot hold {value!r}")
    held = int.from_bytes(place.read(1), "little") & ~(1 << number) | value << number
    place.write(held.to_bytes(place.kind.size, "little"))


def restless_bits(plant: Plant, sources: Any) -> list[Restless]:
    """Return the bits that a poke wants to turn by themselves.

    Raises:
        ValueError: no such bits.
        KeyError: a member is missing.
    """
    if not isinstance(sources, list) or not all(isinstance(source, Mapping) for source in sources):
        raise ValueError(f"restless: expected a list of objects, found {sources!r}")
    found = []
    for source in sources:
        size = _place(plant, source["tag"]).kind.size
        found.append(Restless(tag=source["tag"], bits=checked(integer(1, 2 ** (8 * size) - 1), "bits", source)))
    return found


def checked(field: Any, name: str, params: Mapping[str, Any]) -> Any:
    """Return a parameter.

    Raises:
        ValueError: the field cannot have its value.
    """
    if not field.accepts(params[name]):
        raise ValueError(f"{name}: expected {field.expected}, found {params[name]!r}")
    return params[name]


def _place(plant: Plant, name: Any) -> Place:
    place = plant.place(name) if isinstance(name, str) else None
    if place is None:
        known = ", ".join(tag.label for tag in plant.tags)
        raise ValueError(f"there is no tag {name!r}; there are {known}")
    return place
