"""The journal and the fault plan that the connections of one tap share, and what every tap tells of them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from ...protocols.protocol import Framing
from ..journal import DeviceJournal
from .faults import Action, FaultPlan

__all__ = ["Medium", "MediumOwner"]


@dataclass(slots=True)
class Medium:
    """The journal and the fault plan of one tap; both may be replaced while connections are open."""

    journal: DeviceJournal
    plan: FaultPlan = field(default_factory=FaultPlan)


class MediumOwner:
    """A tap, as far as it is its medium; see :class:`~.tap.Tap`.

    Args:
        framing: how to decode what passes.
    """

    def __init__(self, framing: Framing | None) -> None:
        self._conversation = None if framing is None else framing.conversation
        self._medium = Medium(DeviceJournal(self._conversation))

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
