"""The interface of every tap, and the choice of the tap for an endpoint.

A tap is a proxy between an adapter and its device. It records, and on demand disturbs, what passes. Without rules bytes are
handed on as they come, before anything else is done with them.
"""

from __future__ import annotations

from collections import Counter
from typing import Protocol

from ...core.errors import KitError
from ...protocols.protocol import Framing
from ..endpoint import Endpoint
from ..journal import DeviceJournal
from .datagram import DatagramTap
from .faults import Action, FaultRule
from .medium import Gate, NewSocket, Rewrite
from .stream import StreamTap

__all__ = ["Tap", "new_tap"]


class Tap(Protocol):
    """A proxy in front of one endpoint; to be used on one event loop.

    Attributes:
        new_socket: makes the socket of clients, of a type and a family, in the network in which they are.
    """

    new_socket: NewSocket

    @property
    def host(self) -> str:
        """Address where clients reach it."""
        ...

    @property
    def port(self) -> int:
        """Port where clients reach it; stays the same over :meth:`down` and :meth:`up`."""
        ...

    @property
    def journal(self) -> DeviceJournal:
        """What passed, decoded."""
        ...

    @property
    def dead_connections(self) -> int:
        """Connections over which nothing passes any more, although neither side has been told of an end."""
        ...

    @property
    def injected(self) -> Counter[Action]:
        """How often each fault of the plan in effect was really injected."""
        ...

    async def start(self) -> None:
        """Take a free port and hand on what comes."""

    async def aclose(self) -> None:
        """End everything; no task and no socket is left."""

    async def up(self) -> None:
        """Bring the endpoint back, on the same port."""

    async def down(self) -> None:
        """Take the endpoint away, as if the device were gone; nothing that is on its way is delivered later."""

    def begin_journal(self) -> None:
        """Begin an empty journal that counts from 0 again."""

    async def settle(self) -> None:
        """Return when the journal has all that has passed until now.

        Raises:
            KitError: what passes cannot be seen any more.
        """

    async def more(self, timeout_s: float) -> None:
        """Return when there may be more in the journal, or after so many seconds."""

    def inject(self, *rules: FaultRule) -> None:
        """Replace the fault plan, counting from now; without rules everything passes untouched again.

        Raises:
            ValueError: an action does not exist on this transport.
        """


def new_tap(target: Endpoint, framing: Framing | None, gate: Gate | None = None, rewrite: Rewrite | None = None) -> Tap:
    """Return a tap in front of an endpoint; it has to be started.

    Args:
        target: the device's endpoint.
        framing: how to cut and decode what passes; None for a journal without messages.
        gate: decides which frames reach the device; None lets everything through.
        rewrite: makes of the frames of the device what the client gets; None leaves them as they are.

    Raises:
        KitError: the kit cannot record, or not guard, what passes there.
    """
    match target.kind:
        case "tcp":
            return StreamTap(target.host, target.port, framing=framing, gate=gate, rewrite=rewrite)
        case "udp" if rewrite is not None:
            raise KitError(f"the endpoint {target.name!r} is a UDP port, and the kit's tap rewrites nothing at those")
        case "udp":
            return DatagramTap(target.host, target.port, framing=framing, gate=gate)
        case "pty" | "cable":
            kind = "a pseudo terminal" if target.kind == "pty" else "a cable"
            raise KitError(f"the endpoint {target.name!r} is {kind}, and the kit has no tap for those")
