"""The connection to the broker as the tools see it: made on demand, watched, replaced when it breaks.

After a loss the link reconnects by itself within a quarter of a second, because subscriptions and births have to be
there again whether or not a tool is called. Nothing that failed is ever sent again.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from ..core import AdapterError, Call
from .connection import Connection, ConnectionLostError, Endpoint, Message
from .edge_node import EdgeNode
from .inbox import Inbox
from .nodes import NodeTracker
from .payload import decode
from .topics import matches

__all__ = ["Link"]

T = TypeVar("T")

_FIRST_RETRY_S, _LAST_RETRY_S = 0.05, 0.25


class Link:
    """What survives a connection: subscriptions, inbox, the edge node's births.

    Args:
        endpoint: the broker.
        edge_node: the adapter's own edge node.
        may_write: without it no will is armed: a broker that publishes an NDEATH for us is a write, too.
    """

    def __init__(self, endpoint: Endpoint, edge_node: EdgeNode, *, may_write: bool) -> None:
        self.endpoint = endpoint
        self.edge_node = edge_node
        self.inbox = Inbox()
        self.nodes = NodeTracker()
        self.subscriptions: dict[str, int] = {}
        self.generation = 0
        self._may_write = may_write
        self._lock = asyncio.Lock()
        self._connection: Connection | None = None
        self._supervisor: asyncio.Task[None] | None = None
        self._rebirths: set[asyncio.Task[None]] = set()

    @property
    def connected(self) -> bool:
        """There is a connection that is not known to be broken."""
        return self._connection is not None and not self._connection.lost.is_set()

    async def exchange(self, call: Call, request: Callable[[Connection], Awaitable[T]]) -> T:
        """Do something that the broker answers. What changes nothing is repeated once over a new connection.

        Raises:
            AdapterError: no connection, it broke, or no answer.
        """
        for attempt in (1, 2):
            connection = await self._use(call)
            call.sending()
            try:
                return await request(connection)
            except ConnectionLostError:
                call.disconnected()
                if call.writes or attempt == 2:
                    break
        raise AdapterError("connection_lost", "the connection to the broker broke during the call")

    async def publish(
        self, call: Call, topic: str, payload: Callable[[], bytes], *, qos: int = 0, retain: bool = False
    ) -> str:
        """Publish once. ``payload`` is asked for at the moment of sending, so that a sequence number is only taken by
        what is sent. Returns ``acknowledged`` or ``unacknowledged``.

        Raises:
            AdapterError: not sent, or sent and not acknowledged (outcome unknown).
        """
        connection = await self._use(call)
        data = payload()
        try:
            mid = connection.send(topic, data, qos, retain)
        except ConnectionLostError:
            call.disconnected()
            raise AdapterError(
                "connection_lost", "the connection is down; nothing was sent", outcome="not_sent"
            ) from None
        call.sending()
        try:
            await connection.sent(mid)
        except ConnectionLostError:
            call.disconnected()
            raise AdapterError("connection_lost", "the connection broke; the broker may have the message") from None
        return "acknowledged" if qos else "unacknowledged"

    # -- connecting ---------------------------------------------------------------------------------------

    async def _use(self, call: Call) -> Connection:
        before = self.generation
        connection = await self.connect()
        call.connection(generation=self.generation, fresh=self.generation != before)
        return connection

    async def connect(self) -> Connection:
        """The connection, made now if there is none.

        Raises:
            AdapterError: it cannot be made.
        """
        async with self._lock:
            if self._connection is not None and not self._connection.lost.is_set():
                return self._connection
            self._connection = None
            connection = Connection(self.endpoint, self._received)
            await connection.open(self.edge_node.new_connection() if self._may_write else None)
            self.generation += 1
            try:
                await self._restore(connection)
            except ConnectionLostError:
                raise AdapterError("connect_failed", "the broker closed the connection", outcome="not_sent") from None
            self._connection = connection
            if self._supervisor is None or self._supervisor.done():
                self._supervisor = asyncio.create_task(self._supervise())
            return connection

    async def _restore(self, connection: Connection) -> None:
        """Subscriptions and births, before anybody may use the connection."""
        for text, qos in self.subscriptions.items():
            await connection.subscribe(text, qos)
        if self.nodes.wanted:
            await connection.subscribe("spBv1.0/#", 0)
        if self.edge_node.wanted:
            await self.announce(connection)

    async def announce(self, connection: Connection) -> None:
        """NBIRTH and every DBIRTH; commands are subscribed to before (message-flow-edge-node-ncmd-subscribe)."""
        node = self.edge_node
        await connection.subscribe(node.topic("NCMD"), 1)
        await connection.subscribe(node.topic("DCMD") + "/#", 1)
        for topic, data in node.all_births():
            await connection.sent(connection.send(topic, data, 0, False))
        node.born = True

    async def _supervise(self) -> None:
        """Wait for the loss of the connection and make a new one, as often as it takes."""
        while self._connection is not None:
            await self._connection.lost.wait()
            delay = _FIRST_RETRY_S
            while True:
                await asyncio.sleep(delay)
                try:
                    await self.connect()
                    break
                except AdapterError:
                    delay = min(2 * delay, _LAST_RETRY_S)

    async def close(self) -> None:
        """Leave: NDEATH first, because a DISCONNECT discards the will (intentional-disconnect-ndeath)."""
        if self._supervisor is not None:
            self._supervisor.cancel()
        connection, self._connection = self._connection, None
        if connection is None or connection.lost.is_set():
            return
        if self.edge_node.born and self._may_write:
            try:
                mid = connection.send(self.edge_node.topic("NDEATH"), self.edge_node.death(), 1, False)
                await connection.sent(mid)
            except (ConnectionLostError, AdapterError):
                pass
        await connection.close()

    # -- receiving ----------------------------------------------------------------------------------------

    def _received(self, message: Message) -> None:
        if any(matches(text, message.topic) for text in self.subscriptions):
            self.inbox.add(message)
        if message.topic.startswith("spBv1.0/"):
            self.nodes.received(message)
            if message.topic == self.edge_node.topic("NCMD"):
                self._command(message)

    def _command(self, message: Message) -> None:
        """Rebirth: births again, same bdSeq, no reconnect (data-commands-rebirth-action-1 to -3)."""
        try:
            metrics: list[dict[str, Any]] = decode(message.payload)["metrics"]
        except AdapterError:
            return
        wanted = any(metric["name"] == "Node Control/Rebirth" and metric["value"] is True for metric in metrics)
        if wanted and self.edge_node.born and self._connection is not None:
            # Sent in one go, without a wait in between: no data can come between the births.
            for topic, data in self.edge_node.all_births():
                try:
                    self._connection.send(topic, data, 0, False)
                except ConnectionLostError:
                    return
