"""Judges the wall-clock times in envelopes: ``meta.started_at`` of a call lies within the call. Pure.

Calls have times of the monotonic clock; an item's beginning and end have been read from both clocks, which ties them together.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from ..core.finding import Finding
from .ledger import Judged

__all__ = ["StartTimes"]

_TOLERANCE_S = 2.0
"""A time may be given in whole seconds, and clocks are set while a run goes on."""


class StartTimes:
    """The times at which calls of one item say that they started.

    Args:
        began_at: RFC 3339; when the item began.
        began_ns: monotonic; the same moment.
    """

    def __init__(self, began_at: str, began_ns: int) -> None:
        self._began_at = datetime.fromisoformat(began_at)
        self._began_ns = began_ns
        self._faults: dict[str, Finding] = {}

    def look(self, call: Judged) -> None:
        """Take a call into account; of several faults of one adapter the first is kept."""
        reply = call.reply
        meta = (reply.envelope or {}).get("meta")
        stated = meta.get("started_at") if isinstance(meta, dict) and reply.native else None
        received_ns = reply.exchange.received_ns
        if not isinstance(stated, str) or received_ns is None or reply.adapter in self._faults:
            return
        try:
            started = datetime.fromisoformat(stated)
        except ValueError:
            # Reported as such.
            return
        if started.tzinfo is None:
            return
        tolerance = timedelta(seconds=_TOLERANCE_S)
        first, last = self._wall(reply.exchange.sent_ns), self._wall(received_ns)
        if not first - tolerance <= started <= last + tolerance:
            made = first.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
            self._faults[reply.adapter] = Finding(
                code="started_at_off",
                message=f"{reply.label}: meta.started_at says {stated}, the call was made at {made}",
                requirement="ENC-007",
            )

    def _wall(self, ns: int) -> datetime:
        return self._began_at + timedelta(microseconds=(ns - self._began_ns) / 1000)

    def faults(self, ended_at: str, ended_ns: int) -> list[Finding]:
        """Return what was found; nothing when the wall clock was set during the item."""
        moved = datetime.fromisoformat(ended_at) - self._wall(ended_ns)
        return [] if abs(moved.total_seconds()) > _TOLERANCE_S / 2 else list(self._faults.values())
