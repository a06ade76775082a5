"""Decoder of MQTT 3.1.1 and 5 for recorded bytes, written from the specifications alone.

OASIS MQTT 3.1.1 and MQTT 5.0, chapters 1.5 (data representation), 2 (control packet format) and 3 (packets). Each packet
becomes one message; payloads as base64, never a password. The reader is strict where a reserved bit or a length decides
what the rest means; a packet that it cannot read becomes a malformed message.

Requests are the packets of a client that the broker itself has to answer (CONNECT, SUBSCRIBE, UNSUBSCRIBE, PINGREQ, PUBREL),
and PUBLISH of any QoS. A PUBLISH of a client may change the plant: anything may subscribe to it.
"""

from __future__ import annotations

import base64
from typing import Any

from ...wire.framing import MalformedError
from ...wire.mqtt.sparkplug import message_fields
from ..conversation import Direction, Message, Outstanding

__all__ = ["ANSWERS", "KINDS", "REQUESTS", "MqttConversation", "packet_length"]

KINDS = (
    *("RESERVED", "CONNECT", "CONNACK", "PUBLISH", "PUBACK", "PUBREC", "PUBREL", "PUBCOMP", "SUBSCRIBE", "SUBACK"),
    *("UNSUBSCRIBE", "UNSUBACK", "PINGREQ", "PINGRESP", "DISCONNECT", "AUTH"),
)
_ACKNOWLEDGEMENTS = frozenset({"PUBACK", "PUBREC", "PUBREL", "PUBCOMP"})
ANSWERS = {
    "CONNACK": "CONNECT",
    "PUBACK": "PUBLISH",
    "PUBREC": "PUBLISH",
    "PUBCOMP": "PUBREL",
    "SUBACK": "SUBSCRIBE",
    "UNSUBACK": "UNSUBSCRIBE",
    "PINGRESP": "PINGREQ",
}
"""Answers of a broker, each with the kind of packet that it answers; a packet identifier, where it has one, says which."""
REQUESTS = frozenset(ANSWERS.values())
"""Packets with which a client asks the broker for something."""
_FLAGS_2 = frozenset({"PUBREL", "SUBSCRIBE", "UNSUBSCRIBE"})
MQTT_5 = 5

# MQTT 5, section 2.2.2.2: property identifier to name and type. 1, 2, 4: integers of that many bytes; v: variable byte
# integer; s: string; b: binary data; p: pair of strings.
_PROPERTIES = {
    1: ("payload_format_indicator", "1"),
    2: ("message_expiry_interval", "4"),
    3: ("content_type", "s"),
    8: ("response_topic", "s"),
    9: ("correlation_data", "b"),
    11: ("subscription_identifier", "v"),
    17: ("session_expiry_interval", "4"),
    18: ("assigned_client_identifier", "s"),
    19: ("server_keep_alive", "2"),
    21: ("authentication_method", "s"),
    22: ("authentication_data", "b"),
    23: ("request_problem_information", "1"),
    24: ("will_delay_interval", "4"),
    25: ("request_response_information", "1"),
    26: ("response_information", "s"),
    28: ("server_reference", "s"),
    31: ("reason_string", "s"),
    33: ("receive_maximum", "2"),
    34: ("topic_alias_maximum", "2"),
    35: ("topic_alias", "2"),
    36: ("maximum_qos", "1"),
    37: ("retain_available", "1"),
    38: ("user_property", "p"),
    39: ("maximum_packet_size", "4"),
    40: ("wildcard_subscription_available", "1"),
    41: ("subscription_identifier_available", "1"),
    42: ("shared_subscription_available", "1"),
}
_REPEATABLE = frozenset({"user_property", "subscription_identifier"})


