"""The broker: sessions, delivery of messages, retained messages, wills.

It handles no bytes and no sockets: connections hand it the contents of packets (see ``connection``).
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

from pytest_otmcp.wire.mqtt.packets import MQTT_5, Connect, Publish, SubscriptionRequest, Will
from pytest_otmcp.wire.mqtt.properties import Property
from pytest_otmcp.wire.mqtt.sparkplug import message_fields
from pytest_otmcp.wire.mqtt.topics import matches, split_shared

from ..accounts import Accounts
from ..journal import Journal, Origin
from .faults import FaultPlan
from .session import Delivery, Message, Session, Subscription

__all__ = ["KIT", "Broker", "Limits", "Receiver"]

KIT = "otmcp-kit"
"""The client identifier of messages that the kit publishes past the protocol."""

Receiver = tuple[int, Origin, str | None]
"""A connection: its number, whose it is, and the client identifier."""

_NEVER = 0xFFFFFFFF
_ROUTES = 10_000
_TRAVELLING = (
    Property.PAYLOAD_FORMAT_INDICATOR,
    Property.MESSAGE_EXPIRY_INTERVAL,
    Property.CONTENT_TYPE,
    Property.RESPONSE_TOPIC,
    Property.CORRELATION_DATA,
    Property.USER_PROPERTY,
)

_Members = list[tuple[Session, Subscription]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """The limits of the broker for a client; MQTT 5 clients get them in the CONNACK.

    Attributes:
        receive_maximum: QoS 2 messages that may be unreleased at a time.
        topic_alias_maximum: highest topic alias a client may use.
        maximum_packet_size: in bytes. The protocol's own limit is 256 MiB, and a mock that keeps messages for a hundred
            sessions and retains them must bound its memory.
        server_keep_alive: longest keep-alive in seconds; None for any.
        connect_timeout_s: how long a connection may stay without a CONNECT.
    """

    receive_maximum: int = 256
    topic_alias_maximum: int = 16
    maximum_packet_size: int = 16 * 1024 * 1024
    server_keep_alive: int | None = None
    connect_timeout_s: float = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Route:
    """The subscribers of a topic: each session with its matching subscriptions, and the shared subscriptions."""

    sessions: list[tuple[Session, list[Subscription]]]
    shares: dict[tuple[str, str], _Members]


class Broker:
    """The broker, which routes messages between sessions.

    Attributes:
        accounts: who gets in.
        counted: how many of the kit's messages were sent on each connection; None while each of them is an entry of its own.
        subscribed: is told a topic filter when its SUBACK has been sent.
    """

    def __init__(self, journal: Journal, limits: Limits | None = None) -> None:
        self.journal = journal
        self.limits = limits or Limits()
        self.faults = FaultPlan([])
        self.accounts = Accounts(journal)
        self.retained: dict[str, Message] = {}
        self.sessions: dict[str, Session] = {}
        self.counted: Counter[Receiver] | None = None
        self.subscribed: Callable[[str], None] = lambda topic_filter: None
        self._open: set[asyncio.Transport] = set()
        self._all_closed = asyncio.Event()
        self._assigned = itertools.count(1)
        self._routes: dict[str, _Route] = {}
        self._turns: dict[tuple[str, str], int] = {}

    # -- connections --------------------------------------------------------------------------------------

    def opened(self, transport: asyncio.Transport) -> None:
        """Note a new connection."""
        self._open.add(transport)

    def closed(self, transport: asyncio.Transport) -> None:
        """Note that a connection has ended."""
        self._open.discard(transport)
        if not self._open:
            self._all_closed.set()

    async def aclose(self) -> None:
        """Cut all connections."""
        self._all_closed.clear()
        for transport in self._open:
            transport.abort()
        if self._open:
            await self._all_closed.wait()

    # -- sessions -----------------------------------------------------------------------------------------

    def assign_client_id(self) -> str:
        """Return an identifier for a client that has none [MQTT-3.1.3-6]."""
        return f"otmcp-assigned-{next(self._assigned)}"

    def attach(self, connect: Connect, client_id: str) -> tuple[Session, bool]:
        """Return the session that a CONNECT opens, and whether it existed before (5: section 3.1.4)."""
        session = self.sessions.get(client_id)
        if session is not None and session.outlet is not None:
            session.outlet.take_over()
        # The take-over of the connection may have ended the session.
        session = self.sessions.get(client_id)
        if session is not None and connect.clean_start:
            self._end(session)
            session = None
        present = session is not None
        if session is None:
            session = self.sessions[client_id] = Session(client_id)
        session.cancel_timers()
        if connect.protocol_level == MQTT_5:
            session.set_expiry(connect.properties.get(Property.SESSION_EXPIRY_INTERVAL, 0))
        else:
            session.set_expiry(0 if connect.clean_start else _NEVER)
        session.will, session.will_delay_s = None, 0.0
        if connect.will is not None:
            session.will = self._will_message(connect.will, client_id)
            session.will_delay_s = connect.will.properties.get(Property.WILL_DELAY_INTERVAL, 0)
        return session, present

    def disconnect(self, client_id: str | None, reason_code: int) -> None:
        """End the connection of one client, or of all clients from outside, with a reason for those of MQTT 5.

        Raises:
            ValueError: there is no such client.
        """
        found = [
            session.outlet
            for session in self.sessions.values()
            if session.outlet is not None
            and (session.outlet.origin == "client" if client_id is None else session.client_id == client_id)
        ]
        if client_id is not None and not found:
            raise ValueError(f"no client {client_id!r} is connected")
        for outlet in found:
            outlet.end("poke", reason_code)

    def detach(self, session: Session, *, publish_will: bool) -> None:
        """Take the connection from a session; its will and its expiry become due (5: section 3.1.2.5, 3.1.2.11.2)."""
        session.outlet = None
        if not publish_will:
            session.will = None
        loop = asyncio.get_running_loop()
        if session.will is not None and 0 < session.will_delay_s < session.expiry_s:
            session.timers.append(loop.call_later(session.will_delay_s, self._publish_will, session))
        elif session.will_delay_s == 0:
            self._publish_will(session)
        if session.expiry_s == 0:
            self._end(session)
        elif session.expiry_s < _NEVER:
            session.timers.append(loop.call_later(session.expiry_s, self._end, session))

    def _end(self, session: Session) -> None:
        session.cancel_timers()
        self.sessions.pop(session.client_id, None)
        self._routes.clear()
        # A will that still waits is published now at the latest [MQTT-3.1.2-8].
        self._publish_will(session)

    def _will_message(self, will: Will, client_id: str) -> Message:
        return self._message(will, client_id, will=True)

    def _publish_will(self, session: Session) -> None:
        will, session.will = session.will, None
        if will is None:
            return
        # Its expiry interval counts from now (5: section 3.1.3.2.4).
        will = replace(will, arrived=time.monotonic())
        self.journal.event(
            connection=session.connection,
            direction="in",
            kind="WILL",
            origin=session.origin,
            client_id=session.client_id,
            topic=will.topic,
            **message_fields(will.topic, will.payload),
            qos=will.qos,
            retain=will.retain,
        )
        self.route(will)

    # -- messages -----------------------------------------------------------------------------------------

    def publish(self, packet: Publish, client_id: str) -> bool:
        """Route what a client publishes; return whether there is a subscriber."""
        return self.route(self._message(packet, client_id))

    @staticmethod
    def _message(source: Publish | Will, client_id: str, *, will: bool = False) -> Message:
        return Message(
            topic=source.topic,
            payload=source.payload,
            qos=source.qos,
            retain=source.retain,
            properties={name: source.properties[name] for name in _TRAVELLING if name in source.properties},
            publisher=client_id,
            arrived=time.monotonic(),
            will=will,
        )

    def route(self, message: Message) -> bool:
        """Retain a message if it asks for it, and hand it to its subscribers; return whether there are any."""
        if message.retain:
            if message.payload:
                self.retained[message.topic] = message
            else:
                self.retained.pop(message.topic, None)
        route = self._routes.get(message.topic) or self._find_route(message.topic)
        for session, subscriptions in route.sessions:
            self._deliver(session, subscriptions, message)
        for key, members in route.shares.items():
            # The members of the group take turns, only the connected ones if there are any (5: section 4.8.2).
            present = [member for member in members if member[0].outlet is not None] or members
            turn = self._turns[key] = self._turns.get(key, -1) + 1
            session, subscription = present[turn % len(present)]
            self._deliver(session, [subscription], message)
        return bool(route.sessions or route.shares)

    def _find_route(self, topic: str) -> _Route:
        route = _Route(sessions=[], shares={})
        levels = topic.split("/")
        for session in self.sessions.values():
            found = [one for one in session.subscriptions.values() if matches(one.levels, levels)]
            own = [one for one in found if one.share is None]
            if own:
                route.sessions.append((session, own))
            for one in found:
                if one.share is not None:
                    route.shares.setdefault((one.share, "/".join(one.levels)), []).append((session, one))
        if len(self._routes) >= _ROUTES:
            self._routes.clear()
        self._routes[topic] = route
        return route

    @staticmethod
    def _deliver(
        session: Session, subscriptions: list[Subscription], message: Message, *, stored: bool = False
    ) -> None:
        """Send one copy for all overlapping subscriptions, at the highest QoS granted [MQTT-3.3.4-2, MQTT-3.3.4-3]."""
        if session.client_id == message.publisher:
            subscriptions = [one for one in subscriptions if not one.no_local]
            if not subscriptions:
                return
        retain = stored or (message.retain and any(one.retain_as_published for one in subscriptions))
        session.deliver(
            Delivery(
                message=message,
                qos=min(message.qos, max(one.qos for one in subscriptions)),
                retain=retain,
                identifiers=tuple(one.identifier for one in subscriptions if one.identifier is not None),
            )
        )

    # -- subscriptions ------------------------------------------------------------------------------------

    def subscribe(
        self, session: Session, request: SubscriptionRequest, identifier: int | None, level: int
    ) -> list[Message]:
        """Add or replace a subscription; return the retained messages it is to get (5: section 3.8.3.1)."""
        share, proper = split_shared(request.filter) if level == MQTT_5 else (None, request.filter)
        levels = proper.split("/")
        is_new = request.filter not in session.subscriptions
        session.subscriptions[request.filter] = Subscription(
            filter=request.filter,
            share=share,
            levels=levels,
            qos=request.qos,
            no_local=request.no_local,
            retain_as_published=request.retain_as_published,
            identifier=identifier,
        )
        self._routes.clear()
        if share is not None or request.retain_handling == 2 or (request.retain_handling == 1 and not is_new):
            return []
        for topic in [topic for topic, message in self.retained.items() if message.expired]:
            del self.retained[topic]
        return [message for topic, message in self.retained.items() if matches(levels, topic.split("/"))]

    def send_retained(self, session: Session, topic_filter: str, messages: list[Message]) -> None:
        """Deliver retained messages for a subscription, if it still exists: its SUBACK may have been delayed."""
        subscription = session.subscriptions.get(topic_filter)
        if subscription is not None:
            for message in messages:
                self._deliver(session, [subscription], message, stored=True)

    def unsubscribe(self, session: Session, topic_filter: str) -> bool:
        """Remove a subscription; return whether there was one."""
        self._routes.clear()
        return session.subscriptions.pop(topic_filter, None) is not None

    # -- from outside -------------------------------------------------------------------------------------

    def forget(self) -> None:
        """Drop retained messages, and sessions without a connection; no connected client depends on them."""
        self.retained.clear()
        for session in [one for one in self.sessions.values() if one.outlet is None]:
            session.will = None
            self._end(session)
