"""The codec: control packets from and to bytes, for MQTT 3.1.1 and 5 (chapters 2 and 3 of both).

Decoding is strict: a packet that the specification calls malformed raises :class:`~.primitives.ProtocolViolation`. This
module does not decide whether a well-formed packet is allowed at this point of a conversation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

from . import properties as props
from .packets import (
    MQTT_5,
    MQTT_311,
    Ack,
    Auth,
    Connack,
    Connect,
    Disconnect,
    Packet,
    PacketType,
    Pingreq,
    Pingresp,
    Publish,
    Suback,
    Subscribe,
    SubscriptionRequest,
    Unsuback,
    Unsubscribe,
    Will,
)
from .primitives import MALFORMED_PACKET, ProtocolViolation, Reader, binary, string, uint16, varint
from .properties import EMPTY, PROTOCOL_ERROR, Place, Properties, Property
from .topics import check_filter, check_name, split_shared

__all__ = ["UnsupportedProtocol", "decode", "encode"]

MQTT_31 = 3
UNSUPPORTED_PROTOCOL_VERSION = 0x84

_FLAGS = {PacketType.PUBREL: 2, PacketType.SUBSCRIBE: 2, PacketType.UNSUBSCRIBE: 2}
_DATA_REFUSALS = {0x80, 0x83, 0x87, 0x90, 0x91, 0x97, 0x99}
_REASON_CODES = {
    PacketType.PUBACK: {0x00, 0x10} | _DATA_REFUSALS,
    PacketType.PUBREC: {0x00, 0x10} | _DATA_REFUSALS,
    PacketType.PUBREL: {0x00, 0x92},
    PacketType.PUBCOMP: {0x00, 0x92},
    PacketType.DISCONNECT: {
        0x00,
        0x04,
        *range(0x80, 0x84),
        0x87,
        0x89,
        0x8B,
        *range(0x8D, 0x91),
        *range(0x93, 0xA3),
    },
    PacketType.AUTH: {0x00, 0x18, 0x19},
}


class UnsupportedProtocol(ProtocolViolation):
    """The client sent a CONNECT of another protocol version, which is answered with a CONNACK [MQTT-3.1.2-2]."""

    def __init__(self, level: int) -> None:
        super().__init__(f"protocol level {level} is not supported", UNSUPPORTED_PROTOCOL_VERSION)


def _malformed(reason: str) -> NoReturn:
    raise ProtocolViolation(reason, MALFORMED_PACKET)


def decode(first: int, body: bytes, level: int, *, lenient: bool = False) -> Packet:
    """Return the packet with this first byte of the fixed header and this body.

    Args:
        level: protocol level of the connection, 3 to 5; a CONNECT has its own level.
        lenient: accept a PUBLISH with an illegal topic, and show it.

    Raises:
        ProtocolViolation: the packet is malformed.
    """
    number = first >> 4
    if number == 0 or (number == PacketType.AUTH and level != MQTT_5):
        _malformed(f"packet type {number} does not exist")
    kind = PacketType(number)
    reader = Reader(body, lenient=lenient and kind is PacketType.PUBLISH)
    packet: Packet
    if kind is PacketType.PUBLISH:
        return _publish(first & 0x0F, reader, level)
    if first & 0x0F != _FLAGS.get(kind, 0):
        _malformed(f"{kind.name} has the flags {first & 0x0F:04b}")
    if kind in (PacketType.PUBACK, PacketType.PUBREC, PacketType.PUBREL, PacketType.PUBCOMP):
        packet_id = _packet_id(reader)
        reason_code, properties = _reason(kind, reader, level)
        packet = Ack(type=kind, packet_id=packet_id, reason_code=reason_code, properties=properties)
    elif kind is PacketType.DISCONNECT:
        reason_code, properties = _reason(kind, reader, level)
        packet = Disconnect(reason_code=reason_code, properties=properties)
    elif kind is PacketType.AUTH:
        reason_code, properties = _reason(kind, reader, level)
        packet = Auth(reason_code=reason_code, properties=properties)
    else:
        packet = _DECODERS[kind](reader, level)
    reader.finish()
    return packet


def _packet_id(reader: Reader) -> int:
    return reader.uint16() or _malformed("the packet identifier is 0")


def _reason(kind: PacketType, reader: Reader, level: int) -> tuple[int, Properties]:
    """Return reason code and properties, which may be cut short in MQTT 5 and do not exist in 3.1.1."""
    if level != MQTT_5 or not reader.left:
        return 0, EMPTY
    code = reader.byte()
    if code not in _REASON_CODES[kind]:
        _malformed(f"{kind.name} has no reason code 0x{code:02X}")
    return code, props.decode(reader, Place(kind)) if reader.left else EMPTY


def _properties(reader: Reader, level: int, place: Place) -> Properties:
    return props.decode(reader, place) if level == MQTT_5 else EMPTY


def _check_message(properties: Properties) -> None:
    response_topic = properties.get(Property.RESPONSE_TOPIC)
    if response_topic is not None:
        check_name(response_topic)


def _connect(reader: Reader, level: int) -> Connect:
    name = reader.binary()
    if name not in (b"MQTT", b"MQIsdp"):
        _malformed("the protocol name is not MQTT")
    level = reader.byte()
    if (name, level) not in ((b"MQIsdp", MQTT_31), (b"MQTT", MQTT_311), (b"MQTT", MQTT_5)):
        raise UnsupportedProtocol(level)
    flags = reader.byte()
    has_will, will_qos, will_retain = bool(flags & 4), flags >> 3 & 3, bool(flags & 0x20)
    has_password, has_username = bool(flags & 0x40), bool(flags & 0x80)
    if flags & 1:
        _malformed("the reserved CONNECT flag is set")
    if will_qos == 3 or (not has_will and (will_qos or will_retain)):
        _malformed("the will flags contradict each other")
    if has_password and not has_username and level != MQTT_5:
        _malformed("a password without a user name")
    keepalive = reader.uint16()
    properties = _properties(reader, level, Place.CONNECT)
    client_id = reader.string()
    will = None
    if has_will:
        will_properties = _properties(reader, level, Place.WILL)
        topic = reader.string()
        check_name(topic)
        _check_message(will_properties)
        payload = reader.binary()
        will = Will(topic=topic, payload=payload, qos=will_qos, retain=will_retain, properties=will_properties)
    username = reader.string() if has_username else None
    password = reader.binary() if has_password else None
    return Connect(
        protocol_level=level,
        clean_start=bool(flags & 2),
        keepalive=keepalive,
        client_id=client_id,
        will=will,
        username=username,
        password=password,
        properties=properties,
    )


def _connack(reader: Reader, level: int) -> Connack:
    flags, code = reader.byte(), reader.byte()
    if flags > 1:
        _malformed("a reserved CONNACK flag is set")
    properties = _properties(reader, level, Place.CONNACK)
    return Connack(session_present=bool(flags), reason_code=code, properties=properties)


def _publish(flags: int, reader: Reader, level: int) -> Publish:
    qos, dup = flags >> 1 & 3, bool(flags & 8)
    if qos == 3:
        _malformed("PUBLISH with QoS 3")
    if dup and not qos:
        _malformed("PUBLISH with DUP at QoS 0")
    topic = reader.string()
    packet_id = _packet_id(reader) if qos else 0
    properties = _properties(reader, level, Place.PUBLISH)
    if not topic and level == MQTT_5:
        if Property.TOPIC_ALIAS not in properties:
            raise ProtocolViolation("neither topic name nor topic alias", PROTOCOL_ERROR)
    elif not reader.lenient:
        check_name(topic)
    if not reader.lenient:
        _check_message(properties)
    return Publish(
        topic=topic,
        payload=reader.rest(),
        qos=qos,
        retain=bool(flags & 1),
        dup=dup,
        packet_id=packet_id,
        properties=properties,
    )


def _subscribe(reader: Reader, level: int) -> Subscribe:
    packet_id = _packet_id(reader)
    properties = _properties(reader, level, Place.SUBSCRIBE)
    requests = [_request(reader, level)]
    while reader.left:
        requests.append(_request(reader, level))
    return Subscribe(packet_id=packet_id, requests=tuple(requests), properties=properties)


def _filter(reader: Reader, level: int) -> tuple[str, bool]:
    """Return a topic filter, and whether it is a shared subscription; 3.1.1 has none."""
    topic_filter = reader.string()
    share, proper = split_shared(topic_filter) if level == MQTT_5 else (None, topic_filter)
    check_filter(proper)
    return topic_filter, share is not None


def _request(reader: Reader, level: int) -> SubscriptionRequest:
    topic_filter, shared = _filter(reader, level)
    options = reader.byte()
    if options & (0xC0 if level == MQTT_5 else 0xFC):
        _malformed(f"the subscription options have reserved bits set: {options:08b}")
    if options & 3 == 3:
        _malformed("SUBSCRIBE with QoS 3")
    if options >> 4 == 3:
        raise ProtocolViolation("SUBSCRIBE with retain handling 3", PROTOCOL_ERROR)
    no_local = bool(options & 4)
    if no_local and shared:
        raise ProtocolViolation("No Local on a shared subscription", PROTOCOL_ERROR)
    return SubscriptionRequest(
        filter=topic_filter,
        qos=options & 3,
        no_local=no_local,
        retain_as_published=bool(options & 8),
        retain_handling=options >> 4,
    )


def _suback(reader: Reader, level: int) -> Suback:
    packet_id = _packet_id(reader)
    properties = _properties(reader, level, Place.SUBACK)
    return Suback(packet_id=packet_id, reason_codes=tuple(reader.rest()), properties=properties)


def _unsubscribe(reader: Reader, level: int) -> Unsubscribe:
    packet_id = _packet_id(reader)
    properties = _properties(reader, level, Place.UNSUBSCRIBE)
    filters = [_filter(reader, level)[0]]
    while reader.left:
        filters.append(_filter(reader, level)[0])
    return Unsubscribe(packet_id=packet_id, filters=tuple(filters), properties=properties)


def _unsuback(reader: Reader, level: int) -> Unsuback:
    packet_id = _packet_id(reader)
    properties = _properties(reader, level, Place.UNSUBACK)
    codes = tuple(reader.rest()) if level == MQTT_5 else ()
    return Unsuback(packet_id=packet_id, reason_codes=codes, properties=properties)


_DECODERS: dict[PacketType, Callable[[Reader, int], Packet]] = {
    PacketType.CONNECT: _connect,
    PacketType.CONNACK: _connack,
    PacketType.SUBSCRIBE: _subscribe,
    PacketType.SUBACK: _suback,
    PacketType.UNSUBSCRIBE: _unsubscribe,
    PacketType.UNSUBACK: _unsuback,
    PacketType.PINGREQ: lambda reader, level: Pingreq(),
    PacketType.PINGRESP: lambda reader, level: Pingresp(),
}


def encode(packet: Packet, level: int) -> bytes:
    """Return the bytes of a packet.

    Args:
        level: protocol level of the connection, 4 or 5; a CONNECT has its own level.
    """
    if isinstance(packet, Publish):
        flags = packet.dup << 3 | packet.qos << 1 | packet.retain
        head = string(packet.topic) + (uint16(packet.packet_id) if packet.qos else b"")
        body = head + _encoded(packet.properties, level) + packet.payload
    else:
        flags = _FLAGS.get(packet.type, 0)
        body = _body(packet, level)
    return bytes((packet.type << 4 | flags,)) + varint(len(body)) + body


def _encoded(properties: Properties, level: int) -> bytes:
    return props.encode(properties) if level == MQTT_5 else b""


def _body(packet: Packet, level: int) -> bytes:
    match packet:
        case Connect():
            return _connect_body(packet)
        case Connack():
            head = bytes((packet.session_present, packet.reason_code))
            return head + _encoded(packet.properties, level)
        case Ack():
            return uint16(packet.packet_id) + _reason_tail(packet.reason_code, packet.properties, level)
        case Disconnect() | Auth():
            return _reason_tail(packet.reason_code, packet.properties, level)
        case Subscribe():
            options = b"".join(
                string(one.filter)
                + bytes((one.retain_handling << 4 | one.retain_as_published << 3 | one.no_local << 2 | one.qos,))
                for one in packet.requests
            )
            return uint16(packet.packet_id) + _encoded(packet.properties, level) + options
        case Unsubscribe():
            filters = b"".join(map(string, packet.filters))
            return uint16(packet.packet_id) + _encoded(packet.properties, level) + filters
        case Suback():
            return uint16(packet.packet_id) + _encoded(packet.properties, level) + bytes(packet.reason_codes)
        case Unsuback():
            codes = bytes(packet.reason_codes) if level == MQTT_5 else b""
            return uint16(packet.packet_id) + _encoded(packet.properties, level) + codes
        case _:
            return b""


def _reason_tail(code: int, properties: Properties, level: int) -> bytes:
    if level != MQTT_5 or (code == 0 and not properties):
        return b""
    return bytes((code,)) + (props.encode(properties) if properties else b"")


def _connect_body(packet: Connect) -> bytes:
    level, will = packet.protocol_level, packet.will
    flags = packet.clean_start << 1 | (packet.password is not None) << 6 | (packet.username is not None) << 7
    tail = string(packet.client_id)
    if will is not None:
        flags |= 4 | will.qos << 3 | will.retain << 5
        tail += _encoded(will.properties, level) + string(will.topic) + binary(will.payload)
    if packet.username is not None:
        tail += string(packet.username)
    if packet.password is not None:
        tail += binary(packet.password)
    head = string("MQIsdp" if level == MQTT_31 else "MQTT") + bytes((level, flags)) + uint16(packet.keepalive)
    return head + _encoded(packet.properties, level) + tail
