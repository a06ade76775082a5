"""The device map and the alias map.

The device map says which devices there are, and which modules they have, as their GSDML files and the planning of the plant have it: a JSON
object of names of stations, for instance::

    {"press-4": {"vendor_id": "0ABC", "device_id": "0001", "modules": [
        {"slot": 0, "module": "00000001", "submodule": "00000001"},
        {"slot": 1, "module": "00000010", "submodule": "00000001", "inputs": 8}]}}

The alias map names values in their inputs, outputs and records; numbers are big-endian::

    {"valve": {"device_name": "press-4", "slot": 2, "area": "outputs", "offset": 0, "data_type": "UINT16", "unit": "%"}}

The value of a record is the whole record.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from ..core import ConfigError, Environment, Named
from ..core.process_data import DataType, width

__all__ = ["Alias", "DeviceEntry", "load_aliases", "load_devices"]

_DEVICE_MAP, _ALIAS_MAP = "PROFINET_DEVICE_MAP", "PROFINET_ALIAS_MAP"


def _number(text: object) -> object:
    return int(text, 16) if isinstance(text, str) else text


_Identifier = Annotated[int, BeforeValidator(_number), Field(ge=0, le=0xFFFFFFFF)]
_Slot = Annotated[int, Field(ge=0, le=0x7FFF)]
_Subslot = Annotated[int, Field(ge=1, le=0x8FFF)]


class ModuleEntry(BaseModel):
    """What is in one subslot: identifiers of its module and submodule, and the bytes of its inputs and outputs."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    slot: _Slot
    module: _Identifier
    subslot: _Subslot = 1
    submodule: _Identifier
    inputs: int = Field(default=0, ge=0, le=1024)
    outputs: int = Field(default=0, ge=0, le=1024)


class DeviceEntry(BaseModel):
    """One device of the device map."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    vendor_id: _Identifier
    device_id: _Identifier
    modules: list[ModuleEntry]

    @property
    def subslots(self) -> dict[tuple[int, int], ModuleEntry]:
        """What is in each subslot, by slot and subslot."""
        return {(one.slot, one.subslot): one for one in self.modules}


class Alias(Named):
    """One named value."""

    device_name: str
    slot: _Slot
    subslot: _Subslot = 1
    area: Literal["inputs", "outputs", "record"]
    index: int = Field(default=0, ge=0, le=0xFFFF)
    offset: int = Field(default=0, ge=0, le=1023)
    data_type: DataType

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.writable and self.area == "inputs":
            raise ValueError("inputs are not written")
        if self.area == "record" and self.offset:
            raise ValueError("a value of a record is the whole record")
        return self

    @property
    def end(self) -> int:
        """Offset of the first byte after it."""
        return self.offset + width(self.data_type)


def load_devices(environment: Environment) -> dict[str, DeviceEntry]:
    """Read the device map; without one no outputs can be written.

    Raises:
        ConfigError: the file cannot be read or is not a device map.
    """
    return environment.entries(_DEVICE_MAP, DeviceEntry)


def load_aliases(environment: Environment, devices: dict[str, DeviceEntry]) -> dict[str, Alias]:
    """Read the alias map; without one there are no aliases.

    Raises:
        ConfigError: the file cannot be read or is not an alias map, or an alias has a place that its device does not have.
    """
    aliases = environment.entries(_ALIAS_MAP, Alias)
    for name, alias in aliases.items():
        if alias.area == "record":
            continue
        device = devices.get(alias.device_name)
        held = None if device is None else device.subslots.get((alias.slot, alias.subslot))
        if held is None:
            raise ConfigError(f"{_ALIAS_MAP}: {name}: the device map has no such device with such a subslot")
        if alias.end > (held.inputs if alias.area == "inputs" else held.outputs):
            raise ConfigError(f"{_ALIAS_MAP}: {name}: it ends after the {alias.area} of its subslot")
    return aliases
