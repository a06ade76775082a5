"""The connection to the broker for the tools: made on demand, watched, replaced when it breaks.

After a loss the link reconnects by itself, because subscriptions and births have to be restored even if no tool is called:
at once, then with pauses that double, so that a broker that comes back is not stormed. A call does not wait for the end of a
pause: it makes an attempt of its own. A message that failed is never sent again.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from ..core import AdapterError, Call, Lost, repeat_once
from .connection import Connection, Endpoint, Message, Refused, refusal_code
from .edge_node import EdgeNode
from .inbox import Inbox
from .nodes import NodeTracker
from .payload import is_rebirth_command
from .topics import matches

__all__ = ["Link", "Subscription"]

T = TypeVar("T")

# Reason codes from here on are refusals (MQTT 5, section 2.4; the SUBACK of 3.1.1 has only this one).
_REFUSED = 0x80
# With these pauses there are 28 attempts in the first minute of an outage, and 24 in each further one.
_FIRST_RETRY_S, _LAST_RETRY_S = 0.05, 2.5
# A connection that keeps ending at once is probably taken over by another client with the same identifier [MQTT-3.1.4-2].
# Two adapters must not disconnect each other endlessly.
_SHORT_LIVED_S, _TAKEN_OVER_RETRY_S = 0.5, 5.0
_FAREWELL_S = 2.0
# A CONNECT that failed with one of these codes is not repeated in the background: this could lock an account.
_PERMANENT = ("auth_failed", "access_denied", "config_error", "tls_error")

log = logging.getLogger(__name__)


@dataclass(slots=True, kw_only=True)
class Subscription:
    """A subscription that a tool asked for; ``granted`` is None while the broker refuses it."""

    qos: int
    granted: int | None


class Link:
    """The state that outlives a connection: subscriptions, inbox, the edge node's births.

    Args:
        endpoint: the broker.
        edge_node: the adapter's own edge node.
        may_write: False sets no will: an NDEATH that the broker publishes for the adapter is a write, too.

    Attributes:
        subscriptions: those of the tools, by filter.
        needed: filters and QoS that the adapter itself needs.
        publishing: lock that is held while messages are published as edge node, so that their sequence is unbroken.
    """

    def __init__(self, endpoint: Endpoint, edge_node: EdgeNode, *, may_write: bool) -> None:
        self.endpoint = endpoint
        self.edge_node = edge_node
        self.inbox = Inbox()
        self.nodes = NodeTracker()
        self.subscriptions: dict[str, Subscription] = {}
        self.needed: dict[str, int] = {}
        self.publishing = asyncio.Lock()
        self.generation = 0
        self._asked_for: list[str] = []
        self._may_write = may_write
        self._unused_filter = f"otmcp/ping/{secrets.token_hex(8)}"
        self._connection: Connection | None = None
        self._attempt: asyncio.Task[Connection] | None = None
        self._keeper: asyncio.Task[None] | None = None
        self._rebirth: asyncio.Task[None] | None = None

    @property
    def connected(self) -> bool:
        """True when there is a connection."""
        return self._connection is not None and self._connection.is_live()

    # -- what the tools do --------------------------------------------------------------------------------

    async def exchange(self, call: Call, request: Callable[[Connection], Awaitable[T]]) -> T:
        """Make a request that the broker answers and that changes nothing.

        Raises:
            AdapterError: no connection, the connection broke twice, or no answer.
        """

        async def attempt() -> T:
            connection = await self._use(call)
            call.sending(changes_state=False)
            try:
                result = await request(connection)
            except (Lost, AdapterError):
                call.disconnected()
                raise
            call.answered()
            return result

        return await repeat_once(call, attempt)

    async def ask(self, call: Call) -> None:
        """Make the broker answer. It has then also delivered all messages that it had for this client before.

        Unsubscribing a filter that was never subscribed changes nothing, and the broker has to answer [MQTT-3.10.4-5].
        paho's public interface cannot send a PINGREQ.

        Raises:
            AdapterError: as :meth:`exchange`.
        """
        await self.exchange(call, lambda connection: connection.unsubscribe(self._unused_filter))

    async def publish(self, call: Call, compose: Callable[[], list[Message]]) -> None:
        """Publish messages, once each.

        They are composed when the connection is known to exist, so that a message that cannot be sent uses up no sequence
        number. If publishing fails after a message was sent, the connection has ended, too.

        Raises:
            AdapterError: nothing was sent, or it is unknown whether the broker has the message.
        """
        connection = await self._use(call)
        if connection.lost.is_set():
            call.disconnected()
            raise AdapterError("connection_lost", "the connection broke before anything was sent")
        # No other task runs from here to the last send().
        deliveries = []
        try:
            for message in compose():
                call.sending()
                call.trace.update(topic=message.topic, qos=message.qos, retain=message.retain)
                deliveries.append(connection.send(message))
            await connection.delivered(deliveries)
        except Lost:
            call.disconnected()
            raise AdapterError("connection_lost", "the connection broke; the broker may have the message") from None
        except Refused as refused:
            call.trace["reason_code"] = refused.reason
            raise
        except AdapterError:
            call.disconnected()
            raise
        call.trace["delivery"] = "acknowledged" if message.qos else "unacknowledged"
        if message.qos:
            call.answered(packet_id=deliveries[-1].packet_id)

    async def subscribe(self, call: Call, text: str, qos: int) -> int:
        """Subscribe for the tools, now and on every later connection, and return the granted QoS.

        Raises:
            AdapterError: as :meth:`exchange`, or the broker refuses.
        """
        asked = max(qos, self.needed.get(text, 0))

        async def request(connection: Connection) -> list[int]:
            call.trace.update(topic=text, qos=asked)
            return await connection.subscribe({text: asked})

        # Messages may come before the SUBACK (MQTT 3.1.1, section 3.8.4), and in one read with it.
        self._asked_for.append(text)
        try:
            (granted,) = await self.exchange(call, request)
            if granted >= _REFUSED:
                # If there was a subscription with this filter, the broker has kept it (MQTT 3.1.1, section 3.8.4).
                raise _refused(call, granted, "the broker refuses the subscription")
            call.trace["granted_qos"] = granted
            self.subscriptions[text] = Subscription(qos=qos, granted=granted)
        finally:
            self._asked_for.remove(text)
        return granted

    async def unsubscribe(self, call: Call, text: str) -> None:
        """End a subscription of the tools; the adapter stays subscribed to the filters that it needs itself.

        Raises:
            AdapterError: as :meth:`exchange`.
        """
        if text in self.needed:
            await self.exchange(call, lambda connection: connection.subscribe({text: self.needed[text]}))
        else:
            await self.exchange(call, lambda connection: connection.unsubscribe(text))
        self.subscriptions.pop(text, None)

    async def need(self, call: Call, filters: Mapping[str, int]) -> None:
        """Subscribe to filters that the adapter itself needs, unless it is subscribed, and on every later connection.

        Raises:
            AdapterError: as :meth:`exchange`, or the broker refuses.
        """
        missing = {text: qos for text, qos in filters.items() if text not in self.needed}
        if not missing:
            return
        granted = await self.exchange(call, lambda connection: connection.subscribe(missing))
        if refusals := [reason for reason in granted if reason >= _REFUSED]:
            raise _refused(call, refusals[0], "the broker refuses a subscription that this tool needs")
        self.needed.update(missing)

    # -- connecting ---------------------------------------------------------------------------------------

    async def _use(self, call: Call) -> Connection:
        before = self.generation
        try:
            connection = await self._connected()
        except AdapterError:
            call.disconnected()
            raise
        call.connection(generation=self.generation, fresh=self.generation != before)
        return connection

    async def _connected(self) -> Connection:
        """Return the connection, made now if there is none.

        Raises:
            AdapterError: the connection cannot be made.
        """
        if self._connection is not None and self._connection.is_live():
            return self._connection
        if self._attempt is None or self._attempt.done():
            self._attempt = asyncio.create_task(self._connect())
            # This retrieves the exception even if every call that waits for the attempt is cancelled.
            self._attempt.add_done_callback(lambda task: task.cancelled() or task.exception())
        if self._keeper is None or self._keeper.done():
            self._keeper = asyncio.create_task(self._keep_connected())
        # One attempt serves all calls, and continues if the call that began it is cancelled.
        return await asyncio.shield(self._attempt)

    async def _connect(self) -> Connection:
        connection = Connection(self.endpoint, self._received)
        try:
            await connection.open(self.edge_node.will() if self._may_write else None)
        finally:
            if connection.introduced:
                self.edge_node.connect_sent()
        self.generation += 1
        try:
            await self._restore(connection)
        except Lost:
            raise AdapterError("connect_failed", "the broker closed the connection", outcome="not_sent") from None
        self._connection = connection
        return connection

    async def _restore(self, connection: Connection) -> None:
        """Restore subscriptions and births before a call may use the connection."""
        self.nodes.interrupted()
        filters = dict(self.needed)
        for text, subscription in self.subscriptions.items():
            filters[text] = max(subscription.qos, filters.get(text, 0))
        if filters:
            answers = zip(filters, await connection.subscribe(filters), strict=True)
            granted = {text: None if reason >= _REFUSED else reason for text, reason in answers}
            for text, subscription in self.subscriptions.items():
                subscription.granted = granted.get(text, subscription.granted)
            for text in [text for text in self.needed if granted.get(text, 0) is None]:
                log.warning("the broker refuses a subscription that it granted before")
                del self.needed[text]
        if self.edge_node.alive:
            try:
                await connection.delivered([connection.send(birth) for birth in self.edge_node.births()])
            except Refused:
                log.warning("the broker refuses the births of the edge node")

    async def _keep_connected(self) -> None:
        """Make a new connection whenever there is none; end when an attempt fails permanently."""
        loop, delay, short_lived = asyncio.get_running_loop(), _FIRST_RETRY_S, 0
        while True:
            try:
                connection = await self._connected()
            except AdapterError as error:
                if error.code in _PERMANENT:
                    return
                await asyncio.sleep(delay)
                delay = min(2 * delay, _LAST_RETRY_S)
                continue
            since = loop.time()
            await connection.lost.wait()
            short_lived = short_lived + 1 if loop.time() - since < _SHORT_LIVED_S else 0
            delay = _FIRST_RETRY_S
            if short_lived > 4:
                log.warning("the connection never lasts; does another client use the identifier of this one?")
            await asyncio.sleep(min(_FIRST_RETRY_S * 2 ** max(0, short_lived - 4), _TAKEN_OVER_RETRY_S))

    async def close(self) -> None:
        """Publish NDEATH, because a DISCONNECT discards the will (intentional-disconnect-ndeath), and disconnect."""
        for task in (self._keeper, self._rebirth, self._attempt):
            if task is not None:
                task.cancel()
        connection = self._connection
        if connection is None or not connection.is_live():
            return
        if self.edge_node.alive:
            with suppress(Lost, AdapterError, TimeoutError):
                async with asyncio.timeout(_FAREWELL_S):
                    await connection.delivered([connection.send(self.edge_node.death())])
        await connection.close()

    # -- receiving ----------------------------------------------------------------------------------------

    def _received(self, message: Message) -> None:
        if any(matches(text, message.topic) for text in (*self.subscriptions, *self._asked_for)):
            self.inbox.add(message)
        self.nodes.received(message)
        asked = message.topic == self.edge_node.topic("NCMD") and is_rebirth_command(message.payload)
        # A host that asks again while the births are being published receives these births.
        if asked and (self._rebirth is None or self._rebirth.done()):
            self._rebirth = asyncio.create_task(self._be_born_again())

    async def _be_born_again(self) -> None:
        """Publish the births again, with the same bdSeq and no reconnect (data-commands-rebirth-action-1 to -3)."""
        async with self.publishing:
            connection = self._connection
            if connection is None or not connection.is_live() or not self.edge_node.alive:
                return
            # If the connection is lost, the next one begins with births anyway.
            with suppress(Lost, AdapterError):
                await connection.delivered([connection.send(birth) for birth in self.edge_node.births()])


def _refused(call: Call, reason: int, message: str) -> AdapterError:
    call.trace["reason_code"] = reason
    outcome = "not_sent" if call.writes else "not_applicable"
    # The refusal of 3.1.1 gives no reason.
    code = refusal_code(reason, otherwise="access_denied")
    return AdapterError(code, message, outcome=outcome, details={"by": "device"})
