"""The tags that a launch of an adapter with a tag map configures, so that requirement checks know what lies behind each. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["TAGS", "Tag"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tag:
    """A named value. Its engineering value is ``raw * scale + offset``.

    Attributes:
        table: of an image.
        address: of its first register, from 0 as in the PDU.
        type: ``int16``, ``uint16``, ``int32``, ``uint32``, ``int64``, ``uint64``, ``float32`` or ``float64``.
        order: ``ABCD`` is big-endian; ``CDAB`` has the words swapped, ``BADC`` the bytes of each word, ``DCBA`` both.
        writable: it may be written.
    """

    table: str = "holding_registers"
    address: int
    type: str
    order: str = "ABCD"
    scale: float = 1.0
    offset: float = 0.0
    writable: bool = True


TAGS: Mapping[str, Tag] = {
    "otmcp_scaled": Tag(address=80, type="int16", scale=0.1),
    "otmcp_shifted": Tag(address=81, type="uint16", scale=0.5, offset=-40.0),
    "otmcp_float": Tag(address=82, type="float32"),
    "otmcp_swapped": Tag(address=84, type="int32", order="CDAB"),
    "otmcp_locked": Tag(address=86, type="uint16", writable=False),
    "otmcp_sensor": Tag(table="input_registers", address=80, type="int16", scale=0.1, writable=False),
}
"""The tags by name; ``docs/subject-file.md`` lists them."""
