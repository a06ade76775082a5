"""The alias map: names for tags of the controller.

A JSON object of aliases, for instance::

    {"valve": {"tag": "ValvePosition", "unit": "%", "writable": true}}

The type is the controller's. An alias can be written where it says so.
"""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from ..core import ConfigError
from .shapes import TagName

__all__ = ["Alias", "load_aliases"]


class Alias(BaseModel):
    """One named tag."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    tag: TagName
    unit: str | None = None
    writable: bool = False


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
        raise ConfigError(f"ETHERNETIP_ALIAS_MAP: {path} cannot be read: {error.strerror}") from None
    except ValidationError as error:
        fault = error.errors(include_url=False, include_input=False)[0]
        place = "/".join(map(str, fault["loc"]))
        raise ConfigError(f"ETHERNETIP_ALIAS_MAP: {path}: {place or 'the file'}: {fault['msg']}") from None
