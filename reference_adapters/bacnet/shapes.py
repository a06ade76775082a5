"""The arguments of the tools with their bounds, and the shapes of their ``data``."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator
from typing_extensions import TypedDict

from ..core import LEFT_OUT, AdapterError, AliasName, Arguments

MINIMUM_ON_OFF = 6
"""The priority that ASHRAE 135, clause 19.2.3, keeps for minimum on and off times."""

ObjectTypeName = Literal[
    "accumulator",
    "analog-input",
    "analog-output",
    "analog-value",
    "binary-input",
    "binary-output",
    "binary-value",
    "calendar",
    "characterstring-value",
    "device",
    "file",
    "integer-value",
    "large-analog-value",
    "loop",
    "multi-state-input",
    "multi-state-output",
    "multi-state-value",
    "notification-class",
    "positive-integer-value",
    "program",
    "schedule",
    "trend-log",
]

Instance = Annotated[int, Field(ge=0, le=4194302, description="instance number")]
DeviceId = Annotated[int, Field(ge=0, le=4194302, description="instance number of the device object")]


# -- arguments ----------------------------------------------------------------------------------------------


class Discovery(Arguments):
    """How long to wait."""

    timeout_ms: Annotated[int, Field(ge=1, le=4000, description="milliseconds to wait for answers, 1 to 4000")] = 500


class Device(Arguments):
    """One device."""

    device_id: DeviceId


class PropertyOf(Device):
    """A property of an object."""

    object_type: Annotated[ObjectTypeName, Field(description="object type as the standard writes it")]
    object_instance: Instance
    property_id: Annotated[
        str,
        Field(pattern="^[a-z][a-z0-9-]*$", max_length=60, description="property as the standard writes it"),
    ] = "present-value"
    array_index: int = Field(
        default=LEFT_OUT,
        ge=0,
        le=65535,
        description="element of an array, from 1; 0 for the number of elements; the whole array if left out",
    )


NewValue = Annotated[
    int | float | str | bool | None,
    Field(
        description="number for analog and multi-state objects, 0, 1, inactive or active for binary ones; "
        "null gives up (relinquishes) the priority"
    ),
]


class WriteProperty(PropertyOf):
    """A property and its new value."""

    value: NewValue
    priority: int = Field(
        default=LEFT_OUT,
        ge=1,
        le=16,
        description="slot of the priority array, 1 (highest) to 16; 6 is reserved; the configured one if left out",
        json_schema_extra={"not": {"const": MINIMUM_ON_OFF}},
    )

    @model_validator(mode="after")
    def _priority_is_free(self) -> Self:
        if self.priority == MINIMUM_ON_OFF:
            message = "priority 6 is reserved for minimum on and off times"
            raise AdapterError("invalid_input", message, field="/priority")
        return self


class WriteAlias(AliasName):
    """An alias and its new value."""

    value: NewValue


# -- data ---------------------------------------------------------------------------------------------------


class Reachable(TypedDict):
    """The device answers."""

    reachable: bool
    device_id: int | None


class FoundDevice(TypedDict):
    """What an I-Am says."""

    device_id: int
    vendor_id: int
    max_apdu_length: int
    address: str


class FoundDevices(TypedDict):
    """The devices that answered in time."""

    devices: list[FoundDevice]


class ObjectName(TypedDict):
    """An object identifier."""

    object_type: str
    object_instance: int


class ObjectList(TypedDict):
    """The objects of a device, in its own order."""

    device_id: int
    objects: list[ObjectName]


class PropertyValue(TypedDict):
    """A property. ``type`` is the datatype that the device sent, ``list`` where the property has not exactly one value;
    ``special`` is NaN, Infinity or -Infinity where ``value`` is null for want of a JSON number; integers beyond 2^53 - 1 are decimal
    strings."""

    device_id: int
    object_type: str
    object_instance: int
    property_id: str
    type: str
    value: Any
    special: str | None


class Written(TypedDict):
    """A write that is in effect. ``present_value`` was read afterwards; ``priority`` is that of the write and ``winning_priority`` that of the
    value in effect, both null for an object without a priority array."""

    device_id: int
    object_type: str
    object_instance: int
    property_id: str
    value: Any
    present_value: Any
    priority: int | None
    winning_priority: int | None


class AliasValue(PropertyValue):
    """The value of an alias."""

    alias: str
    unit: str | None


class AliasWritten(Written):
    """A write to an alias that is in effect."""

    alias: str
