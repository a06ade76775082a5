"""The tag map: names for variables of the controller.

A JSON object of tags, for instance::

    {"valve": {"area": "DB", "db": 10, "start": 0, "type": "INT", "unit": "%", "writable": true}}
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from ..core import ConfigError
from .codec import DataType

__all__ = ["Tag", "load_tags"]


class Tag(BaseModel):
    """One named variable."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    area: Literal["DB", "I", "Q", "M"] = "DB"
    db: int = Field(default=0, ge=0, le=65535)
    start: int = Field(ge=0, le=65535)
    bit: int = Field(default=0, ge=0, le=7)
    type: DataType
    unit: str | None = None
    writable: bool = False

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if (self.area == "DB") != (self.db > 0):
            raise ValueError("db is the number of a data block, from 1, and belongs to the area DB alone")
        if self.bit and self.type != "BOOL":
            raise ValueError("only a BOOL has a bit")
        if self.writable and self.area == "I":
            raise ValueError("inputs are not written")
        return self


def load_tags(path: str | None) -> dict[str, Tag]:
    """Read the tag map; without a path there are no tags.

    Raises:
        ConfigError: the file cannot be read or is not a tag map.
    """
    if path is None:
        return {}
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        return TypeAdapter(dict[str, Tag]).validate_python(document)
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ConfigError(f"S7_TAG_MAP: the file cannot be read: {error}") from None
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        where = ".".join(map(str, fault["loc"]))
        raise ConfigError(f"S7_TAG_MAP: {where}: {fault['msg']}") from None
