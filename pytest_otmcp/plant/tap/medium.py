"""The journal and the fault plan that the connections of one tap share."""

from __future__ import annotations

from dataclasses import dataclass, field

from .faults import FaultPlan
from .journal import TapJournal

__all__ = ["Medium"]


@dataclass(slots=True)
class Medium:
    """The journal and the fault plan of one tap; both may be replaced while connections are open."""

    journal: TapJournal = field(default_factory=TapJournal)
    plan: FaultPlan = field(default_factory=FaultPlan)
