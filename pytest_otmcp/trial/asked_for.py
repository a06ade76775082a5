"""Requests that calls have asked for, by which what an adapter delivers again is known, in the same item or a later one. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from ..protocols.journal import Entries, JournalEntry
from ..protocols.protocol import OtProtocol

__all__ = ["Again", "AskedFor"]

_KEPT, _LONGEST = 1000, 10_000
"""Requests that are kept, and the most characters of one."""

_WHEN_AND_HOW = {"seq", "t_ns", "connection", "dup", "packet_id", "answers", "client_id", "session", "owner", "peer"}
_OF_ITS_TIME = {*_WHEN_AND_HOW, "process", "fault", "frame", "told"}
"""Members of a journal entry that say when and how a request came, and what became of it, and not what it asks for."""


@dataclass(frozen=True, slots=True)
class Again:
    """What is delivered again.

    Attributes:
        label: the call that asked for it, and in which item, where that is another one.
        told: what the protocol's own rules say of it.
    """

    label: str
    told: str


@dataclass(frozen=True, slots=True)
class _Made:
    entry: JournalEntry
    answers: Entries
    label: str
    item: str


class AskedFor:
    """The newest requests of an adapter that its calls have asked for."""

    def __init__(self) -> None:
        self._made: deque[_Made] = deque(maxlen=_KEPT)
        self._on_its_way: list[tuple[str, str]] = []

    def expect(self, labels: Iterable[str], *, item: str) -> None:
        """Note the successful calls of a repetition that is over whose requests the device has not seen yet, one label for each.

        A message that nobody answers, as one of QoS 0, may arrive after the repetition. Those of an earlier repetition are expected no
        longer.
        """
        self._on_its_way = [(label, item) for label in labels]

    def arrives(self, entry: JournalEntry, answers: Entries) -> bool:
        """Say whether a request may be one that was on its way when the last repetition ended; it is expected no more then.

        What the device answers has been seen before its call can be a success.
        """
        if answers or not self._on_its_way:
            return False
        label, item = self._on_its_way.pop(0)
        self.add(entry, answers, label=label, item=item)
        return True

    def add(self, entry: JournalEntry, answers: Entries, *, label: str, item: str) -> None:
        """Note a request with its answers and with the call that asked for it. What is very long is not kept."""
        if sum(len(value) for value in entry.values() if isinstance(value, str)) <= _LONGEST:
            self._made.append(_Made(entry, answers, label, item))

    def again(self, entry: JournalEntry, protocol: OtProtocol, *, item: str) -> Again | None:
        """Say of a request that its protocol's own rules deliver again whose it is; None for any other."""
        wanted = _content(entry)
        first = next((made for made in reversed(self._made) if _content(made.entry) == wanted), None)
        told = "" if first is None else protocol.again(first.answers, [first.entry, entry])
        if first is None or not told:
            return None
        where = "" if first.item == item else f" in {first.item}"
        return Again(f"{first.label}: one write was asked for{where}", told)


def _content(entry: JournalEntry) -> dict[str, object]:
    return {name: value for name, value in entry.items() if name not in _OF_ITS_TIME}
