"""The objects of the device and the dynamics of the plant behind them.

The plant moves the inputs and what its schedule writes at priority 16 of the setpoint; everything else belongs to the clients. It is
deterministic: the same ticks and writes give the same values. Temperatures are in degrees Fahrenheit, valve and level in percent.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any

from pytest_otmcp.wire.bacnet.services import Confirmed
from pytest_otmcp.wire.bacnet.values import Value

from .names import UNKNOWN_OBJECT, UNKNOWN_PROPERTY, ObjectType, Property, Refusal
from .objects import BacnetObject, Content

__all__ = ["DEVICE", "MAX_APDU", "NO_SEGMENTATION", "VENDOR", "Plant", "single"]

DEVICE = 12345
"""Instance of the device object."""
VENDOR = 999
MAX_APDU = 1476
NO_SEGMENTATION = 3

_FAHRENHEIT, _PERCENT = 64, 98
_OPTIONAL = {Property.RELIABILITY, Property.MIN_PRES_VALUE, Property.MAX_PRES_VALUE, Property.STATE_TEXT}
_SCHEDULE_PRIORITY = 16
_DAY, _NIGHT = 72.0, 65.0
_HALF_DAY_S = 30
_AMBIENT = 50.0


def _objects() -> list[BacnetObject]:
    kinds = ObjectType
    return [
        BacnetObject(
            type=kinds.ANALOG_INPUT, instance=1, name="Zone Temperature", kind="real", held=72.5, units=_FAHRENHEIT
        ),
        BacnetObject(
            type=kinds.ANALOG_INPUT, instance=2, name="Supply Temperature", kind="real", held=68.0, units=_FAHRENHEIT
        ),
        BacnetObject(
            type=kinds.ANALOG_OUTPUT,
            instance=1,
            name="Valve",
            kind="real",
            held=20.0,
            commandable=True,
            writable=True,
            units=_PERCENT,
        ),
        BacnetObject(
            type=kinds.ANALOG_VALUE,
            instance=2,
            name="Setpoint",
            kind="real",
            held=70.0,
            commandable=True,
            writable=True,
            units=_FAHRENHEIT,
        ),
        BacnetObject(
            type=kinds.ANALOG_VALUE,
            instance=9,
            name="Level Limit",
            kind="real",
            held=5.0,
            writable=True,
            lowest=0.0,
            highest=10.0,
            units=_PERCENT,
        ),
        BacnetObject(type=kinds.BINARY_INPUT, instance=1, name="Occupied", kind="enumerated", held=0),
        BacnetObject(
            type=kinds.BINARY_OUTPUT,
            instance=1,
            name="Fan",
            kind="enumerated",
            held=0,
            commandable=True,
            writable=True,
            lowest=0,
            highest=1,
        ),
        BacnetObject(
            type=kinds.BINARY_VALUE,
            instance=1,
            name="Enable",
            kind="enumerated",
            held=1,
            writable=True,
            lowest=0,
            highest=1,
        ),
        BacnetObject(
            type=kinds.MULTI_STATE_VALUE,
            instance=1,
            name="Mode",
            kind="unsigned",
            held=1,
            writable=True,
            lowest=1,
            highest=3,
            states=("Auto", "Heat", "Cool"),
        ),
        BacnetObject(
            type=kinds.SCHEDULE,
            instance=1,
            name="Setpoint Schedule",
            kind="real",
            held=_DAY,
            writing=_SCHEDULE_PRIORITY,
        ),
    ]


class Plant:
    """All objects but the device object, which is made of them.

    Attributes:
        objects: by type and instance.
        name: object name of the device object.
    """

    def __init__(self) -> None:
        self.objects = {(int(one.type), one.instance): one for one in _objects()}
        self.name = "Kit Device"
        self._seconds = 0
        self._zone = 72.5
        self._schedule()

    def enlarge(self, count: int) -> None:
        """Add analog values from instance 1000 on, until the plant has so many of these."""
        for instance in range(1000, 1000 + count):
            self.objects.setdefault(
                (ObjectType.ANALOG_VALUE, instance),
                BacnetObject(
                    type=ObjectType.ANALOG_VALUE,
                    instance=instance,
                    name=f"Value {instance}",
                    kind="real",
                    held=float(instance),
                    writable=True,
                ),
            )

    def diversify(self) -> None:
        """Add an object of each datatype that few devices have: a text, whole numbers of any size, a DOUBLE."""
        for kind, datatype, held in (
            (ObjectType.CHARACTERSTRING_VALUE, "character-string", ""),
            (ObjectType.INTEGER_VALUE, "integer", 0),
            (ObjectType.LARGE_ANALOG_VALUE, "double", 0.0),
            (ObjectType.POSITIVE_INTEGER_VALUE, "unsigned", 0),
        ):
            made = BacnetObject(type=kind, instance=1, name=f"One {datatype}", kind=datatype, held=held, writable=True)
            self.objects.setdefault((kind, 1), made)

    def at(self, kind: int, instance: int) -> BacnetObject:
        """Return an object that is not the device object.

        Raises:
            Refusal: there is none.
        """
        if (kind, instance) not in self.objects:
            raise Refusal(*UNKNOWN_OBJECT)
        return self.objects[kind, instance]

    def content(self, kind: int, instance: int, number: int) -> Content:
        """Return what a property of an object holds, also of the device object.

        Raises:
            Refusal: there is no such object or property.
        """
        known = self.properties(kind, instance)
        if number not in known:
            raise Refusal(*UNKNOWN_PROPERTY)
        return known[Property(number)]

    def properties(self, kind: int, instance: int) -> Mapping[Property, Content]:
        """Return all properties of an object.

        Raises:
            Refusal: there is no such object.
        """
        is_device = (kind, instance) == (ObjectType.DEVICE, DEVICE)
        found = dict(self._device() if is_device else self.at(kind, instance).properties())
        # Clause 12: these three are not in the list of properties.
        apart = (Property.OBJECT_NAME, Property.OBJECT_TYPE, Property.OBJECT_IDENTIFIER)
        listed = [Value(kind="enumerated", value=int(number)) for number in found if number not in apart]
        return {**found, Property.PROPERTY_LIST: Content(values=listed, is_array=True)}

    def named(self, kind: int, instance: int, number: int) -> list[int]:
        """Return the properties that ``all``, ``required`` or ``optional`` stands for, or this one."""
        if number not in (Property.ALL, Property.REQUIRED, Property.OPTIONAL):
            return [number]
        known = [one for one in self.properties(kind, instance) if one != Property.PROPERTY_LIST]
        if number == Property.ALL:
            return [int(one) for one in known]
        return [int(one) for one in known if (one in _OPTIONAL) == (number == Property.OPTIONAL)]

    def names(self) -> dict[str, tuple[int, int]]:
        """Return the identifiers of all objects by their names."""
        return {self.name: (int(ObjectType.DEVICE), DEVICE)} | {
            one.name: identifier for identifier, one in self.objects.items()
        }

    def _device(self) -> Mapping[Property, Content]:
        def one(kind: str, value: Any) -> Content:
            return Content(values=[Value(kind=kind, value=value)])

        def bits(numbers: list[int], count: int) -> Content:
            return one("bit-string", "".join("1" if number in numbers else "0" for number in range(count)))

        # The bits of unconfirmed services come after those of 26 others (clause 21, BACnetServicesSupported).
        services = [int(service) for service in Confirmed] + [26, 33, 34]
        listed = [(int(ObjectType.DEVICE), DEVICE), *self.objects]
        return {
            Property.OBJECT_IDENTIFIER: one("object-identifier", [int(ObjectType.DEVICE), DEVICE]),
            Property.OBJECT_NAME: one("character-string", self.name),
            Property.OBJECT_TYPE: one("enumerated", int(ObjectType.DEVICE)),
            Property.SYSTEM_STATUS: one("enumerated", 0),
            Property.VENDOR_NAME: one("character-string", "pytest-otmcp"),
            Property.VENDOR_IDENTIFIER: one("unsigned", VENDOR),
            Property.MODEL_NAME: one("character-string", "MOCK-BAC-1"),
            Property.FIRMWARE_REVISION: one("character-string", "1.0"),
            Property.APPLICATION_SOFTWARE_VERSION: one("character-string", "1.0"),
            Property.PROTOCOL_VERSION: one("unsigned", 1),
            Property.PROTOCOL_REVISION: one("unsigned", 14),
            Property.PROTOCOL_SERVICES_SUPPORTED: bits(services, 40),
            Property.PROTOCOL_OBJECT_TYPES_SUPPORTED: bits([int(kind) for kind in ObjectType], 55),
            Property.OBJECT_LIST: Content(
                values=[Value(kind="object-identifier", value=list(identifier)) for identifier in listed],
                is_array=True,
            ),
            Property.MAX_APDU_LENGTH_ACCEPTED: one("unsigned", MAX_APDU),
            Property.SEGMENTATION_SUPPORTED: one("enumerated", NO_SEGMENTATION),
            Property.APDU_TIMEOUT: one("unsigned", 3000),
            Property.NUMBER_OF_APDU_RETRIES: one("unsigned", 3),
            Property.DEVICE_ADDRESS_BINDING: Content(values=[]),
            Property.DATABASE_REVISION: one("unsigned", 1),
        }

    def tick(self) -> None:
        """Advance by one second: temperatures by valve and fan, occupancy, the schedule."""
        self._seconds += 1
        valve = self.objects[ObjectType.ANALOG_OUTPUT, 1].present
        fan = self.objects[ObjectType.BINARY_OUTPUT, 1].present
        heat = _AMBIENT + 0.5 * min(max(valve, 0.0), 100.0) + (2.0 if fan else 0.0)
        self._zone += (heat - self._zone) * 0.02
        wave = math.sin(self._seconds / 10)
        self.objects[ObjectType.ANALOG_INPUT, 1].held = single(self._zone)
        self.objects[ObjectType.ANALOG_INPUT, 2].held = single(heat + wave)
        self.objects[ObjectType.BINARY_INPUT, 1].held = self._seconds // _HALF_DAY_S % 2
        self._schedule()

    def _schedule(self) -> None:
        value = _NIGHT if self._seconds // _HALF_DAY_S % 2 else _DAY
        self.objects[ObjectType.SCHEDULE, 1].held = value
        self.objects[ObjectType.ANALOG_VALUE, 2].slots[_SCHEDULE_PRIORITY - 1] = value


def single(value: float) -> float:
    """Return the value as a REAL holds it: clients must be able to read what the image says."""
    (rounded,) = struct.unpack(">f", struct.pack(">f", value))
    return float(rounded)
