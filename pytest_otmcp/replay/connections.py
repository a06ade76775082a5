"""The connections of a device in a stored run: whose each is, and what its answers answer. Pure.

A connection belongs to one client from its beginning to its end. An adapter's session may end before it, and who cannot be
known counts for the adapter as soon as it speaks; but what is the plant's, the kit's or another program's never becomes the
adapter's, nor the other way round.
"""

from __future__ import annotations

from ..core.journal_entry import JournalEntry
from ..protocols.journal import HANDSHAKES

__all__ = ["EVENTS", "Connections"]

EVENTS = frozenset({"CONNECTED", "DISCONNECTED", "garbage", "lost", "malformed", "mangled", "network", *HANDSHAKES})
"""Kinds of entries that are no messages of a protocol: every witness has them, and none asks the device for anything."""
_UNASKED = EVENTS - {"malformed"}
"""Of these a device on a library may answer what the kit's codec does not understand."""

_MOST_ASKED = 65_536
"""Entries that can still be answered; an answer to an earlier one is believed."""

_STEP = {"unknown": 0, "client": 1, "former": 2}
"""Whose a connection of the adapter is, in the order in which that changes."""


class Connections:
    """What a device's journal has shown so far.

    Args:
        first: sequence number at which the journal is known.
    """

    def __init__(self, first: int) -> None:
        self._asked: dict[int, tuple[int, str]] = {}
        self._known = self._next = first
        self._whose: dict[int, str] = {}
        self._begun: set[int] = set()
        self._whole = first == 0

    def restart(self) -> None:
        """Begin again, as the journal and the numbers of connections do when the device was started again."""
        self._asked.clear()
        self._whose.clear()
        self._begun.clear()
        self._known = self._next = 0
        self._whole = True

    def contradiction(self, entry: JournalEntry) -> str | None:
        """Take the next entry; say in one clause where it contradicts the entries before it, None where it does not."""
        if entry["seq"] != self._next:
            # What an item that could not be judged again has left out.
            self._known = entry["seq"]
            self._whole = False
        self._next = entry["seq"] + 1
        found = self._of_answer(entry) or self._of_owner(entry) or self._of_begin(entry)
        if entry["direction"] == "in":
            self._asked[entry["seq"]] = (entry["connection"], entry["kind"])
            if len(self._asked) > _MOST_ASKED:
                oldest = next(iter(self._asked))
                del self._asked[oldest]
                self._known = oldest + 1
        return found

    def _of_begin(self, entry: JournalEntry) -> str | None:
        number, kind = entry["connection"], entry["kind"]
        if kind == "CONNECTED":
            self._begun.add(number)
        # A witness that has seen none begin may be one of datagrams; of a journal that is not whole, some beginnings are missing.
        if not self._begun or number in self._begun or number == 0 or kind in EVENTS or not self._whole:
            return None
        return f"is of the connection {number}, which did not begin"

    def _of_answer(self, entry: JournalEntry) -> str | None:
        seq = entry["answers"]
        if seq is None:
            return None
        asked = self._asked.get(seq)
        if not 0 <= seq < entry["seq"] or (asked is None and seq >= self._known) or entry["direction"] == "in":
            return f"answers the entry {seq}, which asked nothing"
        if asked is None:
            return None
        connection, kind = asked
        if connection != entry["connection"]:
            return f"answers the entry {seq} of another connection"
        return f"answers the entry {seq}, which is a {kind!r}" if kind in _UNASKED else None

    def _of_owner(self, entry: JournalEntry) -> str | None:
        number, origin = entry["connection"], entry["origin"]
        if number == 0:
            # The kit changes the network, and a device does by itself what its time-outs make it do: neither came from a client. What the kit
            # does has no bytes on the wire, and no connection that could begin or end.
            of_kit = (
                origin == "kit" and entry.get("frame") is None and entry["kind"] not in ("CONNECTED", "DISCONNECTED")
            )
            of_nobody = of_kit or (origin == "plant" and entry["direction"] == "out")
            return None if of_nobody else f"has no connection, and is called the {origin}'s"
        if number in self._whose and entry["kind"] == "CONNECTED":
            return f"begins the connection {number}, which was there already"
        before = self._whose.get(number, origin)
        self._whose[number] = origin
        if entry["kind"] == "DISCONNECTED":
            # What comes after the end, such as a will, is of a connection that nobody remembers.
            del self._whose[number]
        if before == origin or _STEP.get(before, 9) < _STEP.get(origin, 0):
            return None
        return f"is called the {origin}'s, its connection was the {before}'s"
