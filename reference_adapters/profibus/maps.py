"""The slave map and the alias map.

The slave map says which slaves there are, and how they are parameterised and configured: a JSON object of addresses, for instance::

    {"5": {"ident": "809C", "cfg": "11 21", "user_prm": "00", "name": "valve terminal"}}

The alias map names values in their inputs and outputs; numbers are big-endian::

    {"valve": {"slave_address": 5, "area": "outputs", "offset": 0, "data_type": "UINT16", "unit": "%"}}
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from ..core import ConfigError, Environment, Named
from ..core.process_data import DataType, width

__all__ = ["Alias", "Slave", "load_aliases", "load_slaves"]

_SLAVE_MAP, _ALIAS_MAP = "PROFIBUS_SLAVE_MAP", "PROFIBUS_ALIAS_MAP"
_LAST_ADDRESS = 125
_MOST_CFG = 244
_MOST_USER_PRM = 237


def _bytes(text: object) -> object:
    return bytes.fromhex(text) if isinstance(text, str) else text


def _number(text: object) -> object:
    return int(text, 16) if isinstance(text, str) else text


class Slave(BaseModel):
    """One slave of the slave map.

    Attributes:
        ident: its ident number, which the manufacturer was given by PROFIBUS International.
        cfg: its configuration identifiers, in the order of its modules.
        user_prm: the parameters of the device's own.
        name: what people call it.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    ident: Annotated[int, BeforeValidator(_number), Field(ge=0, le=0xFFFF)]
    cfg: Annotated[bytes, BeforeValidator(_bytes), Field(min_length=1, max_length=_MOST_CFG)]
    user_prm: Annotated[bytes, BeforeValidator(_bytes), Field(max_length=_MOST_USER_PRM)] = b""
    name: str | None = None

    @model_validator(mode="after")
    def _is_understood(self) -> Self:
        _lengths(self.cfg)
        return self

    @property
    def input_length(self) -> int:
        """Bytes of inputs."""
        return _lengths(self.cfg)[0]

    @property
    def output_length(self) -> int:
        """Bytes of outputs."""
        return _lengths(self.cfg)[1]


def _lengths(cfg: bytes) -> tuple[int, int]:
    """Return the bytes of inputs and of outputs that configuration identifiers stand for (IEC 61158-6-3, Chk_Cfg).

    Raises:
        ValueError: a special identifier is cut off.
    """
    inputs = outputs = at = 0
    while at < len(cfg):
        identifier = cfg[at]
        kind = identifier >> 4 & 3
        at += 1
        if kind:
            # Bits 4 and 5: inputs, outputs; bit 6: words.
            size = ((identifier & 0x0F) + 1) * (2 if identifier & 0x40 else 1)
            inputs += size if kind & 1 else 0
            outputs += size if kind & 2 else 0
            continue
        # A special identifier: bits 6 and 7 say which length bytes follow, bits 0 to 3 how many bytes of the manufacturer.
        for present, is_input in ((identifier & 0x80, False), (identifier & 0x40, True)):
            if not present:
                continue
            if at >= len(cfg):
                raise ValueError("cfg: a special identifier is cut off")
            size = ((cfg[at] & 0x3F) + 1) * (2 if cfg[at] & 0x40 else 1)
            inputs, outputs = (inputs + size, outputs) if is_input else (inputs, outputs + size)
            at += 1
        at += identifier & 0x0F
    if at > len(cfg):
        raise ValueError("cfg: a special identifier is cut off")
    return inputs, outputs


class Alias(Named):
    """One named value."""

    slave_address: int = Field(ge=0, le=_LAST_ADDRESS)
    area: Literal["inputs", "outputs"]
    offset: int = Field(default=0, ge=0, le=243)
    data_type: DataType

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.writable and self.area == "inputs":
            raise ValueError("inputs are not written")
        return self

    @property
    def end(self) -> int:
        """Offset of the first byte after it."""
        return self.offset + width(self.data_type)


def load_slaves(environment: Environment) -> dict[int, Slave]:
    """Read the slave map; without one there are no slaves that could be written to.

    Raises:
        ConfigError: the file cannot be read or is not a slave map.
    """
    slaves = environment.entries(_SLAVE_MAP, Slave)
    for name in slaves:
        if not (name.isascii() and name.isdecimal() and int(name) <= _LAST_ADDRESS and str(int(name)) == name):
            raise ConfigError(f"{_SLAVE_MAP}: addresses are 0 to {_LAST_ADDRESS}")
    return {int(name): slave for name, slave in slaves.items()}


def load_aliases(environment: Environment, slaves: dict[int, Slave]) -> dict[str, Alias]:
    """Read the alias map; without one there are no aliases.

    Raises:
        ConfigError: the file cannot be read or is not an alias map, or an alias has a place that its slave does not have.
    """
    aliases = environment.entries(_ALIAS_MAP, Alias)
    for name, alias in aliases.items():
        slave = slaves.get(alias.slave_address)
        if slave is None:
            raise ConfigError(f"{_ALIAS_MAP}: {name}: the slave map has no slave {alias.slave_address}")
        if alias.end > (slave.input_length if alias.area == "inputs" else slave.output_length):
            raise ConfigError(f"{_ALIAS_MAP}: {name}: it ends after the {alias.area} of its slave")
    return aliases
