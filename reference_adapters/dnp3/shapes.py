"""The arguments of the tools with their bounds, and the shapes of their ``data``. Indexes begin at 0, times of commands are in milliseconds."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from typing_extensions import TypedDict

from ..core import LEFT_OUT, AdapterError, AliasName, Arguments, BoundsCode
from .commands import ON_CODES, ControlName

LAST_ADDRESS = 65519
"""The link addresses above this one are reserved: those from 65533 on are every outstation's, and a command there is everybody's."""
MAX_POINTS = 500

OutstationAddress = Annotated[
    int, Field(ge=0, le=LAST_ADDRESS, description=f"link address of the outstation, 0 to {LAST_ADDRESS}")
]
Index = Annotated[int, Field(ge=0, le=65535, description="index of the point, from 0")]
EventClass = Annotated[
    int, Field(ge=0, le=3, description="1 to 3: events of this class; 0: the present values of all points")
]
Milliseconds = Annotated[int, Field(ge=0, le=2**32 - 1, description="milliseconds, of a pulse only")]
AnyValue = Annotated[
    bool | int | float | str,
    Field(description="true or false for a binary output, a number for an analog output, a text for an octet string"),
]
_PULSES = ("pulse_on", "pulse_off", "trip", "close")


# -- arguments ----------------------------------------------------------------------------------------------


class PointRange(Arguments):
    """Points of one type with successive indexes."""

    outstation_address: OutstationAddress
    start_index: Index
    count: Annotated[
        int,
        Field(ge=1, le=MAX_POINTS, description=f"number of points, 1 to {MAX_POINTS}"),
        BoundsCode("limit_exceeded"),
    ] = 1

    @model_validator(mode="after")
    def _exists(self) -> Self:
        if self.start_index + self.count > 65536:
            message = "start_index and count together run past the index 65535"
            raise AdapterError("invalid_input", message, field="/count")
        return self


class PollClass(Arguments):
    """A class of events."""

    outstation_address: OutstationAddress
    event_class: EventClass


class WriteBinaryOutput(Arguments):
    """A binary output and what to do with it."""

    outstation_address: OutstationAddress
    index: Index
    value: Annotated[
        bool, Field(description="true: on (latch_on, pulse_on, close); false: off (latch_off, pulse_off, trip)")
    ]
    mode: Annotated[
        Literal["select_before_operate", "direct_operate"],
        Field(description="direct_operate needs a setting of the adapter"),
    ] = "select_before_operate"
    code: ControlName = Field(
        default=LEFT_OUT, description="control code; latch_on or latch_off by the value if left out"
    )
    count: Annotated[int, Field(ge=1, le=255, description="number of pulses")] = 1
    on_time_ms: Milliseconds = 0
    off_time_ms: Milliseconds = 0

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        code = self.control
        if (code in ON_CODES) != self.value:
            message = f"the code {code} contradicts the value"
            raise AdapterError("invalid_input", message, field="/code")
        if code not in _PULSES and (self.count != 1 or self.on_time_ms or self.off_time_ms):
            raise AdapterError("invalid_input", "a latch has no pulses and no times", field="/code")
        return self

    @property
    def control(self) -> ControlName:
        """The control code that is meant."""
        return self.code or ("latch_on" if self.value else "latch_off")


class WriteAlias(AliasName):
    """An alias and its new value."""

    value: AnyValue


# -- data ---------------------------------------------------------------------------------------------------


class Reachable(TypedDict):
    """The outstation answers."""

    reachable: bool
    outstation_address: int


class PointValue(TypedDict):
    """A point. ``special`` is NaN, Infinity or -Infinity where ``value`` is null for want of a JSON number; ``flags`` are the standard's
    names, null where the outstation sent none; ``timestamp`` is its clock's, ISO 8601 in UTC, null where it sent none."""

    point_type: str
    index: int
    value: bool | int | float | str | None
    special: str | None
    flags: list[str] | None
    timestamp: str | None


class Points(TypedDict):
    """The points that were asked for, by index."""

    outstation_address: int
    points: list[PointValue]


class Polled(TypedDict):
    """What a poll has brought, oldest first. ``unsolicited`` is what the outstation has told unasked since the last poll, of any class.
    ``overflow``: it had more events than it could keep, and has lost some."""

    outstation_address: int
    event_class: int
    points: list[PointValue]
    unsolicited: list[PointValue]
    overflow: bool


class Written(TypedDict):
    """A command that was carried out. ``state`` is the output's status that was read afterwards: null after a pulse, and where the
    outstation has none."""

    outstation_address: int
    index: int
    value: bool
    code: str
    mode: str
    status: str
    state: bool | None


class AliasEntry(TypedDict):
    """An entry of the alias map."""

    alias: str
    outstation_address: int
    point_type: str
    index: int
    data_type: str | None
    unit: str | None
    writable: bool


class AliasList(TypedDict):
    """The alias map."""

    points: list[AliasEntry]


class AliasValue(PointValue):
    """The point of an alias."""

    alias: str
    unit: str | None
    outstation_address: int


class AliasWritten(TypedDict):
    """A point of an alias that was written. ``state`` was read afterwards, null where the outstation has none."""

    alias: str
    unit: str | None
    outstation_address: int
    point_type: str
    index: int
    value: bool | int | float | str
    status: str | None
    state: bool | int | float | str | None
