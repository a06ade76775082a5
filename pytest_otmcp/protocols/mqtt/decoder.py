"""Decoder of MQTT 3.1.1 and 5 for recorded packets; :mod:`pytest_otmcp.wire.mqtt` says what their bytes mean.

Each packet becomes one message; payloads as base64, never a password. A packet that cannot be read becomes a malformed message.

Requests are the packets of a client that the broker itself has to answer (CONNECT, SUBSCRIBE, UNSUBSCRIBE, PINGREQ, PUBREL),
and PUBLISH of any QoS. A PUBLISH of a client may change the plant: anything may subscribe to it.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ...wire.framing import MalformedError
from ...wire.mqtt.codec import decode, encode
from ...wire.mqtt.packets import (
    MQTT_311,
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
    Will,
)
from ...wire.mqtt.properties import Property
from ...wire.mqtt.sparkplug import message_fields
from ..conversation import Direction, Message, Outstanding

__all__ = ["MqttConversation"]

_KINDS = ("RESERVED", *PacketType.__members__)
_ANSWERS = {
    "CONNACK": "CONNECT",
    "PUBACK": "PUBLISH",
    "PUBREC": "PUBLISH",
    "PUBCOMP": "PUBREL",
    "SUBACK": "SUBSCRIBE",
    "UNSUBACK": "UNSUBSCRIBE",
    "PINGRESP": "PINGREQ",
}
"""Answers of a broker, each with the kind of packet that it answers; a packet identifier, where it has one, says which."""
_REQUESTS = frozenset(_ANSWERS.values())
"""Packets with which a client asks the broker for something."""

_CREDENTIALS = frozenset({Property.AUTHENTICATION_DATA})


class MqttConversation:
    """One connection; its protocol level and client identifier are known once CONNECT has been seen."""

    def __init__(self) -> None:
        self.client_id: str | None = None
        self._level = MQTT_311
        self._aliases: dict[tuple[Direction, int], str] = {}
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; the kind is the packet's name."""
        kind = _KINDS[frame[0] >> 4]
        header = next(index for index, byte in enumerate(frame[1:], start=2) if not byte & 0x80)
        try:
            # An illegal topic of a broker's message is told; a client's makes it no message.
            packet = decode(frame[0], frame[header:], self._level, lenient=direction == "out")
        except MalformedError as error:
            # A CONNECT or AUTH may hold a credential.
            shown = frame[:1] if kind in ("CONNECT", "AUTH") else frame
            malformed = {"client_id": self.client_id, "reason": str(error), "bytes": shown.hex()}
            return [Message(direction=direction, kind="malformed", fields=malformed)]
        if isinstance(packet, Connect):
            self._level, self.client_id = packet.protocol_level, packet.client_id
        fields = self._fields(direction, packet)
        # An assigned identifier (MQTT 5, section 3.2.2.3.7) is known from CONNACK on.
        self.client_id = fields.get("properties", {}).get("assigned_client_identifier") or self.client_id
        message = self._message(direction, kind, {"client_id": self.client_id, **fields})
        message.frames = self._without_credentials(packet)
        if not self.client_id:
            # A broker that gives a client of 3.1.1 its identifier tells nobody (section 3.1.3.1).
            message.unsure = ("client_id",)
        return [message]

    def _without_credentials(self, packet: Packet) -> tuple[bytes, ...]:
        """Return the packet as it is kept, where it may hold a credential."""
        if not isinstance(packet, Connect | Connack | Auth):
            return ()
        if isinstance(packet, Connect):
            packet = replace(packet, password=None)
        open_ones = {name: value for name, value in packet.properties.items() if name not in _CREDENTIALS}
        return (encode(replace(packet, properties=open_ones), self._level),)

    def _fields(self, direction: Direction, packet: Packet) -> dict[str, Any]:
        if not isinstance(packet, Publish):
            return _said(packet) | _properties(packet)
        topic, alias = packet.topic, packet.properties.get(Property.TOPIC_ALIAS)
        if alias is not None and topic:
            self._aliases[direction, alias] = topic
        elif alias is not None:
            topic = self._aliases.get((direction, alias), "")
        return {
            "topic": topic,
            **message_fields(topic, packet.payload),
            "qos": packet.qos,
            "retain": packet.retain,
            "dup": packet.dup,
            "packet_id": packet.packet_id or None,
            **_properties(packet),
        }

    def _message(self, direction: Direction, kind: str, fields: dict[str, object]) -> Message:
        packet_id = fields.get("packet_id")
        if direction == "out":
            asked = self._outstanding.take((_ANSWERS[kind], packet_id)) if kind in _ANSWERS else None
            return Message(direction="out", kind=kind, fields=fields, answers=asked)
        message = Message(
            direction="in",
            kind=kind,
            fields=fields,
            request=kind in _REQUESTS,
            state_changing=kind == "PUBLISH",
        )
        if kind in _REQUESTS and fields.get("qos") != 0:
            self._outstanding.add((kind, packet_id), message)
        return message


def _properties(source: Packet | Will) -> dict[str, Any]:
    """Return the properties by name, JSON-safe; a credential must never be in a journal."""
    given: Mapping[Property, Any] = getattr(source, "properties", {})
    shown = {
        name.name.lower(): base64.b64encode(value).decode() if isinstance(value, bytes) else _listed(value)
        for name, value in given.items()
        if name not in _CREDENTIALS
    }
    return {"properties": shown} if shown else {}


def _listed(value: Any) -> Any:
    return list(map(_listed, value)) if isinstance(value, list | tuple) else value


def _will(will: Will) -> dict[str, Any]:
    content = message_fields(will.topic, will.payload)
    return {"topic": will.topic, **content, "qos": will.qos, "retain": will.retain, **_properties(will)}


def _said(packet: Packet) -> dict[str, Any]:
    """Return what a packet says beside its properties."""
    match packet:
        case Connect():
            return {
                "protocol_level": packet.protocol_level,
                "clean_start": packet.clean_start,
                "keepalive": packet.keepalive,
                "username": packet.username,
                "will": None if packet.will is None else _will(packet.will),
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
