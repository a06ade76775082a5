"""Handlers of the control packets of a client: the conversation rules of chapters 3 and 4, without bytes and sockets.

A packet that a client must not send at this point raises :class:`~.wire.ProtocolViolation`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pytest_otmcp.wire.mqtt.packets import (
    MQTT_5,
    Ack,
    Connack,
    Connect,
    Packet,
    PacketType,
    Pingreq,
    Pingresp,
    Publish,
    Suback,
    Subscribe,
    Unsuback,
    Unsubscribe,
)
from pytest_otmcp.wire.mqtt.primitives import ProtocolViolation
from pytest_otmcp.wire.mqtt.properties import PROTOCOL_ERROR, Property

from .broker import Broker
from .session import PACKET_IDENTIFIER_NOT_FOUND, Session

__all__ = ["Afterwards", "accept", "handle", "refusal", "supervised_keepalive"]

NO_MATCHING_SUBSCRIBERS = 0x10
NO_SUBSCRIPTION_EXISTED = 0x11
BAD_AUTHENTICATION_METHOD = 0x8C
RECEIVE_MAXIMUM_EXCEEDED = 0x93
V311_IDENTIFIER_REJECTED = 2

Afterwards = Callable[[], None] | None
"""Function that sends what has to follow the answer, or None."""


def accept(broker: Broker, connect: Connect) -> tuple[Session | None, Connack]:
    """Return the session that a CONNECT opens, None when it is refused, and the CONNACK (5: section 3.1.4 and 3.2)."""
    if Property.AUTHENTICATION_METHOD in connect.properties:
        return None, Connack(session_present=False, reason_code=BAD_AUTHENTICATION_METHOD)
    modern = connect.protocol_level == MQTT_5
    if not connect.client_id and not connect.clean_start and not modern:
        return None, Connack(session_present=False, reason_code=V311_IDENTIFIER_REJECTED)
    client_id = connect.client_id or broker.assign_client_id()
    session, present = broker.attach(connect, client_id)
    properties: dict[Property, Any] = {}
    if modern:
        limits = broker.limits
        properties[Property.RECEIVE_MAXIMUM] = limits.receive_maximum
        properties[Property.TOPIC_ALIAS_MAXIMUM] = limits.topic_alias_maximum
        properties[Property.MAXIMUM_PACKET_SIZE] = limits.maximum_packet_size
        if client_id != connect.client_id:
            properties[Property.ASSIGNED_CLIENT_IDENTIFIER] = client_id
        keepalive = supervised_keepalive(broker, connect)
        if keepalive != connect.keepalive:
            properties[Property.SERVER_KEEP_ALIVE] = keepalive
    return session, Connack(session_present=present, reason_code=0, properties=properties)


def supervised_keepalive(broker: Broker, connect: Connect) -> int:
    """Return the keep-alive in force, in seconds, 0 for none: the client's, or the broker's limit (5: section
    3.2.2.3.14)."""
    limit = broker.limits.server_keep_alive
    if limit is None or connect.protocol_level != MQTT_5:
        return connect.keepalive
    return min(connect.keepalive or limit, limit)


def handle(broker: Broker, session: Session, level: int, packet: Packet) -> tuple[Packet | None, Afterwards]:
    """Carry out what a packet of a connected client asks for.

    Returns:
        The packet's answer, if it has one, and the function that sends what has to follow.
    """
    match packet:
        case Publish():
            return _receive(broker, session, level, packet), None
        case Ack(type=PacketType.PUBREL):
            code = 0 if packet.packet_id in session.incoming else PACKET_IDENTIFIER_NOT_FOUND
            session.incoming.discard(packet.packet_id)
            return Ack(type=PacketType.PUBCOMP, packet_id=packet.packet_id, reason_code=code), None
        case Ack():
            return session.acknowledge(packet), None
        case Subscribe():
            return _subscribe(broker, session, level, packet)
        case Unsubscribe():
            existed = [broker.unsubscribe(session, one) for one in packet.filters]
            codes = tuple(0 if one else NO_SUBSCRIPTION_EXISTED for one in existed)
            return Unsuback(packet_id=packet.packet_id, reason_codes=codes), None
        case Pingreq():
            return Pingresp(), None
        case _:
            raise ProtocolViolation(f"an unexpected {packet.type.name}", PROTOCOL_ERROR)


def _receive(broker: Broker, session: Session, level: int, packet: Publish) -> Ack | None:
    if Property.SUBSCRIPTION_IDENTIFIER in packet.properties:
        raise ProtocolViolation("a subscription identifier from a client", PROTOCOL_ERROR)
    if packet.qos == 2:
        if packet.packet_id in session.incoming:
            # The message was delivered already; only the PUBREC was lost [MQTT-4.3.3-10].
            return Ack(type=PacketType.PUBREC, packet_id=packet.packet_id)
        if level == MQTT_5 and len(session.incoming) >= broker.limits.receive_maximum:
            raise ProtocolViolation("the Receive Maximum is exceeded", RECEIVE_MAXIMUM_EXCEEDED)
        session.incoming.add(packet.packet_id)
    subscribed = broker.publish(packet, session.client_id)
    if packet.qos == 0:
        return None
    kind = PacketType.PUBACK if packet.qos == 1 else PacketType.PUBREC
    code = 0 if subscribed else NO_MATCHING_SUBSCRIBERS
    return Ack(type=kind, packet_id=packet.packet_id, reason_code=code)


def _subscribe(broker: Broker, session: Session, level: int, packet: Subscribe) -> tuple[Suback, Afterwards]:
    identifier = packet.properties.get(Property.SUBSCRIPTION_IDENTIFIER)
    retained = [(request.filter, broker.subscribe(session, request, identifier, level)) for request in packet.requests]

    def afterwards() -> None:
        for topic_filter, messages in retained:
            broker.send_retained(session, topic_filter, messages)
            broker.subscribed(topic_filter)

    codes = tuple(request.qos for request in packet.requests)
    return Suback(packet_id=packet.packet_id, reason_codes=codes), afterwards


def refusal(packet: Packet, code: int) -> Packet | None:
    """Return the answer that refuses a PUBLISH, SUBSCRIBE or UNSUBSCRIBE; QoS 0 has none."""
    match packet:
        case Publish(qos=0):
            return None
        case Publish():
            kind = PacketType.PUBACK if packet.qos == 1 else PacketType.PUBREC
            return Ack(type=kind, packet_id=packet.packet_id, reason_code=code)
        case Subscribe():
            return Suback(packet_id=packet.packet_id, reason_codes=(code,) * len(packet.requests))
        case Unsubscribe():
            return Unsuback(packet_id=packet.packet_id, reason_codes=(code,) * len(packet.filters))
        case _:
            raise AssertionError(packet)
