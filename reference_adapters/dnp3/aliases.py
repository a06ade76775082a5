"""The alias map: names for points.

A JSON object of aliases, for instance::

    {"level": {"outstation_address": 10, "point_type": "analog_input", "index": 1, "unit": "m"},
     "setpoint": {"outstation_address": 10, "point_type": "analog_output", "index": 0, "data_type": "float32", "writable": true}}

An alias can be written where it says so. ``data_type`` is the variation in which an analog output is commanded.
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from ..core import Named
from .commands import AnalogType
from .shapes import LAST_ADDRESS

__all__ = ["Alias", "PointType"]

PointType = Literal["binary_input", "binary_output", "counter", "analog_input", "analog_output", "octet_string"]
_WRITABLE = ("binary_output", "analog_output", "octet_string")


class Alias(Named):
    """One named point."""

    outstation_address: int = Field(ge=0, le=LAST_ADDRESS)
    point_type: PointType
    index: int = Field(ge=0, le=65535)
    data_type: AnalogType | None = None

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.writable and self.point_type not in _WRITABLE:
            raise ValueError(f"a point of the type {self.point_type} cannot be written")
        if self.data_type is not None and self.point_type != "analog_output":
            raise ValueError("only an analog output has a data type")
        if self.data_type is None and self.point_type == "analog_output" and self.writable:
            raise ValueError("an analog output that can be written needs a data type")
        return self
