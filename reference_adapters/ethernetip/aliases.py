"""The alias map: names for tags of the controller.

A JSON object of aliases, for instance::

    {"valve": {"tag": "ValvePosition", "unit": "%", "writable": true}}

The type is the controller's. An alias can be written where it says so.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from .shapes import TagName

__all__ = ["Alias"]


class Alias(BaseModel):
    """One named tag."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    tag: TagName
    unit: str | None = None
    writable: bool = False
