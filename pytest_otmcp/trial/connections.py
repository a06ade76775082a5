"""Counts the connections that an adapter leaves open at its device. Pure."""

from __future__ import annotations

from ..core.finding import Finding
from ..protocols.journal import Entries

__all__ = ["connections_left"]

_MOST = 8
"""New connections that may stay open after one repetition: controllers have room for a few clients only."""


def connections_left(entries: Entries) -> list[Finding]:
    """Judge how many of the connections that the adapter made in one repetition are open at its end.

    Args:
        entries: journal of the device in the repetition.
    """
    left: set[int] = set()
    for entry in entries:
        if entry["origin"] == "client" and entry["kind"] == "CONNECTED":
            left.add(entry["connection"])
        elif entry["kind"] == "DISCONNECTED":
            left.discard(entry["connection"])
    if len(left) <= _MOST:
        return []
    return [
        Finding(
            code="connections_left",
            message=f"the adapter has made {len(left)} connections to the device and left them open",
            requirement="CON-006",
        )
    ]
