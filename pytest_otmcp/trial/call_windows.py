"""Assigns the entries of a device's journal to the calls of a repetition, by their times. Pure.

Calls and journal entries have their times from one clock, the machine's monotonic one. What the device saw between a request
and its reply may belong to that call; a message that nobody answers may also arrive after the reply.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass

from ..protocols.journal import HANDSHAKES, Entries
from .ledger import Entry, Judged

__all__ = ["LATE_NS", "CallWindow", "from_adapter", "windows"]

LATE_NS = 50_000_000
"""How much later than the reply a message of the call that nobody answers may arrive."""

_NO_MESSAGE = ("CONNECTED", "DISCONNECTED", "malformed", "lost", *HANDSHAKES)


@dataclass(frozen=True, slots=True, kw_only=True)
class CallWindow:
    """Calls of one adapter that were made at the same time, and what its device saw meanwhile.

    Attributes:
        calls: in the order of their requests.
        begin_ns: the first request.
        end_ns: the last reply; infinite without one.
        during: entries from the first request to the last reply.
        until_next: entries from the first request to the adapter's next call.
        until_end: entries from the first request to the end of the repetition.
        standing: the last entries before the first request that tell of process data which nothing has changed, one of each connection and
            station: a device tells once of what a master repeats all the time, and the calls may have repeated it as well.
        following: the adapter's next calls in the repetition; None after the last ones.
    """

    calls: tuple[Judged, ...]
    begin_ns: int
    end_ns: float
    during: Entries
    until_next: Entries
    until_end: Entries
    standing: Entries
    following: CallWindow | None


def windows(calls: Iterable[Judged], entries: Entries) -> list[CallWindow]:
    """Group an adapter's calls by the time at which they were made.

    Args:
        calls: of one adapter in one repetition.
        entries: journal of its device in this repetition.
    """
    groups: dict[int, list[Judged]] = {}
    for call in sorted(calls, key=lambda call: call.reply.exchange.sent_ns):
        groups.setdefault(call.group, []).append(call)
    begins = [group[0].reply.exchange.sent_ns for group in groups.values()]
    times = [entry["t_ns"] for entry in entries]
    found: list[CallWindow] = []
    # Each window knows the one after it.
    for group, begin in zip(reversed(groups.values()), reversed(begins), strict=True):
        following = found[-1] if found else None
        received = [call.reply.exchange.received_ns for call in group]
        end = math.inf if None in received else max(time for time in received if time is not None)
        first = bisect_left(times, begin)
        until = math.inf if following is None else following.begin_ns
        found.append(
            CallWindow(
                calls=tuple(group),
                begin_ns=begin,
                end_ns=end,
                during=entries[first : max(first, bisect_right(times, end))],
                until_next=entries[first : max(first, bisect_left(times, until))],
                until_end=entries[first:],
                standing=_standing(entries[:first]),
                following=following,
            )
        )
    return found[::-1]


def _standing(before: Entries) -> Entries:
    cycles = (entry for entry in from_adapter(before) if entry["kind"] == "cycle")
    return list({(entry["connection"], entry.get("station")): entry for entry in cycles}.values())


def from_adapter(entries: Entries) -> list[Entry]:
    """Return the messages that the adapter sent."""
    return [
        entry
        for entry in entries
        if entry["direction"] == "in" and entry["origin"] == "client" and entry["kind"] not in _NO_MESSAGE
    ]
