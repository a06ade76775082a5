"""The fields of a control packet in the journal: JSON-safe, payloads as base64, never a password.

==================  =====================================================================================
PUBLISH             topic, payload, qos, retain, dup, packet_id (null at QoS 0); below ``spBv1.0/`` also
                    ``sparkplug``; ``will_sent: true`` on the copies of a will
CONNECT             protocol_level, clean_start, keepalive, username, will (as PUBLISH, or null)
CONNACK             session_present, reason_codes
SUBSCRIBE           packet_id, filters: ``[{"filter", "qos"}]``
UNSUBSCRIBE         packet_id, filters: ``[{"filter"}]``
SUBACK, UNSUBACK    packet_id, reason_codes
PUBACK … PUBCOMP    packet_id, reason_codes
DISCONNECT, AUTH    reason_codes
any of MQTT 5       properties, if there are any
==================  =====================================================================================

Topics are complete, also where the wire had an alias. Not packets: CONNECTED, DISCONNECTED (reason), malformed (bytes
as hex, reason), WILL (a will fired, with or without a receiver).

The fields that entries of all protocols share (``journal.JournalEntry``) mean here:

``request``         a packet to which the broker has to give an answer of its own (CONNECT, SUBSCRIBE, UNSUBSCRIBE,
                    PINGREQ, PUBREL) or a PUBLISH of any QoS, received from a client from outside. An adapter's tools
                    may be about the broker itself, so session packets count here, as they do not for OPC UA.
``state_changing``  a PUBLISH received from a client from outside: any device may be subscribed to it
``answers``         CONNACK to CONNECT, SUBACK to SUBSCRIBE, UNSUBACK to UNSUBSCRIBE, PUBACK or PUBREC to PUBLISH,
                    PUBCOMP to PUBREL, PINGRESP to PINGREQ. A PUBLISH to a subscriber and its PUBREL answer nothing.
``origin``          ``plant`` for the connections of the simulated edge node, ``kit`` for a poke (connection 0)
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

from . import properties as props
from .packets import (
    Ack,
    Auth,
    Connack,
    Connect,
    Disconnect,
    Packet,
    PacketType,
    Publish,
    Suback,
    Subscribe,
    Unsuback,
    Unsubscribe,
)
from .sparkplug import decode_message

__all__ = ["REQUESTS", "describe", "describe_content", "describe_publish"]

REQUESTS = frozenset(
    {
        PacketType.CONNECT,
        PacketType.PUBLISH,
        PacketType.PUBREL,
        PacketType.SUBSCRIBE,
        PacketType.UNSUBSCRIBE,
        PacketType.PINGREQ,
    }
)
"""Packets with which a client asks the broker for something, see above."""


def describe_content(topic: str, payload: bytes) -> dict[str, Any]:
    """Return topic and payload of a message; of a Sparkplug message also its decoded content.

    A host's STATE is JSON, not a Sparkplug payload (Sparkplug 3.0, section 6.4.27).
    """
    # A poke may publish on a topic that is no UTF-8; JSON can show it with its bytes escaped only.
    shown = topic.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    content: dict[str, Any] = {"topic": shown, "payload": base64.b64encode(payload).decode()}
    if topic.startswith("spBv1.0/") and not topic.startswith("spBv1.0/STATE/"):
        content["sparkplug"] = decode_message(topic, payload)
    return content


def describe_publish(packet: Publish, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a PUBLISH whose content was described before: all its receivers share that description."""
    fields = {
        **content,
        "qos": packet.qos,
        "retain": packet.retain,
        "dup": packet.dup,
        "packet_id": packet.packet_id or None,
    }
    if packet.properties:
        fields["properties"] = props.describe(packet.properties)
    return fields


def describe(packet: Packet) -> dict[str, Any]:
    """Return the fields of any control packet."""
    if isinstance(packet, Publish):
        return describe_publish(packet, describe_content(packet.topic, packet.payload))
    fields = _fields(packet)
    properties = getattr(packet, "properties", None)
    if properties:
        fields["properties"] = props.describe(properties)
    return fields


def _fields(packet: Packet) -> dict[str, Any]:
    match packet:
        case Connect():
            return {
                "protocol_level": packet.protocol_level,
                "clean_start": packet.clean_start,
                "keepalive": packet.keepalive,
                "username": packet.username,
                "will": None
                if packet.will is None
                else {
                    **describe_content(packet.will.topic, packet.will.payload),
                    "qos": packet.will.qos,
                    "retain": packet.will.retain,
                    "properties": props.describe(packet.will.properties),
                },
            }
        case Connack():
            return {"session_present": packet.session_present, "reason_codes": [packet.reason_code]}
        case Ack():
            return {"packet_id": packet.packet_id, "reason_codes": [packet.reason_code]}
        case Subscribe():
            filters = [{"filter": one.filter, "qos": one.qos} for one in packet.requests]
            return {"packet_id": packet.packet_id, "filters": filters}
        case Unsubscribe():
            return {"packet_id": packet.packet_id, "filters": [{"filter": one} for one in packet.filters]}
        case Suback() | Unsuback():
            return {"packet_id": packet.packet_id, "reason_codes": list(packet.reason_codes)}
        case Disconnect() | Auth():
            return {"reason_codes": [packet.reason_code]}
        case _:
            return {}
