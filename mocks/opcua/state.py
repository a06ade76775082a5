"""What the parts of an OPC UA device share: connections, service calls and sessions all work on this."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..journal import Journal
from .browsing import Browser
from .faults import FaultPlan
from .limits import Limits
from .plant import Plant

__all__ = ["DeviceState"]


@dataclass(slots=True, kw_only=True)
class DeviceState:
    """The state of one device.

    Attributes:
        journal: where connections and service calls are recorded.
        plant: the nodes and their values.
        faults: the fault plan in force.
        limits: what the server can take at once.
        browsers: those of the open sessions of clients, one for each session.
    """

    journal: Journal
    plant: Plant
    faults: FaultPlan = field(default_factory=lambda: FaultPlan([]))
    limits: Limits = field(default_factory=Limits)
    browsers: set[Browser] = field(default_factory=set)
