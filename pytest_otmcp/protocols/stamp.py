"""A wall-clock time that an adapter puts on the wire. Pure."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Stamp"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamp:
    """A wall-clock time that an adapter puts on the wire.

    Attributes:
        of: what has this time, such as ``DDATA of device-1``.
        ms: the time, in milliseconds since 1970-01-01 UTC.
        seen_ns: monotonic; when the device received it.
        oldest_s: seconds that may lie between this time and the moment at which the device received it.
        requirement: id of the requirement that a wrong time breaks.
    """

    of: str
    ms: int
    seen_ns: int
    oldest_s: float
    requirement: str
