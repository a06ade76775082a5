"""The arguments of the tools with their bounds, and the shapes of their ``data``. Positions count from 0, bytes are 0 to 255."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field
from typing_extensions import TypedDict

from ..core import LEFT_OUT, AliasName, Arguments, BoundsCode
from .codec import DataType, Value
from .maps import number

__all__ = [
    "AliasValue",
    "Bytes",
    "Communication",
    "EsiFile",
    "EsiPath",
    "MasterStatus",
    "Object",
    "ObjectValue",
    "Outputs",
    "Reachable",
    "ReadPdo",
    "SetState",
    "Slave",
    "SlaveInfo",
    "SlaveList",
    "SlaveState",
    "Slaves",
    "WriteAlias",
    "WriteObject",
    "WritePdo",
]

_MOST = 1486
"""Bytes of process data that a frame has at most."""
Byte = Annotated[int, Field(ge=0, le=255)]
State = Literal["INIT", "PREOP", "SAFEOP", "OP"]


# -- arguments ----------------------------------------------------------------------------------------------


class Slave(Arguments):
    """A slave."""

    slave_position: Annotated[int, Field(ge=0, le=65535, description="position on the line, from 0")]


class ReadPdo(Slave):
    """Inputs of a slave."""

    offset: Annotated[int, Field(ge=0, lt=_MOST, description="first byte")] = 0
    length: int = Field(default=LEFT_OUT, ge=1, le=_MOST, description="how many bytes; up to the last one if left out")


class WritePdo(Slave):
    """Outputs of a slave."""

    data: Annotated[
        list[Byte],
        Field(min_length=1, max_length=_MOST, description="output bytes, each 0 to 255"),
        BoundsCode("range_overflow"),
    ]
    offset: int = Field(
        default=LEFT_OUT,
        ge=0,
        lt=_MOST,
        description="first byte that is written; if left out, data are all output bytes",
    )


class Object(Slave):
    """An object of a slave's dictionary."""

    index: Annotated[
        int, Field(ge=0, le=0xFFFF, description="0 to 65535, or a text such as 0x2000"), BeforeValidator(number)
    ]
    subindex: Annotated[int, Field(ge=0, le=255)] = 0
    data_type: Annotated[DataType, Field(description="type of the object; the slave does not say it")]


class WriteObject(Object):
    """An object and its value."""

    value: Annotated[bool | int | float | str, Field(description="a value within the type")]


class SetState(Slave):
    """A state of a slave."""

    state: State


class EsiPath(Arguments):
    """An ESI file."""

    filepath: Annotated[str, Field(min_length=1, max_length=200, description="name in the folder of ESI files")]


class WriteAlias(AliasName):
    """An alias and its value."""

    value: Annotated[bool | int | float | str, Field(description="a value within the alias's type")]


# -- data ---------------------------------------------------------------------------------------------------


class Reachable(TypedDict):
    """A slave answers, and which."""

    reachable: bool
    slave_position: int
    state: str


class Identity(TypedDict):
    """What a slave's EEPROM says of it, and bytes of its process data; numbers are as in its ESI file."""

    slave_position: int
    name: str
    vendor_id: int
    product_code: int
    revision: int
    input_length: int
    output_length: int


class Found(Identity):
    """A slave that answers, and its state."""

    state: str


class Slaves(TypedDict):
    """The slaves that answer, in their order. ``complete`` is false where others were not looked for, because outputs would have fallen."""

    slaves: list[Found]
    complete: bool


class SlaveInfo(Found):
    """A slave, its AL status code (0: no error), and whether its outputs are kept up by this master."""

    al_status: int
    driven: bool


class SlaveList(TypedDict):
    """The slaves that were found last, and the aliases."""

    slaves: list[Identity]
    aliases: list[dict[str, Any]]


class Bytes(TypedDict):
    """Inputs of a slave at the moment of the answer."""

    slave_position: int
    offset: int
    bytes: list[int]


class Outputs(TypedDict):
    """All outputs that the slave has taken, and the seconds after which it gives them up when this master is silent."""

    slave_position: int
    bytes: list[int]
    watchdog_s: float


class ObjectValue(Value):
    """The value of an object."""

    slave_position: int
    index: int
    subindex: int


class AliasValue(Value):
    """An alias's value."""

    alias: str
    slave_position: int
    unit: str | None


class SlaveState(TypedDict):
    """The state in which a slave is."""

    slave_position: int
    state: str


class EsiFile(TypedDict):
    """What an ESI file says of its devices."""

    vendor: str | None
    vendor_id: int | None
    devices: list[dict[str, Any]]


class MasterStatus(TypedDict):
    """This master: its interface, cycle and watchdog (seconds), and which slaves it drives; ``reason`` is why it does not any more."""

    interface: str
    open: bool
    cycle_s: float
    watchdog_s: float
    slaves: list[dict[str, Any]]


class Communication(TypedDict):
    """A slave's state, and whether its dictionary has the identity that its EEPROM says."""

    slave_position: int
    state: str
    vendor_id: int
    product_code: int
    matches: bool
