"""The state of a session (5: section 4.1, 3.1.1: section 3.1.2.4): subscriptions, and messages on their way.

A session outlives its connections. It handles no sockets: it hands messages to an :class:`Outlet`, and keeps them while
there is none.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

from pytest_otmcp.wire.mqtt.packets import Ack, PacketType
from pytest_otmcp.wire.mqtt.primitives import ProtocolViolation
from pytest_otmcp.wire.mqtt.properties import PROTOCOL_ERROR, Properties, Property

from ..journal import Origin

__all__ = ["Delivery", "Message", "Outlet", "Session", "Subscription"]

PACKET_IDENTIFIER_NOT_FOUND = 0x92


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """An application message in the broker.

    Attributes:
        properties: those that travel with the message (5: section 3.3.2.3).
        publisher: client id of its sender.
        arrived: time of its arrival, in monotonic seconds.
        will: True when it is a will.
    """

    topic: str
    payload: bytes
    qos: int
    retain: bool
    properties: Properties = field(default_factory=dict)
    publisher: str
    arrived: float
    will: bool = False

    @property
    def expired(self) -> bool:
        """True when its Message Expiry Interval has passed [MQTT-3.3.2-5]."""
        interval = self.properties.get(Property.MESSAGE_EXPIRY_INTERVAL)
        return interval is not None and time.monotonic() - self.arrived >= interval

    def current_properties(self) -> Properties:
        """Return the properties, with the expiry interval reduced by the whole seconds waited [MQTT-3.3.2-6]."""
        interval = self.properties.get(Property.MESSAGE_EXPIRY_INTERVAL)
        if interval is None:
            return self.properties
        left = max(0, interval - int(time.monotonic() - self.arrived))
        return {**self.properties, Property.MESSAGE_EXPIRY_INTERVAL: left}


@dataclass(frozen=True, slots=True, kw_only=True)
class Subscription:
    """A subscription; ``levels`` is the filter split at ``/``, without the share name."""

    filter: str
    share: str | None
    levels: list[str]
    qos: int
    no_local: bool
    retain_as_published: bool
    identifier: int | None


@dataclass(slots=True, kw_only=True, eq=False)
class Delivery:
    """One message on its way to one client; ``packet_id`` is 0 at QoS 0 and before it is sent."""

    message: Message
    qos: int
    retain: bool
    identifiers: tuple[int, ...]
    packet_id: int = 0
    received: bool = False


class Outlet(Protocol):
    """A connection, as a session sees it."""

    number: int
    origin: Origin
    receive_maximum: int

    def publish(self, delivery: Delivery, *, dup: bool) -> bool:
        """Send a PUBLISH; return False when the packet is larger than the client accepts."""

    def send(self, packet: Ack) -> None:
        """Send an acknowledgement."""

    def take_over(self) -> None:
        """End this connection because the same client has opened another one."""

    def end(self, reason: str, reason_code: int | None = None) -> None:
        """Close the connection and tell an MQTT 5 client the reason."""


class Session:
    """One client's session.

    Attributes:
        outlet: its connection, if it has one.
        connection, origin: number and origin of its newest connection.
        expiry_s: seconds that it lives without a connection; at 0 it ends with the connection, at infinity never.
        will, will_delay_s: message to publish after the connection has ended, and the delay in seconds.
        incoming: packet identifiers of QoS 2 messages received and not yet released.
        timers: timers of the events that are due while there is no connection.
    """

    def __init__(self, client_id: str) -> None:
        self.client_id = client_id
        self.subscriptions: dict[str, Subscription] = {}
        self.outlet: Outlet | None = None
        self.connection = 0
        self.origin: Origin = "client"
        self.expiry_s = 0.0
        self.will: Message | None = None
        self.will_delay_s = 0.0
        self.incoming: set[int] = set()
        self.timers: list[asyncio.TimerHandle] = []
        self._queue: deque[Delivery] = deque()
        self._inflight: dict[int, Delivery] = {}
        self._resend: deque[Delivery] = deque()
        self._unacknowledged = 0
        self._last_id = 0

    def set_expiry(self, interval: int) -> None:
        """Set the Session Expiry Interval (5: section 3.1.2.11.2): seconds, or 0xFFFFFFFF for never."""
        self.expiry_s = math.inf if interval == 0xFFFFFFFF else float(interval)

    def cancel_timers(self) -> None:
        """Cancel the events that are due while there is no connection."""
        for timer in self.timers:
            timer.cancel()
        self.timers.clear()

    def resume(self, outlet: Outlet) -> None:
        """Use a connection: send the unacknowledged messages again, then those that waited [MQTT-4.4.0-1]."""
        self.outlet = outlet
        self.connection = outlet.number
        self.origin = outlet.origin
        self._resend = deque(self._inflight.values())
        self._unacknowledged = 0
        self._pump()

    def deliver(self, delivery: Delivery) -> None:
        """Send a message, or keep it: while unconnected (QoS 1 and 2 only), or while the client's Receive Maximum is
        reached."""
        if delivery.qos:
            self._queue.append(delivery)
            self._pump()
        elif self.outlet is not None:
            self.outlet.publish(delivery, dup=False)

    def _pump(self) -> None:
        outlet = self.outlet
        if outlet is None:
            return
        while self._unacknowledged < outlet.receive_maximum:
            if self._resend:
                delivery = self._resend.popleft()
                self._unacknowledged += 1
                if delivery.received:
                    outlet.send(Ack(type=PacketType.PUBREL, packet_id=delivery.packet_id))
                elif not outlet.publish(delivery, dup=True):
                    self._finish(delivery)
            elif self._queue:
                delivery = self._queue.popleft()
                if delivery.message.expired:
                    continue
                delivery.packet_id = self._free_id()
                self._inflight[delivery.packet_id] = delivery
                self._unacknowledged += 1
                if not outlet.publish(delivery, dup=False):
                    self._finish(delivery)
            else:
                return

    def _free_id(self) -> int:
        # A free identifier exists: at most 65 535 deliveries, the largest Receive Maximum, are in flight.
        while True:
            self._last_id = self._last_id % 65_535 + 1
            if self._last_id not in self._inflight:
                return self._last_id

    def _finish(self, delivery: Delivery) -> None:
        del self._inflight[delivery.packet_id]
        if delivery in self._resend:
            self._resend.remove(delivery)
        else:
            self._unacknowledged -= 1

    def acknowledge(self, ack: Ack) -> Ack | None:
        """Handle a PUBACK, PUBREC or PUBCOMP for a delivery; return the PUBREL that answers a PUBREC.

        Raises:
            ProtocolViolation: it acknowledges a delivery of another QoS.
        """
        delivery = self._inflight.get(ack.packet_id)
        if delivery is None:
            if ack.type is PacketType.PUBREC and ack.reason_code < 0x80:
                code = PACKET_IDENTIFIER_NOT_FOUND
                return Ack(type=PacketType.PUBREL, packet_id=ack.packet_id, reason_code=code)
            return None
        if (delivery.qos == 1) != (ack.type is PacketType.PUBACK):
            raise ProtocolViolation(f"{ack.type.name} for a QoS {delivery.qos} message", PROTOCOL_ERROR)
        if ack.type is PacketType.PUBREC and ack.reason_code < 0x80:
            delivery.received = True
            return Ack(type=PacketType.PUBREL, packet_id=ack.packet_id)
        self._finish(delivery)
        self._pump()
        return None
