"""The interface between a trial and the driver that carries it out.

A trial decides what is done and what the result means. A driver does it on a bench (``live_driver``), or looks up in the
stored history of a run what was done (``replay.driver``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, TypedDict

from ..core.verdict import Status
from ..protocols.journal import Entries
from ..protocols.protocol import Declared
from ..record.schema import ItemDevice, Role, SessionRemark, ToldSecret, ToolsChanged
from ..session.canary import Leak
from .asked_for import AskedFor
from .repetition import Repetition
from .task import Steps

__all__ = ["ItemHistory", "SessionFacts", "TrialDriver"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionFacts:
    """Remarkable facts about a session, apart from its replies.

    Attributes:
        protocol: whose session it is.
        overflow: a message arrived that was longer than the kit accepts.
        died: words for how the adapter ended although nobody asked it to; or None. Only determined when a session ends.
        overstayed: words for how it was made to end, as it did not exit when its stdin was closed; or None.
        unknown_ids: ids of responses to requests that were never sent.
        repeated_ids: ids of requests that were answered more than once.
        too_deep: how many messages were nested deeper than can be read.
        stray_lines: how many lines on stdout were no MCP message.
        first_stray: the first of them.
        leaks: secrets that were told: the variable, the place, and how it was written.
        tools_changed: words for how the list of tools has changed; or None.
    """

    protocol: str
    overflow: bool = False
    died: str | None = None
    overstayed: str | None = None
    unknown_ids: tuple[str, ...] = ()
    repeated_ids: tuple[str, ...] = ()
    too_deep: int = 0
    stray_lines: int = 0
    first_stray: str = ""
    leaks: tuple[Leak, ...] = ()
    tools_changed: ToolsChanged | None = None

    @property
    def remarkable(self) -> bool:
        """At least one of the facts deviates from a clean session."""
        ids = self.unknown_ids or self.repeated_ids
        said = self.stray_lines or self.leaks or self.tools_changed
        return bool(self.overflow or self.died or self.overstayed or ids or self.too_deep or said)

    def as_record(self, inspection: int) -> SessionRemark:
        """Return the facts as an item has them, with the number of the inspection."""
        remark: SessionRemark = {
            "inspection": inspection,
            "protocol": self.protocol,
            "overflow": self.overflow,
            "died": self.died,
            "overstayed": self.overstayed,
            "unknown_ids": list(self.unknown_ids),
            "stray_lines": self.stray_lines,
            "first_stray": self.first_stray,
        }
        if self.repeated_ids:
            remark["repeated_ids"] = list(self.repeated_ids)
        if self.too_deep:
            remark["too_deep"] = self.too_deep
        if self.leaks:
            remark["leaks"] = [ToldSecret(variable=one.variable, place=one.place, form=one.form) for one in self.leaks]
        if self.tools_changed is not None:
            remark["tools_changed"] = self.tools_changed
        return remark


class ItemHistory(TypedDict):
    """Members that a driver contributes to an item; see :class:`~pytest_otmcp.record.schema.ItemBody`."""

    worker: str
    started_at: str
    finished_at: str
    began_ns: int
    ended_ns: int
    devices: dict[str, ItemDevice]
    sessions: list[SessionRemark]


class TrialDriver(Protocol):
    """The interface of a driver; a trial uses its methods in this order."""

    def obstacle(self) -> tuple[Status, str] | None:
        """Say why the task cannot be run for this subject; None when it can be."""

    def spent(self, what: str) -> AbstractContextManager[None]:
        """Count the time inside the block as spent on ``what``."""

    async def prepare(self) -> None:
        """Bring the devices into their initial state and open the sessions."""

    def before(self) -> Sequence[tuple[str, Entries, Declared, AskedFor]]:
        """Return the protocol and the journal of each device whose adapter was not called since its last item, and what was asked for."""

    def repetition(self, rep: int, role: Role) -> Repetition:
        """Return the next repetition, ready to be performed."""

    async def perform(self, repetition: Repetition, steps: Steps) -> None:
        """Execute the steps; afterwards every device runs again and the repetition has its journals."""

    async def inspect(self) -> list[SessionFacts]:
        """Return what is remarkable about the sessions so far."""

    def told_at_start(self) -> list[SessionFacts]:
        """Return the secrets that were told by adapters that could not be started."""

    async def end_sessions(self) -> list[SessionFacts]:
        """End all sessions, because one of them did not answer; return what is remarkable about them."""

    async def open_sessions(self) -> None:
        """Make sure that every session can be used."""

    async def close(self, *, renew: bool) -> None:
        """End the item: release what only it needs.

        Args:
            renew: the next items begin with sessions of their own.
        """

    def timing_ms(self) -> Mapping[str, float]:
        """Return the milliseconds by what they were spent on, since this driver was made."""

    def history(self) -> ItemHistory:
        """Return what the item has to keep of this driver, so that it can be judged again."""
        ...
