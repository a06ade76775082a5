"""The arguments of the tools with their bounds, and the shapes of their ``data``. Addresses are those of stations, bytes are 0 to 255."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator
from typing_extensions import TypedDict

from ..core import LEFT_OUT, AdapterError, AliasName, Arguments, BoundsCode
from ..core.process_data import Value
from .telegram import MOST_DATA

__all__ = [
    "AliasValue",
    "Communication",
    "DiagnosisData",
    "GsdFile",
    "GsdPath",
    "Inputs",
    "InputsOf",
    "MasterStatus",
    "Outputs",
    "Reachable",
    "Scan",
    "SlaveAddress",
    "SlaveList",
    "Station",
    "StationType",
    "Stations",
    "WriteAlias",
    "WriteOutputs",
]

Address = Annotated[int, Field(ge=0, le=125, description="station address, 0 to 125; 126 and 127 are no device's")]
Byte = Annotated[int, Field(ge=0, le=255)]


# -- arguments ----------------------------------------------------------------------------------------------


class Scan(Arguments):
    """Which addresses are asked."""

    first_address: Address = 0
    last_address: Address = 125

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.first_address > self.last_address:
            raise AdapterError("invalid_input", "the first address is above the last one", field="/first_address")
        return self


class SlaveAddress(Arguments):
    """A slave."""

    slave_address: Address


class InputsOf(SlaveAddress):
    """The inputs of a slave, or the first of them."""

    length: int = Field(
        default=LEFT_OUT, ge=1, le=MOST_DATA, description="how many bytes, from the first one; all if left out"
    )


class WriteOutputs(SlaveAddress):
    """All outputs of a slave."""

    data: Annotated[
        list[Byte],
        Field(min_length=1, max_length=MOST_DATA, description="all output bytes of the slave, each 0 to 255"),
        BoundsCode("range_overflow"),
    ]


class GsdPath(Arguments):
    """A GSD file."""

    filepath: Annotated[str, Field(min_length=1, max_length=200, description="name in the folder of GSD files")]


class WriteAlias(AliasName):
    """An alias and its value."""

    value: Annotated[int | float | str | bool, Field(description="a number within the alias's type")]


# -- data ---------------------------------------------------------------------------------------------------


class Reachable(TypedDict):
    """A station of the line answers, and which."""

    reachable: bool
    slave_address: int


StationType = Literal["slave", "master_not_ready", "master_ready", "master_in_ring"]


class Station(TypedDict):
    """A station that answers, and what it says that it is."""

    address: int
    type: StationType


class Stations(TypedDict):
    """The stations that answer, by their addresses; this master is not among them."""

    stations: list[Station]


class Inputs(TypedDict):
    """The inputs of a slave at the moment of the answer."""

    slave_address: int
    bytes: list[int]


class Outputs(TypedDict):
    """The outputs that the slave has after the write, and the seconds after which it gives them up when this master is silent."""

    slave_address: int
    bytes: list[int]
    watchdog_s: float


class DiagnosisData(TypedDict):
    """What a slave says of itself: the names of the bits that are set, the master that has parameterised it (null: none), its ident number
    and the device's own diagnosis, both in hexadecimal."""

    slave_address: int
    status: list[str]
    master: int | None
    ident: str
    extended: str


class GsdFile(TypedDict):
    """What a GSD file says. ``ident`` and each module's ``cfg`` are hexadecimal, as in the slave map."""

    vendor: str | None
    model: str | None
    revision: str | None
    ident: str | None
    max_input_length: int | None
    max_output_length: int | None
    baud_rates: list[str]
    modules: list[dict[str, str]]


class SlaveList(TypedDict):
    """The slave map: addresses, names, ident numbers and configurations, bytes of inputs and outputs; and the aliases."""

    slaves: list[dict[str, Any]]
    aliases: list[dict[str, Any]]


class AliasValue(Value):
    """An alias's value."""

    alias: str
    slave_address: int
    unit: str | None


class SlaveState(TypedDict):
    """Whether the outputs of a slave are kept alive: ``passive``, ``data_exchange`` or ``lost``, and then why."""

    slave_address: int
    state: Literal["passive", "data_exchange", "lost"]
    outputs: list[int] | None
    reason: str | None


class MasterStatus(TypedDict):
    """This master: its address, baud rate (bit/s), cycle and watchdog (seconds), and what it does with each slave."""

    master_address: int
    baud: int
    cycle_s: float
    watchdog_s: float
    slaves: list[SlaveState]


class Communication(TypedDict):
    """What a slave answers, beside what the slave map says; ``matches`` is null for a slave that it does not have."""

    slave_address: int
    status: list[str]
    master: int | None
    ident: str
    cfg: str
    matches: bool | None
