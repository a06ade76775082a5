"""The alias map: names of objects, and of values in the inputs and outputs of slaves. Numbers are little-endian. For instance::

{
  "acceleration": {"slave_position": 1, "index": "0x2000", "subindex": 1, "data_type": "UINT16", "writable": true},
  "speed": {"slave_position": 1, "area": "outputs", "offset": 0, "data_type": "INT16", "unit": "rpm", "writable": true}
}
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from ..core import Environment, Named
from .codec import DataType, width

__all__ = ["Alias", "load_aliases", "number"]


def number(text: object) -> object:
    """Return the number that a text such as ``0x2000`` stands for; anything else as it is."""
    if isinstance(text, str) and text[:2].lower() == "0x" and 3 <= len(text) <= 6:
        try:
            return int(text, 16)
        except ValueError:
            return text
    return text


class Alias(Named):
    """One named value: an object, or a place in the process data."""

    slave_position: int = Field(ge=0, le=65535)
    data_type: DataType
    index: Annotated[int | None, BeforeValidator(number), Field(ge=0, le=0xFFFF)] = None
    subindex: int = Field(default=0, ge=0, le=255)
    area: Literal["inputs", "outputs"] | None = None
    offset: int = Field(default=0, ge=0, le=1485)

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if (self.index is None) == (self.area is None):
            raise ValueError("an alias has an index, or an area")
        if self.area is not None and self.data_type == "STRING":
            raise ValueError("process data have no texts")
        if self.writable and self.area == "inputs":
            raise ValueError("inputs are not written")
        return self

    @property
    def end(self) -> int:
        """Offset of the first byte after it."""
        return self.offset + width(self.data_type)


def load_aliases(environment: Environment) -> dict[str, Alias]:
    """Read the alias map; without one there are no aliases.

    Raises:
        ConfigError: the file cannot be read or is not an alias map.
    """
    return environment.entries("ETHERCAT_ALIAS_MAP", Alias)
