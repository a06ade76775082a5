"""The journal and the fault plan that the connections of one tap share, and what every tap tells of them."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from ...protocols.protocol import Framing
from ..journal import DeviceJournal
from .faults import Action, FaultPlan

__all__ = ["WITHHELD", "Gate", "Medium", "MediumOwner", "NewSocket", "Rewrite"]

WITHHELD = "withheld"
"""What the journal says of a frame that the gate has not let through."""

Gate = Callable[[bytes], bool]
"""Tells of a whole frame to the device whether it may pass."""
Rewrite = Callable[[bytes], bytes | None]
"""Makes of a whole frame of the device the one that the client gets; None ends the connection before it."""
NewSocket = Callable[[int, int], socket.socket]


@dataclass(slots=True)
class Medium:
    """The journal and the fault plan of one tap; both may be replaced while connections are open.

    Attributes:
        gate: without one every frame passes. With one the device gets no byte of a frame that was not let through, and nothing that
            cannot be cut into frames.
        rewrite: without one the client gets the frames of the device as they are.
    """

    journal: DeviceJournal
    plan: FaultPlan = field(default_factory=FaultPlan)
    gate: Gate | None = None
    rewrite: Rewrite | None = None


def _plain(kind: int, family: int) -> socket.socket:
    # asyncio sets TCP_NODELAY only where it reads IPPROTO_TCP; without it a small piece waits until the one before it has been
    # acknowledged.
    return socket.socket(family, kind, socket.IPPROTO_TCP if kind == socket.SOCK_STREAM else 0)


class MediumOwner:
    """A tap, as far as it is its medium; see :class:`~.tap.Tap`.

    Args:
        framing: how to decode what passes.
        gate, rewrite: see :class:`Medium`.

    Attributes:
        new_socket: makes the socket of clients, of a type and a family, in the network in which they are.
    """

    def __init__(self, framing: Framing | None, gate: Gate | None = None, rewrite: Rewrite | None = None) -> None:
        self._conversation = None if framing is None else framing.conversation
        self._medium = Medium(DeviceJournal(self._conversation), gate=gate, rewrite=rewrite)
        self.new_socket: NewSocket = _plain

    @property
    def journal(self) -> DeviceJournal:
        """What passed, decoded."""
        return self._medium.journal

    @property
    def injected(self) -> Counter[Action]:
        """How often each fault of the plan in effect was really injected."""
        return self._medium.plan.injected

    def begin_journal(self) -> None:
        """Begin an empty journal that counts from 0 again."""
        self._medium.journal = DeviceJournal(self._conversation)

    async def settle(self) -> None:
        """Return when the journal has all that has passed until now: at once, as nothing passes without it."""

    async def more(self, timeout_s: float) -> None:
        """Return when there is more in the journal, or after so many seconds."""
        await self.journal.recorded(timeout_s)
