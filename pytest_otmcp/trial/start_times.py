"""Judges the wall-clock times in envelopes and on the wire: ``meta.started_at`` of a call lies within the call, the time of a message
near its arrival. Pure.

Calls have times of the monotonic clock; an item's beginning and end have been read from both clocks, which ties them together.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from ..core.finding import Finding
from ..protocols.stamp import Stamp
from .ledger import Judged

__all__ = ["StartTimes"]

_TOLERANCE_S = 2.0
"""A time may be given in whole seconds, and clocks are set while a run goes on."""

_AHEAD_S = 60.0
"""Seconds by which a clock on the wire may be ahead of the kit's."""


class StartTimes:
    """The times at which calls of one item say that they started, and those that adapters put on the wire.

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

    def compare(self, adapter: str, stamp: Stamp) -> None:
        """Take a time on the wire into account; of several faults of one adapter the first is kept."""
        key = f"{adapter} on the wire"
        seen = self._wall(stamp.seen_ns)
        late_s = seen.timestamp() - stamp.ms / 1000
        if -_AHEAD_S <= late_s <= stamp.oldest_s or key in self._faults:
            return
        received = seen.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        self._faults[key] = Finding(
            code="time_off",
            message=f"{adapter}: {stamp.of} has the time {stamp.ms} ms since 1970, the device received it at {received}",
            requirement=stamp.requirement,
        )

    def _wall(self, ns: int) -> datetime:
        return self._began_at + timedelta(microseconds=(ns - self._began_ns) / 1000)

    def faults(self, ended_at: str, ended_ns: int) -> list[Finding]:
        """Return what was found; nothing when the wall clock was set during the item."""
        moved = datetime.fromisoformat(ended_at) - self._wall(ended_ns)
        return [] if abs(moved.total_seconds()) > _TOLERANCE_S / 2 else list(self._faults.values())
