"""Numbers of the standard with names (ASHRAE 135, clause 21): object types, properties, errors."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["ObjectType", "Property", "Refusal"]


class ObjectType(IntEnum):
    """Types of objects that the device has; the last four only when a poke adds them."""

    ANALOG_INPUT = 0
    ANALOG_OUTPUT = 1
    ANALOG_VALUE = 2
    BINARY_INPUT = 3
    BINARY_OUTPUT = 4
    BINARY_VALUE = 5
    DEVICE = 8
    SCHEDULE = 17
    MULTI_STATE_VALUE = 19
    CHARACTERSTRING_VALUE = 40
    INTEGER_VALUE = 45
    LARGE_ANALOG_VALUE = 46
    POSITIVE_INTEGER_VALUE = 48

    @property
    def text(self) -> str:
        """The name as the standard writes it, with hyphens."""
        return self.name.lower().replace("_", "-")


class Property(IntEnum):
    """Properties that objects of the device have, and the three names for several of them."""

    ALL = 8
    APDU_TIMEOUT = 11
    APPLICATION_SOFTWARE_VERSION = 12
    DESCRIPTION = 28
    DEVICE_ADDRESS_BINDING = 30
    EVENT_STATE = 36
    FIRMWARE_REVISION = 44
    MAX_APDU_LENGTH_ACCEPTED = 62
    MAX_PRES_VALUE = 65
    MIN_PRES_VALUE = 69
    MODEL_NAME = 70
    NUMBER_OF_APDU_RETRIES = 73
    NUMBER_OF_STATES = 74
    OBJECT_IDENTIFIER = 75
    OBJECT_LIST = 76
    OBJECT_NAME = 77
    OBJECT_TYPE = 79
    OPTIONAL = 80
    OUT_OF_SERVICE = 81
    POLARITY = 84
    PRESENT_VALUE = 85
    PRIORITY_ARRAY = 87
    PRIORITY_FOR_WRITING = 88
    PROTOCOL_OBJECT_TYPES_SUPPORTED = 96
    PROTOCOL_SERVICES_SUPPORTED = 97
    PROTOCOL_VERSION = 98
    RELIABILITY = 103
    RELINQUISH_DEFAULT = 104
    REQUIRED = 105
    SEGMENTATION_SUPPORTED = 107
    STATE_TEXT = 110
    STATUS_FLAGS = 111
    SYSTEM_STATUS = 112
    UNITS = 117
    VENDOR_IDENTIFIER = 120
    VENDOR_NAME = 121
    PROTOCOL_REVISION = 139
    DATABASE_REVISION = 155
    PROPERTY_LIST = 371


class Refusal(Exception):
    """The request is answered with an Error PDU: error class and error code (clause 18)."""

    def __init__(self, error_class: int, error_code: int) -> None:
        super().__init__(error_class, error_code)
        self.error = (error_class, error_code)


UNKNOWN_OBJECT = (1, 31)
UNKNOWN_PROPERTY = (2, 32)
INVALID_DATATYPE = (2, 9)
VALUE_OUT_OF_RANGE = (2, 37)
WRITE_ACCESS_DENIED = (2, 40)
INVALID_ARRAY_INDEX = (2, 42)
NOT_AN_ARRAY = (2, 50)
