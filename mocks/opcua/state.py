"""The state that connections, service calls and sessions of an OPC UA device share."""

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
        limits: the limits of the server.
        browsers: the browsers of the open sessions of clients, one for each session.
    """

    journal: Journal
    plant: Plant
    faults: FaultPlan = field(default_factory=lambda: FaultPlan([]))
    limits: Limits = field(default_factory=Limits)
    browsers: set[Browser] = field(default_factory=set)
