"""The tag map: names for registers, with type, scale and unit.

A JSON object of tags, for instance::

    {"boiler_temperature": {"table": "input", "address": 0, "type": "int16", "scale": 0.1, "unit": "degC"}}

The engineering value is ``raw * scale + offset``, computed in decimal: 253 * 0.1 is 25.3 and not 25.300000000000001. A
write is rounded to the nearest raw value, halves away from zero, and refused when that does not fit the type. Without
scale and offset nothing is rounded: 40.7 is refused as the value of a register.
"""

from __future__ import annotations

from decimal import ROUND_HALF_UP, Decimal
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from ..core import EXACT_IN_JSON, AdapterError, Named
from .codec import DataType, Order, width

__all__ = ["Tag", "engineering_value", "raw_value"]


class Tag(Named):
    """One named value."""

    table: Literal["holding", "input"] = "holding"
    address: int = Field(ge=0, le=65535)
    type: DataType = "uint16"
    order: Order = "ABCD"
    scale: float = 1.0
    offset: float = 0.0

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.scale == 0:
            raise ValueError("a scale of 0 maps every raw value to the same engineering value")
        if self.address + width(self.type) > 65536:
            raise ValueError("the value runs past register 65535")
        if self.writable and self.table == "input":
            raise ValueError("input registers cannot be written")
        return self

    @property
    def scaled(self) -> bool:
        """Whether engineering and raw value differ."""
        return (self.scale, self.offset) != (1.0, 0.0)

    @property
    def whole(self) -> bool:
        """Whether the raw value is an integer."""
        return not self.type.startswith("float")


def engineering_value(tag: Tag, raw: Any) -> Any:
    """Return the engineering value of a decoded raw value; null and decimal strings as in :func:`codec.decode`."""
    if raw is None or not tag.scaled:
        return raw
    value = Decimal(str(raw)) * Decimal(str(tag.scale)) + Decimal(str(tag.offset))
    return float(value) if abs(value) <= EXACT_IN_JSON else str(value)


def raw_value(tag: Tag, value: float) -> float:
    """Return the raw value nearest to an engineering value; an int for integer types.

    Raises:
        AdapterError: ``type_mismatch``, a fraction for a register that only holds whole numbers.
    """
    raw = Decimal(str(value))
    if tag.scaled:
        raw = (raw - Decimal(str(tag.offset))) / Decimal(str(tag.scale))
    if not tag.whole:
        return float(raw)
    if not tag.scaled and raw != raw.to_integral_value():
        raise AdapterError("type_mismatch", f"{tag.type} holds whole numbers only", field="/value")
    return int(raw.to_integral_value(ROUND_HALF_UP))
