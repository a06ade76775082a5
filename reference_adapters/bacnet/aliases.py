"""The alias map: names for properties of objects.

A JSON object of aliases, for instance::

    {"zone": {"device_id": 12345, "object_type": "analog-input", "object_instance": 1, "unit": "degF"}}

An alias can be written where it says so; ``priority`` is that of its writes.
"""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from ..core import Named
from .shapes import MINIMUM_ON_OFF, ObjectTypeName

__all__ = ["Alias"]


class Alias(Named):
    """One named property."""

    device_id: int = Field(ge=0, le=4194302)
    object_type: ObjectTypeName
    object_instance: int = Field(ge=0, le=4194302)
    property_id: str = "present-value"
    priority: int | None = Field(default=None, ge=1, le=16)

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.priority == MINIMUM_ON_OFF:
            raise ValueError("priority 6 is reserved for minimum on and off times")
        return self