def packet_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the control packet at the beginning of the buffer (section 2.2.3: Remaining Length).

    Raises:
        MalformedError: packet type 0, or a Remaining Length of more than four bytes.
    """
    length = 0
    for index, byte in enumerate(buffer[1:5]):
        length |= (byte & 0x7F) << (7 * index)
        if not byte & 0x80:
            if buffer[0] >> 4 == 0:
                raise MalformedError("packet type 0 is reserved")
            return 2 + index + length
    if len(buffer) >= 5:
        raise MalformedError("the Remaining Length has more than four bytes")
    return None


class _Reader:
    """Reader of the parts of one packet."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, count: int) -> bytes:
        if self._at + count > len(self._data):
            raise MalformedError("the packet ends in the middle of a field")
        part = self._data[self._at : self._at + count]
        self._at += count
        return part

    def rest(self) -> bytes:
        return self.take(len(self._data) - self._at)

    def more(self) -> bool:
        return self._at < len(self._data)

    def integer(self, size: int) -> int:
        return int.from_bytes(self.take(size))

    def variable(self) -> int:
        value = 0
        for index in range(4):
            byte = self.integer(1)
            value |= (byte & 0x7F) << (7 * index)
            if not byte & 0x80:
                return value
        raise MalformedError("a variable byte integer has more than four bytes")

    def binary(self) -> bytes:
        return self.take(self.integer(2))

    def string(self, *, legal: bool = True) -> str:
        """Read a string; where it may be illegal, what is no UTF-8 is shown with its bytes escaped."""
        if not legal:
            return self.binary().decode("utf-8", "backslashreplace")
        try:
            text = self.binary().decode("utf-8")
        except UnicodeDecodeError:
            raise MalformedError("a string is not UTF-8") from None
        # [MQTT-1.5.3-2] and [MQTT-1.5.4-2].
        if "\0" in text:
            raise MalformedError("a string holds the null character")
        return text

    def properties(self) -> dict[str, Any]:
        inner = _Reader(self.take(self.variable()))
        found: dict[str, Any] = {}
        while inner.more():
            identifier = inner.variable()
            if identifier not in _PROPERTIES:
                raise MalformedError(f"there is no property {identifier}")
            name, kind = _PROPERTIES[identifier]
            value = inner.property_value(kind)
            if name in _REPEATABLE:
                found.setdefault(name, []).append(value)
            elif name in found:
                raise MalformedError(f"the property {name} occurs twice")
            else:
                found[name] = value
        return found

    def property_value(self, kind: str) -> Any:
        if kind == "v":
            return self.variable()
        if kind == "s":
            return self.string()
        if kind == "b":
            return base64.b64encode(self.binary()).decode()
        if kind == "p":
            return [self.string(), self.string()]
        return self.integer(int(kind))


