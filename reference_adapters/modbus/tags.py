"""The tag map: names for registers, with type, scale and unit.

A JSON object of tags, for instance::

    {"boiler_temperature": {"table": "input", "address": 0, "type": "int16", "scale": 0.1, "unit": "degC"}}

The engineering value is ``raw * scale + offset``. A write is rounded to the nearest raw value, halves away from zero,
and refused when that does not fit the type.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ..core import ConfigError
from .codec import DataType, Order

__all__ = ["Tag", "load_tags", "nearest_raw"]


class Tag(BaseModel):
    """One named value."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    table: Literal["holding", "input"] = "holding"
    address: int = Field(ge=0, le=65535)
    type: DataType = "uint16"
    order: Order = "ABCD"
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    writable: bool = False


def load_tags(path: str | None) -> dict[str, Tag]:
    """Read the tag map; no path is no tags.

    Raises:
        ConfigError: the file cannot be read or is not a tag map.
    """
    if path is None:
        return {}
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        return TypeAdapter(dict[str, Tag]).validate_python(document)
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ConfigError(f"MODBUS_TAG_MAP: the file cannot be read: {error}") from None
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        where = ".".join(map(str, fault["loc"]))
        raise ConfigError(f"MODBUS_TAG_MAP: {where}: {fault['msg']}") from None


def nearest_raw(tag: Tag, value: float) -> float:
    """The raw value of an engineering value; whole for integer types."""
    raw = (value - tag.offset) / tag.scale
    if tag.type in ("float32", "float64"):
        return raw
    # 25.3 / 0.1 is 252.99999999999997: the noise of the division must not decide between two registers.
    cleaned = round(raw, 9)
    return math.copysign(math.floor(abs(cleaned) + 0.5), cleaned)
