"""The tag map: names for variables of the controller.

A JSON object of tags, for instance::

    {"valve": {"area": "DB", "db": 10, "start": 0, "type": "INT", "unit": "%", "writable": true}}
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from ..core import Named
from .codec import DataType

__all__ = ["Tag"]


class Tag(Named):
    """One named variable."""

    area: Literal["DB", "I", "Q", "M"] = "DB"
    db: int = Field(default=0, ge=0, le=65535)
    start: int = Field(ge=0, le=65535)
    bit: int = Field(default=0, ge=0, le=7)
    type: DataType

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if (self.area == "DB") != (self.db > 0):
            raise ValueError("db is the number of a data block, from 1, and belongs to the area DB alone")
        if self.bit and self.type != "BOOL":
            raise ValueError("only a BOOL has a bit")
        if self.writable and self.area == "I":
            raise ValueError("inputs are not written")
        return self
