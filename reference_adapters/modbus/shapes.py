"""The arguments of the tools with their bounds, and the shapes of their ``data``.

Limits are those of one PDU (MODBUS Application Protocol V1.1b3, sections 6.1 to 6.12), but for reads of registers: a larger block is
read by several requests, which are not made at one moment, and ``meta.atomic`` says so. No write is split, because two writes are not
one change, and no number that spans registers.
"""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, model_validator
from typing_extensions import TypedDict

from ..core import LEFT_OUT, AdapterError, Arguments, BoundsCode
from .codec import DataType, Order, Value, width

MAX_READ_BITS, MAX_READ_REGISTERS, MAX_WRITE_BITS, MAX_WRITE_REGISTERS = 2000, 125, 1968, 123
MAX_BLOCK = 2000
"""Registers that one call reads, by as few requests as possible."""

Address = Annotated[int, Field(ge=0, le=65535, description="PDU address, from 0")]
Word = Annotated[int, Field(ge=0, le=65535, description="0 to 65535"), BoundsCode("range_overflow")]


def is_unit(number: int) -> bool:
    """Tell whether a device may have this number: 248 to 254 are reserved (Messaging on TCP/IP V1.0b, 4.4.1.2)."""
    return 0 <= number <= 247 or number == 255


def _within(address: int, count: int, field: str) -> None:
    if address + count > 65536:
        raise AdapterError("invalid_input", "address and count together run past address 65535", field=field)


# -- arguments ----------------------------------------------------------------------------------------------


class Unit(Arguments):
    """Which device behind the connection."""

    unit_id: int = Field(
        default=LEFT_OUT,
        ge=0,
        le=255,
        description="unit identifier, 0 to 247 or 255; the configured one if left out",
        json_schema_extra={"not": {"minimum": 248, "maximum": 254}},
    )

    @model_validator(mode="after")
    def _unit_exists(self) -> Self:
        if self.unit_id is not None and not is_unit(self.unit_id):
            raise AdapterError("invalid_input", "unit identifiers 248 to 254 are reserved", field="/unit_id")
        return self


class Cell(Unit):
    """One cell of a table."""

    address: Address


class _Block(Cell):
    count: int

    @model_validator(mode="after")
    def _block_exists(self) -> Self:
        _within(self.address, self.count, "/count")
        return self


class Registers(_Block):
    """A block of registers."""

    count: Annotated[
        int,
        Field(ge=1, le=MAX_BLOCK, description="1 to 2000; up to 125 are read at one moment"),
        BoundsCode("limit_exceeded"),
    ]


class Bits(_Block):
    """A block of coils or discrete inputs."""

    count: Annotated[int, Field(ge=1, le=MAX_READ_BITS, description="1 to 2000"), BoundsCode("limit_exceeded")]


class WriteRegister(Cell):
    """One register and its value."""

    value: Word


class _Values(Cell):
    values: list[Any]

    @model_validator(mode="after")
    def _block_exists(self) -> Self:
        _within(self.address, len(self.values), "/values")
        return self


class WriteRegisters(_Values):
    """A block of registers and their values."""

    values: Annotated[
        list[Annotated[int, Field(ge=0, le=65535)]],
        Field(min_length=1, max_length=MAX_WRITE_REGISTERS, description="1 to 123 values of 0 to 65535"),
        BoundsCode("range_overflow"),
    ]


class WriteCoil(Cell):
    """One coil and its state."""

    value: Annotated[bool, Field(description="true is on")]


class WriteCoils(_Values):
    """A block of coils and their states."""

    values: Annotated[
        list[bool], Field(min_length=1, max_length=MAX_WRITE_BITS, description="1 to 1968 states, true is on")
    ]


class MaskWrite(Cell):
    """New value = (old AND and_mask) OR (or_mask AND NOT and_mask)."""

    and_mask: Word
    or_mask: Word


class Typed(Cell):
    """A value that may span registers."""

    data_type: Annotated[DataType, Field(description="type of the value; 16 bits per register")]
    order: Annotated[
        Order, Field(description="byte order; ABCD is big-endian, CDAB has the words swapped, BADC the bytes")
    ] = "ABCD"

    @model_validator(mode="after")
    def _value_exists(self) -> Self:
        _within(self.address, width(self.data_type), "/address")
        return self


class TagName(Arguments):
    """A tag of the tag map."""

    tag: Annotated[str, Field(min_length=1, max_length=200, description="a name that list_tags lists")]


class WriteTag(TagName):
    """A tag and its engineering value."""

    value: Annotated[int | float, Field(description="in the tag's unit")]


# -- data ---------------------------------------------------------------------------------------------------


class Reachable(TypedDict):
    """The device answers."""

    reachable: bool


class RegisterValue(TypedDict):
    """One register."""

    address: int
    value: int


class RegisterValues(TypedDict):
    """Registers in the order of their addresses."""

    address: int
    count: int
    values: list[int]


class CoilState(TypedDict):
    """One coil."""

    address: int
    value: bool


class BitStates(TypedDict):
    """Coils or discrete inputs in the order of their addresses."""

    address: int
    count: int
    values: list[bool]


class Masked(TypedDict):
    """A mask write that the device confirmed."""

    address: int
    and_mask: int
    or_mask: int


class TypedValue(Value):
    """A value and where it begins."""

    address: int


class TagValue(Value):
    """A tag's engineering value; ``raw`` is what the registers hold."""

    tag: str
    unit: str | None


class TagWritten(TypedDict):
    """The engineering value asked for, and the raw value that was written for it."""

    tag: str
    value: int | float
    raw: int | float
    unit: str | None


class TagList(TypedDict):
    """The tag map."""

    tags: list[dict[str, Any]]


class Identification(TypedDict):
    """Identification objects by their number."""

    objects: dict[str, str]
