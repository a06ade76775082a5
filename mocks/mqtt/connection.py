"""One network connection of a client: bytes in, packets handled in order and answered, bytes out, all journalled."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace
from typing import Any

from pytest_otmcp.wire.mqtt.codec import UnsupportedProtocol, decode, encode
from pytest_otmcp.wire.mqtt.packets import (
    MQTT_5,
    MQTT_311,
    Connack,
    Connect,
    Disconnect,
    Packet,
    PacketType,
    Publish,
    Suback,
    Subscribe,
)
from pytest_otmcp.wire.mqtt.primitives import ProtocolViolation
from pytest_otmcp.wire.mqtt.properties import PROTOCOL_ERROR, Property

from ..journal import Origin
from ..network import AT_ONCE, Link
from ..peer import process_of
from .broker import KIT, Broker
from .faults import Rule
from .framer import Framer
from .packet_handlers import Afterwards, accept, handle, refusal, supervised_keepalive
from .session import Delivery, Session

__all__ = ["Connection"]

BAD_USER_NAME_OR_PASSWORD = 0x86
DISCONNECT_WITH_WILL = 0x04
FAILURE = 0x80
NOT_AUTHORIZED = 0x87
KEEP_ALIVE_TIMEOUT = 0x8D
SESSION_TAKEN_OVER = 0x8E
TOPIC_ALIAS_INVALID = 0x94
V311_UNACCEPTABLE_PROTOCOL = 1
_AS_V311 = {0x86: 4, 0x87: 5}
"""Return codes of 3.1.1 for the reasons of 5 that it has as well: a bad user name or password, and not authorised."""

_ANSWERED = frozenset(
    {
        PacketType.CONNECT,
        PacketType.PUBLISH,
        PacketType.PUBREL,
        PacketType.SUBSCRIBE,
        PacketType.UNSUBSCRIBE,
        PacketType.PINGREQ,
    }
)
"""Packets to which the broker gives an answer of its own. A PUBREL is sent in the course of a delivery, and answers nothing."""

_LINGER_S = 1.0
"""Seconds in which a client may read the last packet before the connection is cut."""


class Connection(asyncio.Protocol):
    """The connection of one client; see :class:`~.session.Outlet` for the methods that its session calls."""

    def __init__(self, broker: Broker, origin: Origin = "client") -> None:
        self._broker = broker
        self.origin = origin
        self._transport: Link
        self._framer = Framer(broker.limits.maximum_packet_size)
        self._level = MQTT_311
        self._client_id: str | None = None
        self._said: dict[str, Any] = {}
        self._session: Session | None = None
        self._end_reason: str | None = None
        self._held = False
        self._keepalive_s = 0.0
        self._last_packet = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._aliases_in: dict[int, str] = {}
        self._aliases_out: dict[str, int] = {}
        self._topic_alias_maximum = 0
        self._maximum_packet_size: int | None = None
        self.receive_maximum = 65_535

    # -- network ------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, Link)
        self._transport = transport
        self.number = transport.number
        self._broker.opened(transport)
        self._loop = asyncio.get_running_loop()
        if self.origin == "client":
            self._broker.journal.heard_of(self.number, process_of(transport))
            self._event("CONNECTED", peer=transport.get_extra_info("peername")[1])
        else:
            self._event("CONNECTED")
        self._timer = self._loop.call_later(self._broker.limits.connect_timeout_s, self.end, "no CONNECT in time")

    def connection_lost(self, exc: Exception | None) -> None:
        self._broker.closed(self._transport)
        if self._end_reason is None:
            self._leave("connection lost", publish_will=True)
        self._cancel_timer()
        self._event("DISCONNECTED", reason=self._end_reason)

    def data_received(self, data: bytes) -> None:
        if self._end_reason is None:
            self._framer.feed(data)
            self._advance()

    def _advance(self) -> None:
        """Handle the packets that have arrived completely."""
        frame: tuple[int, bytes] | None = None
        try:
            if self._session is None and not self._held and self._framer.held[:1] not in (b"", b"\x10"):
                # The broker does not wait for the length that another protocol's second byte seems to announce.
                raise ProtocolViolation("the first packet is not CONNECT", PROTOCOL_ERROR)
            while self._end_reason is None and not self._held and (frame := self._framer.next()):
                packet = decode(*frame, self._level)
                if isinstance(packet, Connect) and packet.protocol_level < MQTT_311:
                    raise UnsupportedProtocol(packet.protocol_level)
                self._last_packet = self._loop.time()
                self._handle(packet)
                frame = None
        except ProtocolViolation as violation:
            shown = bytes(frame[:1]) + frame[1] if frame else self._framer.held
            if shown[:1] and shown[0] >> 4 == PacketType.CONNECT:
                # The packet may hold a password.
                shown = shown[:1]
            self._event("malformed", bytes=shown[:64].hex(), reason=str(violation))
            if isinstance(violation, UnsupportedProtocol) and self._session is None:
                # The CONNACK has the form of 3.1.1, which a client of any version can read up to the code.
                self.send(Connack(session_present=False, reason_code=V311_UNACCEPTABLE_PROTOCOL))
            self.end(str(violation), violation.reason_code)

    def _event(self, kind: str, **fields: Any) -> None:
        self._broker.journal.event(
            connection=self.number, direction="in", kind=kind, origin=self.origin, client_id=self._client_id, **fields
        )

    def _write(self, data: bytes, answers: int | None = None, **said: Any) -> None:
        if self._transport.carries():
            self._broker.journal.frame(
                data,
                connection=self.number,
                direction="out",
                answers=answers,
                origin=self.origin,
                **self._said,
                **said,
            )
            self._transport.write(data)

    # -- what the session asks for ------------------------------------------------------------------------

    def send(self, packet: Packet, *, answers: int | None = None, rule: Rule | None = None) -> None:
        """Send any packet but a PUBLISH.

        Args:
            answers: sequence number of the request that it answers.
            rule: fault that says how it travels.
        """
        manner = AT_ONCE if rule is None else rule.manner
        said: dict[str, Any] = {"drip_s": manner.drip_s} if manner.drip_s else {}
        for again in ({}, {"duplicate": True}) if manner.duplicate else ({},):
            if self._end_reason is None:
                with self._transport.sending(manner):
                    if manner.mangle is not None:
                        self._transport.write(encode(packet, self._level))
                        return
                    self._write(encode(packet, self._level), answers, **said, **again)

    def publish(self, delivery: Delivery, *, dup: bool) -> bool:
        """Send a PUBLISH; return False when the packet is larger than the client accepts [MQTT-3.1.2-24]."""
        message = delivery.message
        topic, properties, alias = message.topic, {}, None
        if self._level == MQTT_5:
            properties = dict(message.current_properties())
            if delivery.identifiers:
                properties[Property.SUBSCRIPTION_IDENTIFIER] = list(delivery.identifiers)
            topic, alias = self._alias(topic)
            if alias is not None:
                properties[Property.TOPIC_ALIAS] = alias
        packet = Publish(
            topic=topic,
            payload=message.payload,
            qos=delivery.qos,
            retain=delivery.retain,
            dup=dup,
            packet_id=delivery.packet_id,
            properties=properties,
        )
        data = encode(packet, self._level)
        if self._maximum_packet_size is not None and len(data) > self._maximum_packet_size:
            return False
        if alias is not None:
            self._aliases_out[message.topic] = alias
        counted = self._broker.counted
        if counted is None or message.publisher != KIT:
            self._write(data, **({"will_sent": True} if message.will else {}))
        elif self._transport.carries():
            counted[self.number, self.origin, self._client_id] += 1
            self._transport.write(data)
        return True

    def _alias(self, topic: str) -> tuple[str, int | None]:
        """Return the topic name and alias to send: the name alone without an alias, both when the alias is new, later
        the alias alone."""
        known = self._aliases_out.get(topic)
        if known is not None:
            return "", known
        if len(self._aliases_out) < self._topic_alias_maximum:
            return topic, len(self._aliases_out) + 1
        return topic, None

    def take_over(self) -> None:
        """End this connection because the same client has opened another one [MQTT-3.1.4-3]."""
        self.end("session taken over", SESSION_TAKEN_OVER)

    # -- the end ------------------------------------------------------------------------------------------

    def end(self, reason: str, reason_code: int | None = None, *, publish_will: bool = True) -> None:
        """Close the connection and tell an MQTT 5 client the reason."""
        if self._end_reason is not None:
            return
        if reason_code is not None and self._session is not None and self._level == MQTT_5:
            self.send(Disconnect(reason_code=reason_code))
        self._leave(reason, publish_will=publish_will)
        if self._transport.is_closing():
            return
        # Closing a socket with unread input resets the connection and may destroy the bytes just written. Therefore
        # only this side is closed until the client closes the other.
        with contextlib.suppress(OSError):
            self._transport.write_eof()
        self._timer = self._loop.call_later(_LINGER_S, self._transport.abort)

    def _leave(self, reason: str, *, publish_will: bool) -> None:
        self._end_reason = reason
        self._cancel_timer()
        session, self._session = self._session, None
        if session is not None:
            self._broker.detach(session, publish_will=publish_will)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _supervise(self) -> None:
        """End a connection that was silent for one and a half times its keep-alive [MQTT-3.1.2-22]."""
        left = self._last_packet + 1.5 * self._keepalive_s - self._loop.time()
        if left <= 0:
            self.end("keep-alive timeout", KEEP_ALIVE_TIMEOUT)
        else:
            self._timer = self._loop.call_later(left, self._supervise)

    # -- packets ------------------------------------------------------------------------------------------

    def _handle(self, packet: Packet) -> None:
        if isinstance(packet, Publish):
            packet = self._resolve_alias(packet)
        if isinstance(packet, Connect) and self._session is None:
            self._client_id = packet.client_id
        again = isinstance(packet, Connect) and self._session is not None
        rule = None if again else self._broker.faults.match(packet, self._client_id or "")
        said = self._said if rule is None else {**self._said, "fault": rule.action}
        number = self._broker.journal.frame(
            self._framer.frame, connection=self.number, direction="in", origin=self.origin, **said
        )
        asked = number if packet.type in _ANSWERED else None
        if again:
            raise ProtocolViolation("a second CONNECT", PROTOCOL_ERROR)
        if rule is not None and rule.manner.half_open:
            self._transport.die()
        elif isinstance(packet, Connect):
            self._connect(packet, rule, number)
        elif isinstance(packet, Disconnect):
            self._disconnect(packet)
        else:
            assert self._session is not None
            if rule is not None and rule.ack_only:
                assert isinstance(packet, Publish)
                if packet.qos == 2:
                    self._session.incoming.add(packet.packet_id)
                self._misbehave(rule, asked, refusal(packet, 0), None)
                return
            if rule is not None and rule.refuses:
                self._misbehave(rule, asked, *self._refused(packet, rule))
                return
            if rule is not None and rule.reason_code is not None and isinstance(packet, Subscribe):
                packet = _granting(packet, rule.reason_code)
            answer, afterwards = self._handled(packet)
            if rule is None:
                self._answer(asked, answer, afterwards)
            else:
                self._misbehave(rule, asked, answer, afterwards)

    def _handled(self, packet: Packet) -> tuple[Packet | None, Afterwards]:
        assert self._session is not None
        about = isinstance(packet, Publish | Subscribe)
        if about and self.origin == "client" and self._broker.accounts.denies(self.number):
            # 3.1.1 cannot refuse a PUBLISH: it is acknowledged and not handled.
            return refusal(packet, NOT_AUTHORIZED if self._level == MQTT_5 else FAILURE), None
        return handle(self._broker, self._session, self._level, packet)

    def _refused(self, packet: Packet, rule: Rule) -> tuple[Packet | None, Afterwards]:
        """Return the answer that refuses a packet; the other filters of a SUBSCRIBE than the rule's are granted."""
        assert self._session is not None
        assert rule.reason_code is not None
        if isinstance(packet, Subscribe) and rule.topic is not None:
            others = tuple(one for one in packet.requests if one.filter != rule.topic)
            if others:
                granted = replace(packet, requests=others)
                suback, afterwards = handle(self._broker, self._session, self._level, granted)
                assert isinstance(suback, Suback)
                left = iter(suback.reason_codes)
                codes = tuple(rule.reason_code if one.filter == rule.topic else next(left) for one in packet.requests)
                return replace(suback, reason_codes=codes), afterwards
        return refusal(packet, rule.reason_code), None

    def _answer(
        self, asked: int | None, answer: Packet | None, afterwards: Afterwards, rule: Rule | None = None
    ) -> None:
        if answer is not None:
            self.send(answer, answers=asked, rule=rule)
        if afterwards is not None and self._end_reason is None:
            afterwards()

    def _misbehave(self, rule: Rule, asked: int | None, answer: Packet | None, afterwards: Afterwards) -> None:
        """Apply the fault plan's rule to the answer: late, not at all, or the connection is cut."""
        if rule.close or rule.reset:
            self._cut(reset=rule.reset)
        elif rule.delay_s:
            self._loop.call_later(rule.delay_s, self._answer, asked, answer, afterwards)
        elif rule.disconnect is not None:
            self.end("fault plan", rule.disconnect)
        elif not rule.no_answer:
            self._answer(asked, answer, afterwards, rule)

    def _cut(self, *, reset: bool) -> None:
        if reset:
            self._transport.reset()
        else:
            self._transport.close()
        self._leave("fault plan", publish_will=True)

    def _connect(self, packet: Connect, rule: Rule | None, asked: int) -> None:
        self._cancel_timer()
        self._level = packet.protocol_level
        self._framer.minimal = self._level == MQTT_5
        if rule is None:
            self._accept(packet, asked)
        elif rule.refuses:
            assert rule.reason_code is not None
            self._turn_away(rule.reason_code, asked, "fault plan")
        elif rule.close or rule.reset:
            self._cut(reset=rule.reset)
        else:
            # Packets that the client sends before its CONNACK wait; they wait for ever when there is no CONNACK.
            self._held = True
            if not rule.no_answer:
                self._loop.call_later(rule.delay_s, self._accept_late, packet, asked, rule)

    def _turn_away(self, code: int, asked: int, reason: str) -> None:
        """Refuse a CONNECT with a reason of MQTT 5."""
        known = {} if self._level == MQTT_5 else _AS_V311
        self.send(Connack(session_present=False, reason_code=known.get(code, code)), answers=asked)
        self.end(reason)

    def _accept_late(self, packet: Connect, asked: int, rule: Rule) -> None:
        if self._end_reason is None:
            self._held = False
            self._accept(packet, asked, rule)
            self._advance()

    def _accept(self, packet: Connect, asked: int, rule: Rule | None = None) -> None:
        accounts = self._broker.accounts
        if self.origin == "client" and not accounts.lets_in(self.number, packet.username, packet.password):
            self._turn_away(BAD_USER_NAME_OR_PASSWORD, asked, "not let in")
            return
        session, connack = accept(self._broker, packet)
        if session is None:
            self.send(connack, answers=asked)
            self.end("CONNECT refused")
            return
        self._session = session
        if session.client_id != self._client_id:
            # MQTT 3.1.1 does not tell a client which identifier it was given.
            self._client_id = session.client_id
            self._said = {"client_id": session.client_id}
        self.receive_maximum = packet.properties.get(Property.RECEIVE_MAXIMUM, self.receive_maximum)
        self._topic_alias_maximum = packet.properties.get(Property.TOPIC_ALIAS_MAXIMUM, 0)
        self._maximum_packet_size = packet.properties.get(Property.MAXIMUM_PACKET_SIZE)
        self._keepalive_s = supervised_keepalive(self._broker, packet)
        if self._keepalive_s:
            self._supervise()
        self.send(connack, answers=asked, rule=rule)
        session.resume(self)

    def _disconnect(self, packet: Disconnect) -> None:
        assert self._session is not None
        interval = packet.properties.get(Property.SESSION_EXPIRY_INTERVAL)
        if interval is not None:
            if interval and self._session.expiry_s == 0:
                raise ProtocolViolation("a Session Expiry Interval that was 0 cannot be raised", PROTOCOL_ERROR)
            self._session.set_expiry(interval)
        self.end("client disconnected", publish_will=packet.reason_code == DISCONNECT_WITH_WILL)

    def _resolve_alias(self, packet: Publish) -> Publish:
        """Return the PUBLISH with its topic name in place (5: section 3.3.2.3.4)."""
        alias = packet.properties.get(Property.TOPIC_ALIAS)
        if alias is None:
            return packet
        if not 0 < alias <= self._broker.limits.topic_alias_maximum:
            raise ProtocolViolation(f"topic alias {alias}", TOPIC_ALIAS_INVALID)
        if packet.topic:
            self._aliases_in[alias] = packet.topic
            return packet
        if alias not in self._aliases_in:
            raise ProtocolViolation(f"topic alias {alias} stands for nothing", PROTOCOL_ERROR)
        return replace(packet, topic=self._aliases_in[alias])


def _granting(packet: Subscribe, qos: int) -> Subscribe:
    """Return the SUBSCRIBE with this QoS instead of its own: the fault plan grants less."""
    return replace(packet, requests=tuple(replace(one, qos=qos) for one in packet.requests))