class MqttConversation:
    """One connection; its protocol level and client identifier are known once CONNECT has been seen."""

    def __init__(self) -> None:
        self.client_id: str | None = None
        self._level = 4
        self._aliases: dict[tuple[str, int], str] = {}
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; the kind is the packet's name."""
        kind = KINDS[frame[0] >> 4]
        header = next(index for index, byte in enumerate(frame[1:], start=2) if not byte & 0x80)
        reader = _Reader(frame[header:])
        try:
            fields = self._packet(kind, frame[0] & 0x0F, direction, reader)
            if reader.more():
                raise MalformedError(f"{kind} is longer than its fields")
        except MalformedError as error:
            # A CONNECT or AUTH may hold a credential.
            shown = frame[:1] if kind in ("CONNECT", "AUTH") else frame
            malformed = {"client_id": self.client_id, "packet": kind, "reason": str(error), "bytes": shown.hex()}
            return [Message(direction=direction, kind="malformed", fields=malformed)]
        # An assigned identifier (MQTT 5, section 3.2.2.3.7) is known from CONNACK on.
        self.client_id = fields.get("properties", {}).get("assigned_client_identifier") or self.client_id
        return [self._message(direction, kind, {"client_id": self.client_id, **fields})]

    def _message(self, direction: Direction, kind: str, fields: dict[str, object]) -> Message:
        packet_id = fields.get("packet_id")
        if direction == "out":
            asked = self._outstanding.take((ANSWERS[kind], packet_id)) if kind in ANSWERS else None
            return Message(direction="out", kind=kind, fields=fields, answers=asked)
        message = Message(
            direction="in",
            kind=kind,
            fields=fields,
            request=kind in REQUESTS,
            state_changing=kind == "PUBLISH",
        )
        if kind in REQUESTS and fields.get("qos") != 0:
            self._outstanding.add((kind, packet_id), message)
        return message

    def _packet(self, kind: str, flags: int, direction: Direction, reader: _Reader) -> dict[str, Any]:
        if kind == "PUBLISH":
            return self._publish(flags, direction, reader)
        if flags != (2 if kind in _FLAGS_2 else 0):
            raise MalformedError(f"the flags of {kind} are {flags:04b}")
        if kind == "CONNECT":
            return self._connect(reader)
        if kind == "CONNACK":
            present = reader.integer(1) == 1
            fields: dict[str, object] = {"session_present": present, "reason_codes": [reader.integer(1)]}
            return fields | self._properties(reader)
        if kind in _ACKNOWLEDGEMENTS:
            fields = {"packet_id": reader.integer(2)}
            # MQTT 5, section 3.4.2.1: no reason code means success, no length means no properties.
            if self._level == MQTT_5:
                fields["reason_codes"] = [reader.integer(1) if reader.more() else 0]
                fields |= self._properties(reader) if reader.more() else {}
            return fields
        if kind in ("DISCONNECT", "AUTH"):
            fields = {}
            if self._level == MQTT_5:
                fields["reason_codes"] = [reader.integer(1) if reader.more() else 0]
                fields |= self._properties(reader) if reader.more() else {}
            return fields
        if kind in ("SUBSCRIBE", "UNSUBSCRIBE", "SUBACK", "UNSUBACK"):
            return self._subscription(kind, reader)
        return {}

    def _properties(self, reader: _Reader) -> dict[str, Any]:
        properties = reader.properties() if self._level == MQTT_5 else {}
        # A credential must never be in the journal.
        properties.pop("authentication_data", None)
        return {"properties": properties} if properties else {}

    def _connect(self, reader: _Reader) -> dict[str, Any]:
        protocol, level, flags = reader.string(), reader.integer(1), reader.integer(1)
        if (protocol, level) not in (("MQIsdp", 3), ("MQTT", 4), ("MQTT", 5)):
            raise MalformedError(f"the protocol is {protocol!r} level {level}")
        if flags & 1:
            raise MalformedError("the reserved flag of CONNECT is set")
        self._level = level
        fields: dict[str, object] = {
            "protocol_level": level,
            "clean_start": bool(flags & 2),
            "keepalive": reader.integer(2),
            **self._properties(reader),
        }
        self.client_id = reader.string()
        fields["will"] = None
        if flags & 4:
            will_properties = self._properties(reader)
            topic, payload = reader.string(), reader.binary()
            fields["will"] = {
                "topic": topic,
                "qos": flags >> 3 & 3,
                "retain": bool(flags & 0x20),
                **message_fields(topic, payload),
                **will_properties,
            }
        fields["username"] = reader.string() if flags & 0x80 else None
        if flags & 0x40:
            reader.binary()
        return fields

    def _publish(self, flags: int, direction: Direction, reader: _Reader) -> dict[str, Any]:
        qos = flags >> 1 & 3
        if qos == 3:
            raise MalformedError("PUBLISH with QoS 3")
        # Of a broker's messages an illegal topic is told; a client's are no message then.
        topic = reader.string(legal=direction == "in")
        packet_id = reader.integer(2) if qos else None
        properties = self._properties(reader)
        alias = properties.get("properties", {}).get("topic_alias")
        if alias is not None and topic:
            self._aliases[direction, alias] = topic
        elif alias is not None:
            topic = self._aliases.get((direction, alias), "")
        return {
            "topic": topic,
            "qos": qos,
            "retain": bool(flags & 1),
            "dup": bool(flags & 8),
            "packet_id": packet_id,
            **properties,
            **message_fields(topic, reader.rest()),
        }

    def _subscription(self, kind: str, reader: _Reader) -> dict[str, Any]:
        fields: dict[str, object] = {"packet_id": reader.integer(2), **self._properties(reader)}
        if kind in ("SUBACK", "UNSUBACK"):
            # UNSUBACK has no payload in 3.1.1.
            return fields | {"reason_codes": list(reader.rest())}
        filters: list[dict[str, object]] = []
        while reader.more():
            text = reader.string()
            if kind == "UNSUBSCRIBE":
                filters.append({"filter": text})
                continue
            options = reader.integer(1)
            # The whole byte is checked, not only the bits of the QoS: 0x05 must not look like QoS 1.
            if options & 3 == 3 or options >> 6 or (self._level != MQTT_5 and options >> 2):
                raise MalformedError(f"SUBSCRIBE {text!r} with the options {options:#04x}")
            filters.append({"filter": text, "qos": options & 3})
        if not filters:
            raise MalformedError(f"{kind} without a filter")
        return fields | {"filters": filters}
