"""The state that connections, service calls and sessions of an OPC UA device share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from asyncua import ua
from asyncua.server.internal_session import InternalSession

from ..accounts import Accounts
from ..journal import Journal
from ..network import Network
from .faults import FaultPlan
from .limits import Limits
from .plant import Plant

__all__ = ["SUBSCRIPTIONS", "DeviceState"]

SUBSCRIPTIONS = ("normal", "stale", "silent")
"""What subscriptions send: everything; messages without data, as if nothing changed; nothing, until they are something else again."""


class Connection(Protocol):
    """A connection, and the session that its last requests were about."""

    session: InternalSession | None


@dataclass(slots=True, kw_only=True)
class DeviceState:
    """The state of one device.

    Attributes:
        journal: where connections and service calls are recorded.
        plant: the nodes and their values.
        faults: the fault plan in force.
        limits: the limits of the server.
        network: the way between the server and its clients.
        accounts: who gets in.
        certificate: name of the one that is presented; empty without security.
        subscriptions: one of :data:`SUBSCRIPTIONS`.
        sessions: the open sessions of clients.
        connections: the open connections.
        cut_off: sessions whose connection the device has ended, or has said not to know, and that no connection was used for since.
        withheld: number of notifications whose values were not sent when they were due, since :meth:`subscribe`.
    """

    journal: Journal
    plant: Plant
    network: Network
    accounts: Accounts
    certificate: str = ""
    subscriptions: str = "normal"
    faults: FaultPlan = field(default_factory=lambda: FaultPlan([]))
    limits: Limits = field(default_factory=Limits)
    sessions: set[InternalSession] = field(default_factory=set)
    connections: set[Connection] = field(default_factory=set)
    cut_off: set[InternalSession] = field(default_factory=set)
    withheld: int = 0
    _held: list[Callable[[], None]] = field(default_factory=list)

    @property
    def kept_by_clients(self) -> int:
        """Number of the sessions that clients have open.

        One with subscriptions outlives its connection until it times out (OPC 10000-4, 6.7). Where the device has ended the connection,
        the client had no means to close the session, so it is none that the client has left behind.
        """
        self.cut_off &= self.sessions
        used = {connection.session for connection in self.connections}
        return len(self.sessions - (self.cut_off - used))

    async def close_abandoned_sessions(self) -> None:
        """Close the sessions that no connection is used for.

        A session with subscriptions outlives its connection until it times out (OPC 10000-4, 6.7), and clients ask for an hour; one
        whose connection ends in the middle of a message stays for a while as well: a check that mangles a hundred answers left a
        hundred. What one item has left must not count against the limit for the next.
        """
        used = {connection.session for connection in self.connections}
        for session in self.sessions - used:
            await session.close_session()

    def notify(self, message: ua.NotificationMessage, send: Callable[[], None]) -> None:
        """Send a notification, or what the subscriptions make of it."""
        if self.subscriptions != "normal" and message.NotificationData:
            self.withheld += 1
        if self.subscriptions == "silent":
            self._held.append(send)
            return
        if self.subscriptions == "stale":
            message.NotificationData = []
        send()

    def subscribe(self, condition: str) -> None:
        """Change what subscriptions send; what they held back while they were silent is sent late.

        Raises:
            ValueError: there is no such condition.
        """
        if condition not in SUBSCRIPTIONS:
            raise ValueError(f"subscriptions: expected one of {', '.join(SUBSCRIPTIONS)}, found {condition!r}")
        self.subscriptions = condition
        self.withheld = 0
        if condition != "silent":
            held, self._held = self._held, []
            for send in held:
                send()
