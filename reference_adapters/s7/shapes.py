"""The arguments of the tools with their bounds, and the shapes of their ``data``. Offsets and sizes are in bytes.

The adapter splits no request, because two reads are not made at one moment and two writes are not one change: what is asked for
at once has to fit into one PDU.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator
from typing_extensions import TypedDict

from ..core import LEFT_OUT, AdapterError, Arguments, BoundsCode
from .codec import DataType, Plain, Value
from .link import PDU_SIZE

MAX_READ = PDU_SIZE - 18
MAX_VARIABLES = 20

Area = Literal["DB", "I", "Q", "M"]
Offset = Annotated[int, Field(ge=0, le=65535, description="offset in bytes, from 0")]
Block = Annotated[int, Field(ge=1, le=65535, description="number of the data block")]
Size = Annotated[
    int, Field(ge=1, le=MAX_READ, description=f"number of bytes, 1 to {MAX_READ}"), BoundsCode("limit_exceeded")
]
Bit = Annotated[int, Field(ge=0, le=7, description="bit of a BOOL, 0 to 7; 0 for other types")]
Type = Annotated[DataType, Field(description="data type of the value; numbers are big-endian")]
AnyValue = Annotated[
    Plain,
    Field(description="true or false for BOOL, a text for CHAR and STRING, else a number within the type's range"),
]


class _Typed(Arguments):
    data_type: Type
    bit_index: Bit = 0
    string_length: int = Field(
        default=LEFT_OUT,
        ge=1,
        le=254,
        description="declared length of a STRING, in characters; the controller is asked for it if left out",
    )

    @model_validator(mode="after")
    def _fits_the_type(self) -> Self:
        if self.bit_index and self.data_type != "BOOL":
            raise AdapterError("invalid_input", "only a BOOL has a bit", field="/bit_index")
        if self.string_length is not None and self.data_type != "STRING":
            raise AdapterError("invalid_input", "only a STRING has a declared length", field="/string_length")
        return self


class BlockBytes(Arguments):
    """Bytes of a data block."""

    db_number: Block
    start_offset: Offset
    size: Size


class BlockValue(_Typed):
    """A value in a data block."""

    db_number: Block
    start_offset: Offset


class WriteBlockValue(BlockValue):
    """A value, and where in a data block it is written."""

    value: AnyValue


class AreaBytes(Arguments):
    """Bytes of an area."""

    start_byte: Offset
    size: Size


class WriteAreaValue(Arguments):
    """A value, and where in an area it is written."""

    start_byte: Offset
    value: AnyValue
    data_type: Type
    bit_index: Bit = 0

    @model_validator(mode="after")
    def _fits_the_type(self) -> Self:
        if self.bit_index and self.data_type != "BOOL":
            raise AdapterError("invalid_input", "only a BOOL has a bit", field="/bit_index")
        if self.data_type == "STRING":
            raise AdapterError("unsupported_operation", "a STRING is written to a data block", field="/data_type")
        return self


class OneVariable(Arguments):
    """A value anywhere."""

    area: Annotated[Area, Field(description="DB, I (inputs), Q (outputs) or M (flags)")]
    db_number: Annotated[int, Field(ge=0, le=65535, description="number of the data block; 0 for other areas")] = 0
    start_byte: Offset
    data_type: Type
    bit_index: Bit = 0

    @model_validator(mode="after")
    def _exists(self) -> Self:
        if (self.area == "DB") != (self.db_number > 0):
            raise AdapterError("invalid_input", "db_number is from 1 for the area DB, and 0 for others")
        if self.bit_index and self.data_type != "BOOL":
            raise AdapterError("invalid_input", "only a BOOL has a bit")
        if self.data_type == "STRING":
            raise AdapterError("unsupported_operation", "read or write a STRING by itself: its length differs")
        return self


class WrittenVariable(OneVariable):
    """A value and where it is written."""

    value: AnyValue


class ReadVariables(Arguments):
    """Several values."""

    variables: Annotated[
        list[OneVariable], Field(min_length=1, max_length=MAX_VARIABLES, description=f"1 to {MAX_VARIABLES} variables")
    ]


class WriteVariables(Arguments):
    """Several values and where they are written."""

    variables: Annotated[
        list[WrittenVariable],
        Field(min_length=1, max_length=MAX_VARIABLES, description=f"1 to {MAX_VARIABLES} variables with values"),
    ]


class StatusList(Arguments):
    """A system status list."""

    szl_id: Annotated[int, Field(ge=0, le=65535, description="id, such as 1060 (0424 hexadecimal)")]
    szl_index: Annotated[int, Field(ge=0, le=65535, description="index")] = 0


class CpuState(Arguments):
    """An operating state."""

    state: Annotated[Literal["RUN", "STOP"], Field(description="RUN: warm restart; STOP: the program ends")]


class TagName(Arguments):
    """A tag of the tag map."""

    name: Annotated[str, Field(min_length=1, max_length=200, description="a name that list_tags lists")]


class WriteTag(TagName):
    """A tag and its value."""

    value: AnyValue


# -- data ---------------------------------------------------------------------------------------------------


class Reachable(TypedDict):
    """The controller answers."""

    reachable: bool


class Connected(TypedDict):
    """Whether the controller answers, and how it was reached. ``pdu_size`` in bytes."""

    connected: bool
    pdu_size: int


class ReadBytes(TypedDict):
    """Bytes in the order of their offsets."""

    start: int
    bytes: list[int]


class TypedValue(Value):
    """A value and where it begins."""

    start: int


class Written(TypedDict):
    """A value that the controller has confirmed, and its bytes in hexadecimal."""

    start: int
    type: str
    value: bool | int | float | str
    raw: str


class Values(TypedDict):
    """Values in the order of the variables, read by one request."""

    values: list[Value]


class WrittenValues(TypedDict):
    """Values that the controller has confirmed, in the order of the variables."""

    values: list[Written]


class TagValue(Value):
    """A tag's value."""

    name: str
    unit: str | None


class TagWritten(Written):
    """A tag's value that the controller has confirmed."""

    name: str
    unit: str | None


class TagList(TypedDict):
    """The tag map."""

    tags: list[dict[str, Any]]


class PlcInfo(TypedDict):
    """Who the controller says that it is; a text that it does not have is null."""

    order_number: str | None
    firmware: str | None
    station_name: str | None
    module_name: str | None
    module_type: str | None
    serial_number: str | None


class State(TypedDict):
    """The operating state of the CPU."""

    state: Literal["RUN", "STOP"]


class SystemTime(TypedDict):
    """The controller's clock, ISO 8601; it has no time zone."""

    time: str


class StatusRecords(TypedDict):
    """The records of a system status list, in hexadecimal."""

    szl_id: int
    szl_index: int
    record_length: int
    records: list[str]
