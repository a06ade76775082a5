"""The medium between a device and its clients, and the conditions that it can be in; what each does is with each kind of medium."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from .fault_rules import one_of
from .journal import Journal

__all__ = ["CONDITIONS", "Medium", "MessageMedium"]

CONDITIONS = ("open", "black_hole", "stalled")


class Medium(ABC):
    """What a device and its clients are joined by.

    Args:
        journal: of the device.

    Attributes:
        condition: one of :data:`CONDITIONS`.
    """

    def __init__(self, journal: Journal) -> None:
        self.condition = "open"
        self._journal = journal

    def poke(self, params: Mapping[str, Any]) -> bool:
        """Apply the parameters of a poke that are about the medium: ``{"network": "black_hole"}``; tell whether it was one.

        Raises:
            ValueError: there is no such condition, or the poke has other members.
        """
        if "network" not in params:
            return False
        condition, field = params["network"], one_of(*CONDITIONS)
        if not field.accepts(condition) or len(params) > 1:
            raise ValueError(f"a poke of the network is {{'network': …}} with {field.expected}, found {dict(params)!r}")
        self.become(str(condition))
        return True

    def become(self, condition: str) -> None:
        """Change the condition, for clients that are known and for new ones; the journal has every change."""
        if condition == self.condition:
            return
        self.condition = condition
        self._journal.event(connection=0, direction="out", kind="network", origin="kit", condition=condition)
        self._changed()

    @abstractmethod
    def _changed(self) -> None:
        """Follow the condition, which is another one now."""


class MessageMedium(Medium):
    """A medium without connections: what it holds back is messages, or pieces of them."""

    def __init__(self, journal: Journal) -> None:
        super().__init__(journal)
        self._held: list[Callable[[], None]] = []

    def _arrived(self, number: int, count: int, deliver: Callable[[], None]) -> None:
        """Deliver so many bytes of a client, or lose them, or hold them back."""
        if self.condition == "black_hole":
            self._journal.event(connection=number, direction="in", kind="lost", count=count)
        elif self.condition == "stalled":
            self._held.append(deliver)
        else:
            deliver()

    def _changed(self) -> None:
        held, self._held = self._held, []
        for go_on in held if self.condition == "open" else ():
            go_on()
