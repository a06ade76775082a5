"""The faults that a tap can inject, as data: the n-th frame gets one action. No randomness, no sockets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["STREAM_ACTIONS", "Action", "FaultPlan", "FaultRule"]


class Action(StrEnum):
    """A fault: what happens to a frame, or to a connection."""

    REFUSE = "refuse"
    """The connection is reset before a byte has passed; the rule counts connections. For a port that refuses, see
    :meth:`pytest_otmcp.plant.tap.tap.Tap.down`."""
    RESET = "reset"
    """Both sides get a TCP reset instead of the frame."""
    BLACK_HOLE = "black_hole"
    """This frame and all after it, in both directions of the connection, are discarded; the connection stays open."""
    DROP = "drop"
    """The frame is discarded; the frames after it pass."""
    DELAY = "delay"
    """The frame, and everything after it, is ``seconds`` late."""
    DRIP = "drip"
    """The frame passes byte by byte, ``seconds`` apart."""
    TRUNCATE = "truncate"
    """Only the frame's first ``length`` bytes pass; the connection stays open."""
    CORRUPT = "corrupt"
    """The byte at ``offset`` (from the end when negative) is combined with ``mask`` by exclusive or."""
    DUPLICATE = "duplicate"
    """The frame passes twice."""
    REORDER = "reorder"
    """The frame passes after the next frame of its direction."""


STREAM_ACTIONS = frozenset({Action.REFUSE, Action.RESET, Action.DRIP})
"""Actions that exist only where there are connections of bytes: datagrams know no connection, and are whole or not at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRule:
    """One action on certain frames.

    Attributes:
        action: what to do.
        direction: ``in`` for frames to the device, ``out`` for frames from it; None for both. Not used by refuse.
        frame: the first frame that is hit, counted from 1 when the plan comes into effect.
        times: how many frames in a row are hit; None for all from then on.
        connection: only this connection; None for any.
        seconds, length, offset, mask: see :class:`Action`.
    """

    action: Action
    direction: str | None = None
    frame: int = 1
    times: int | None = 1
    connection: int | None = None
    seconds: float = 0.0
    length: int = 0
    offset: int = 0
    mask: int = 0xFF


class FaultPlan:
    """Rules in effect. The first rule that hits a frame decides; every rule counts every frame that concerns it.

    Attributes:
        injected: how often each action was really done.
    """

    def __init__(self, rules: Sequence[FaultRule] = ()) -> None:
        self._rules = [(rule, Counter[str]()) for rule in rules]
        self.injected: Counter[Action] = Counter()

    @property
    def empty(self) -> bool:
        """True when the plan has no rules."""
        return not self._rules

    def for_connection(self, connection: int) -> FaultRule | None:
        """Return the rule that refuses a new connection, or None."""
        return self._hit(connection, None)

    def for_frame(self, connection: int, direction: str) -> FaultRule | None:
        """Return the rule that hits the next frame of this direction, or None."""
        return self._hit(connection, direction)

    def _hit(self, connection: int, direction: str | None) -> FaultRule | None:
        chosen = None
        for rule, seen in self._rules:
            if (rule.action is Action.REFUSE) != (direction is None):
                continue
            if direction is not None and rule.direction not in (None, direction):
                continue
            if rule.connection not in (None, connection):
                continue
            seen["frames"] += 1
            last = None if rule.times is None else rule.frame + rule.times - 1
            if chosen is None and rule.frame <= seen["frames"] and (last is None or seen["frames"] <= last):
                chosen = rule
        if chosen is not None:
            self.injected[chosen.action] += 1
        return chosen
