"""One object of the device: its properties, its priority array, and what may be written to it.

Commandable objects have sixteen slots (ASHRAE 135, clause 19.2): the present value is the one in the slot of the highest priority
that is not null, 1 before 16, or the relinquish default where all are null. A write is acknowledged although a slot of a higher
priority wins. Priority 6 belongs to minimum on and off times, which no object here has: the device refuses it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pytest_otmcp.wire.bacnet.services import PRIORITIES
from pytest_otmcp.wire.bacnet.values import Value

from .names import (
    INVALID_ARRAY_INDEX,
    INVALID_DATATYPE,
    NOT_AN_ARRAY,
    UNKNOWN_PROPERTY,
    VALUE_OUT_OF_RANGE,
    WRITE_ACCESS_DENIED,
    ObjectType,
    Property,
    Refusal,
)

__all__ = ["BacnetObject", "Content", "element_of"]

_MINIMUM_ON_OFF = 6
_FAULT_STATE, _NORMAL_STATE = 1, 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """What a property holds; ``is_array`` when each element can be asked for by its index."""

    values: Sequence[Value]
    is_array: bool = False


def _one(kind: str, value: Any) -> Content:
    return Content(values=[Value(kind=kind, value=value)])


def element_of(content: Content, index: int | None) -> Sequence[Value]:
    """Return the values that a read of a property answers with.

    Args:
        index: of the element, from 1; 0 for the number of elements; None for the whole property.

    Raises:
        Refusal: the property is no array, or does not have the element.
    """
    if index is None:
        return content.values
    if not content.is_array:
        raise Refusal(*NOT_AN_ARRAY)
    if index == 0:
        return [Value(kind="unsigned", value=len(content.values))]
    if index > len(content.values):
        raise Refusal(*INVALID_ARRAY_INDEX)
    return [content.values[index - 1]]


@dataclass(slots=True, kw_only=True)
class BacnetObject:
    """An object with a present value.

    Attributes:
        type, instance, name: object type, instance number and object name.
        kind: datatype of the present value.
        held: the present value; of a commandable object the relinquish default.
        commandable: it has a priority array.
        writable: clients may write the present value.
        lowest, highest: bounds of what may be written.
        units: engineering units (BACnetEngineeringUnits), or None.
        states: texts of a multi-state object's states, from 1.
        writing: of a schedule, the priority with which it writes.
        reliability: 0 for no fault detected (BACnetReliability).
        slots: the priority array, priority 1 first.
    """

    type: ObjectType
    instance: int
    name: str
    kind: str
    held: Any
    commandable: bool = False
    writable: bool = False
    lowest: float | None = None
    highest: float | None = None
    units: int | None = None
    states: tuple[str, ...] = ()
    writing: int | None = None
    reliability: int = 0
    slots: list[Any] = field(default_factory=lambda: [None] * PRIORITIES)

    @property
    def label(self) -> str:
        """The object identifier in words, such as ``analog-input,1``."""
        return f"{self.type.text},{self.instance}"

    @property
    def present(self) -> Any:
        """The present value."""
        return next((slot for slot in self.slots if slot is not None), self.held) if self.commandable else self.held

    def properties(self) -> Mapping[Property, Content]:
        """Return all properties but the list of properties, in the order in which they are listed."""
        found = {
            Property.OBJECT_IDENTIFIER: _one("object-identifier", [int(self.type), self.instance]),
            Property.OBJECT_NAME: _one("character-string", self.name),
            Property.OBJECT_TYPE: _one("enumerated", int(self.type)),
            Property.PRESENT_VALUE: _one(self.kind, self.present),
            Property.STATUS_FLAGS: _one("bit-string", "0100" if self.reliability else "0000"),
            Property.EVENT_STATE: _one("enumerated", _FAULT_STATE if self.reliability else _NORMAL_STATE),
            Property.RELIABILITY: _one("enumerated", self.reliability),
            Property.OUT_OF_SERVICE: _one("boolean", False),
        }
        if self.units is not None:
            found[Property.UNITS] = _one("enumerated", self.units)
        if self.type in (ObjectType.BINARY_INPUT, ObjectType.BINARY_OUTPUT):
            found[Property.POLARITY] = _one("enumerated", 0)
        if self.lowest is not None and self.highest is not None and self.kind == "real":
            found[Property.MIN_PRES_VALUE] = _one("real", self.lowest)
            found[Property.MAX_PRES_VALUE] = _one("real", self.highest)
        if self.states:
            texts = [Value(kind="character-string", value=text) for text in self.states]
            found[Property.NUMBER_OF_STATES] = _one("unsigned", len(texts))
            found[Property.STATE_TEXT] = Content(values=texts, is_array=True)
        if self.commandable:
            slots = [Value(kind="null" if slot is None else self.kind, value=slot) for slot in self.slots]
            found[Property.PRIORITY_ARRAY] = Content(values=slots, is_array=True)
            found[Property.RELINQUISH_DEFAULT] = _one(self.kind, self.held)
        if self.writing is not None:
            found[Property.PRIORITY_FOR_WRITING] = _one("unsigned", self.writing)
        return found

    def points(self) -> dict[str, Any]:
        """Return the present value and each slot of the priority array, by name."""
        found = {f"{self.label}/present-value": self.present}
        if self.commandable:
            found |= {f"{self.label}/priority-array/{number}": slot for number, slot in enumerate(self.slots, 1)}
        return found

    def checked(self, values: Sequence[Value]) -> Any:
        """Return what a write of these values to the present value would hold; None relinquishes.

        Raises:
            Refusal: another datatype, or out of bounds.
        """
        if len(values) != 1 or values[0].kind not in ((self.kind, "null") if self.commandable else (self.kind,)):
            raise Refusal(*INVALID_DATATYPE)
        value = values[0].value
        if value is None:
            return None
        if self.kind == "character-string":
            return value
        if isinstance(value, str) or not math.isfinite(value):
            raise Refusal(*VALUE_OUT_OF_RANGE)
        if (self.lowest is not None and value < self.lowest) or (self.highest is not None and value > self.highest):
            raise Refusal(*VALUE_OUT_OF_RANGE)
        return value

    def write(
        self, number: int, index: int | None, values: Sequence[Value], priority: int | None, *, apply: bool
    ) -> None:
        """Write a property.

        Args:
            number: of the property.
            index: of an array's element; None for the whole property.
            priority: 1 to 16; None for 16.
            apply: False checks the write without doing it.

        Raises:
            Refusal: the error to answer with.
        """
        known = self.properties()
        if number not in known and number != Property.PROPERTY_LIST:
            raise Refusal(*UNKNOWN_PROPERTY)
        if number != Property.PRESENT_VALUE or not self.writable:
            raise Refusal(*WRITE_ACCESS_DENIED)
        if index is not None:
            raise Refusal(*NOT_AN_ARRAY)
        value = self.checked(values)
        if self.commandable and priority == _MINIMUM_ON_OFF:
            raise Refusal(*WRITE_ACCESS_DENIED)
        if not apply:
            return
        if self.commandable:
            self.slots[(priority or PRIORITIES) - 1] = value
        else:
            self.held = value
