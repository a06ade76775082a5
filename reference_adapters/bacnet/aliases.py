"""The alias map: names for properties of objects.

A JSON object of aliases, for instance::

    {"zone": {"device_id": 12345, "object_type": "analog-input", "object_instance": 1, "unit": "degF"}}

An alias can be written where it says so; ``priority`` is that of its writes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from ..core import ConfigError
from .shapes import MINIMUM_ON_OFF, ObjectTypeName

__all__ = ["Alias", "load_aliases"]


class Alias(BaseModel):
    """One named property."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    device_id: int = Field(ge=0, le=4194302)
    object_type: ObjectTypeName
    object_instance: int = Field(ge=0, le=4194302)
    property_id: str = "present-value"
    unit: str | None = None
    writable: bool = False
    priority: int | None = Field(default=None, ge=1, le=16)

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.priority == MINIMUM_ON_OFF:
            raise ValueError("priority 6 is reserved for minimum on and off times")
        return self


def load_aliases(path: str | None) -> dict[str, Alias]:
    """Read the alias map; without a path there are no aliases.

    Raises:
        ConfigError: the file cannot be read or is not an alias map.
    """
    if path is None:
        return {}
    try:
        return TypeAdapter(dict[str, Alias]).validate_json(Path(path).read_bytes())
    except OSError as error:
        raise ConfigError(f"BACNET_ALIAS_MAP: {path} cannot be read: {error.strerror}") from None
    except ValidationError as error:
        fault = error.errors(include_url=False, include_input=False)[0]
        place = "/".join(map(str, fault["loc"]))
        raise ConfigError(f"BACNET_ALIAS_MAP: {path}: {place or 'the file'}: {fault['msg']}") from None
