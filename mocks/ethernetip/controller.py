"""What the clients of one controller share: its tags and settings, its connections and sessions, its faults and its journal."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..journal import Journal
from .connections import Connections
from .faults import FaultPlan
from .plant import Plant
from .pokes import Restless

__all__ = ["Controller"]


@dataclass(slots=True, kw_only=True)
class Controller:
    """The state of one controller.

    Attributes:
        restless: bits that turn by themselves.
        connections: the open CIP connections.
        sessions: handles of the sessions that are registered.
        address: host and port on which it serves.
    """

    journal: Journal
    plant: Plant = field(default_factory=Plant)
    faults: FaultPlan = field(default_factory=lambda: FaultPlan([]))
    restless: list[Restless] = field(default_factory=list)
    connections: Connections = field(default_factory=Connections)
    sessions: set[int] = field(default_factory=set)
    address: tuple[str, int] = ("127.0.0.1", 0)

    def reset(self) -> None:
        """Restore the start-up values and drop the faults; connections and sessions stay."""
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.restless = []
        self.connections.forgotten = 0
