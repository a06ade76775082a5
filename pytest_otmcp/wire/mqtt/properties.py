"""The properties of MQTT 5 (section 2.2.2): which exist, of which type, in which packet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from .primitives import ProtocolViolation, Reader, binary, string, uint16, uint32, varint

__all__ = ["EMPTY", "Place", "Properties", "Property", "decode", "encode"]

PROTOCOL_ERROR = 0x82


class Property(IntEnum):
    """Property identifiers (table 2-4)."""

    PAYLOAD_FORMAT_INDICATOR = 1
    MESSAGE_EXPIRY_INTERVAL = 2
    CONTENT_TYPE = 3
    RESPONSE_TOPIC = 8
    CORRELATION_DATA = 9
    SUBSCRIPTION_IDENTIFIER = 11
    SESSION_EXPIRY_INTERVAL = 17
    ASSIGNED_CLIENT_IDENTIFIER = 18
    SERVER_KEEP_ALIVE = 19
    AUTHENTICATION_METHOD = 21
    AUTHENTICATION_DATA = 22
    REQUEST_PROBLEM_INFORMATION = 23
    WILL_DELAY_INTERVAL = 24
    REQUEST_RESPONSE_INFORMATION = 25
    RESPONSE_INFORMATION = 26
    SERVER_REFERENCE = 28
    REASON_STRING = 31
    RECEIVE_MAXIMUM = 33
    TOPIC_ALIAS_MAXIMUM = 34
    TOPIC_ALIAS = 35
    MAXIMUM_QOS = 36
    RETAIN_AVAILABLE = 37
    USER_PROPERTY = 38
    MAXIMUM_PACKET_SIZE = 39
    WILDCARD_SUBSCRIPTION_AVAILABLE = 40
    SUBSCRIPTION_IDENTIFIER_AVAILABLE = 41
    SHARED_SUBSCRIPTION_AVAILABLE = 42


Properties = Mapping[Property, Any]
"""Values by property; lists for the two that may occur several times."""

EMPTY: Properties = {}


class Place(IntEnum):
    """The place of properties: the number of the packet type, 0 for the will in a CONNECT."""

    WILL = 0
    CONNECT = 1
    CONNACK = 2
    PUBLISH = 3
    PUBACK = 4
    PUBREC = 5
    PUBREL = 6
    PUBCOMP = 7
    SUBSCRIBE = 8
    SUBACK = 9
    UNSUBSCRIBE = 10
    UNSUBACK = 11
    DISCONNECT = 14
    AUTH = 15


@dataclass(frozen=True, slots=True)
class _Type:
    read: Callable[[Reader], Any]
    write: Callable[[Any], bytes]


def _read_pair(reader: Reader) -> tuple[str, str]:
    return reader.string(), reader.string()


def _write_pair(pair: tuple[str, str]) -> bytes:
    return string(pair[0]) + string(pair[1])


def _write_byte(value: int) -> bytes:
    return bytes((value,))


_BYTE = _Type(Reader.byte, _write_byte)
_UINT16 = _Type(Reader.uint16, uint16)
_UINT32 = _Type(Reader.uint32, uint32)
_VARINT = _Type(Reader.varint, varint)
_STRING = _Type(Reader.string, string)
_BINARY = _Type(Reader.binary, binary)
_PAIR = _Type(_read_pair, _write_pair)

_MESSAGE = {Place.PUBLISH, Place.WILL}
_AUTHENTICATION = {Place.CONNECT, Place.CONNACK, Place.AUTH}
_ACKS = {Place.PUBACK, Place.PUBREC, Place.PUBREL, Place.PUBCOMP, Place.SUBACK, Place.UNSUBACK}

_TABLE: dict[Property, tuple[_Type, set[Place]]] = {
    Property.PAYLOAD_FORMAT_INDICATOR: (_BYTE, _MESSAGE),
    Property.MESSAGE_EXPIRY_INTERVAL: (_UINT32, _MESSAGE),
    Property.CONTENT_TYPE: (_STRING, _MESSAGE),
    Property.RESPONSE_TOPIC: (_STRING, _MESSAGE),
    Property.CORRELATION_DATA: (_BINARY, _MESSAGE),
    Property.SUBSCRIPTION_IDENTIFIER: (_VARINT, {Place.PUBLISH, Place.SUBSCRIBE}),
    Property.SESSION_EXPIRY_INTERVAL: (_UINT32, {Place.CONNECT, Place.CONNACK, Place.DISCONNECT}),
    Property.ASSIGNED_CLIENT_IDENTIFIER: (_STRING, {Place.CONNACK}),
    Property.SERVER_KEEP_ALIVE: (_UINT16, {Place.CONNACK}),
    Property.AUTHENTICATION_METHOD: (_STRING, _AUTHENTICATION),
    Property.AUTHENTICATION_DATA: (_BINARY, _AUTHENTICATION),
    Property.REQUEST_PROBLEM_INFORMATION: (_BYTE, {Place.CONNECT}),
    Property.WILL_DELAY_INTERVAL: (_UINT32, {Place.WILL}),
    Property.REQUEST_RESPONSE_INFORMATION: (_BYTE, {Place.CONNECT}),
    Property.RESPONSE_INFORMATION: (_STRING, {Place.CONNACK}),
    Property.SERVER_REFERENCE: (_STRING, {Place.CONNACK, Place.DISCONNECT}),
    Property.REASON_STRING: (_STRING, {Place.CONNACK, Place.DISCONNECT, Place.AUTH} | _ACKS),
    Property.RECEIVE_MAXIMUM: (_UINT16, {Place.CONNECT, Place.CONNACK}),
    Property.TOPIC_ALIAS_MAXIMUM: (_UINT16, {Place.CONNECT, Place.CONNACK}),
    Property.TOPIC_ALIAS: (_UINT16, {Place.PUBLISH}),
    Property.MAXIMUM_QOS: (_BYTE, {Place.CONNACK}),
    Property.RETAIN_AVAILABLE: (_BYTE, {Place.CONNACK}),
    Property.USER_PROPERTY: (_PAIR, set(Place)),
    Property.MAXIMUM_PACKET_SIZE: (_UINT32, {Place.CONNECT, Place.CONNACK}),
    Property.WILDCARD_SUBSCRIPTION_AVAILABLE: (_BYTE, {Place.CONNACK}),
    Property.SUBSCRIPTION_IDENTIFIER_AVAILABLE: (_BYTE, {Place.CONNACK}),
    Property.SHARED_SUBSCRIPTION_AVAILABLE: (_BYTE, {Place.CONNACK}),
}

_NOT_ZERO = {Property.SUBSCRIPTION_IDENTIFIER, Property.RECEIVE_MAXIMUM, Property.MAXIMUM_PACKET_SIZE}


def decode(reader: Reader, place: Place) -> Properties:
    """Read the property length and the properties.

    Raises:
        ProtocolViolation: a property is unknown, does not belong here, occurs twice, or has a value that its section
            excludes.
    """
    length = reader.varint()
    if length == 0:
        return EMPTY
    inner = Reader(reader.take(length))
    found: dict[Property, Any] = {}
    while inner.left:
        number = inner.varint()
        try:
            name = Property(number)
        except ValueError:
            raise ProtocolViolation(f"unknown property {number}") from None
        kind, places = _TABLE[name]
        if place not in places:
            raise ProtocolViolation(f"the property {name.name} does not belong into {place.name}")
        value = kind.read(inner)
        if (kind is _BYTE and value > 1) or (value == 0 and name in _NOT_ZERO):
            raise ProtocolViolation(f"the property {name.name} must not be {value}", PROTOCOL_ERROR)
        if name is Property.USER_PROPERTY or (name is Property.SUBSCRIPTION_IDENTIFIER and place is Place.PUBLISH):
            found.setdefault(name, []).append(value)
        elif name in found:
            raise ProtocolViolation(f"the property {name.name} occurs twice", PROTOCOL_ERROR)
        else:
            found[name] = value
    return found


def encode(properties: Properties) -> bytes:
    """Return the bytes of the property length and of the properties."""
    if not properties:
        return b"\0"
    parts: list[bytes] = []
    for name, value in properties.items():
        write = _TABLE[name][0].write
        parts += [varint(name) + write(one) for one in (value if isinstance(value, list) else [value])]
    encoded = b"".join(parts)
    return varint(len(encoded)) + encoded
