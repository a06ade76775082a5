"""The devices of a stored run: their journals must be one chain over all items, in the order of time. Pure.

From one item to the next a device's journal continues without a gap, unless the device was started again. Within an item
every look at a device says when it was asked for and when its answer was there: the entries that the look shows are from
before the answer, the entries that it does not show are from after the question.

What an entry says is read from its frame. An entry without one must be of an event that is no message, or have held a secret.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..core.strict_json import same_json
from ..protocols.registry import protocols
from ..record.redaction import REDACTED
from ..record.schema import Device, ItemDevice, JournalEntry, SessionStart
from ..trial.cursor import JournalCursor
from .connections import EVENTS, Connections
from .reply import HistoryError

__all__ = ["DeviceHistory"]


class DeviceHistory:
    """One device through all items of a run.

    Attributes:
        name: the device's name in the run record.
        facts: about the device, as the record has them.
        cursor: position of its adapter in its journal.
        accepting_ns: monotonic time since which it accepts connections; 0 before the first item.
        unknown: the last item ended before its time, or could not be judged again: what reached the device since is unknown.
    """

    def __init__(self, name: str, facts: Device) -> None:
        self.name = name
        self.facts = facts
        self.cursor = JournalCursor(facts["protocol"], facts["first"])
        self.accepting_ns = 0
        self.unknown = False
        self._protocol = protocols()[facts["protocol"]]
        self._connections = Connections(facts["first"])
        self._floor_ns = 0
        self._last_ns = 0
        self._opened = (0, 0)
        self._examined = 0

    def enter(self, found: ItemDevice) -> None:
        """Begin an item at this device.

        Raises:
            HistoryError: the item does not find the device as the item before it left it.
        """
        cursor = self.cursor
        unknown, self.unknown = self.unknown, False
        quiet = cursor.quiet
        if found["starts"] != cursor.starts and not unknown:
            raise HistoryError(
                f"{self.name} was started again {found['starts']} time(s) before, the items before show {cursor.starts}"
            )
        while cursor.starts < found["starts"]:
            self.restart()
        if found["quiet"] != quiet and not unknown:
            raise HistoryError(f"{self.name} was {'' if quiet else 'not '}left alone since the last item that had it")
        if self.accepting_ns not in (0, found["accepting_ns"]) and not unknown:
            raise HistoryError(
                f"{self.name} accepted connections since {self.accepting_ns} ns, the record says {found['accepting_ns']}"
            )
        if found["accepting_ns"] > found["asked_ns"]:
            raise HistoryError(f"{self.name} accepted connections only after the item had looked at it")
        self.accepting_ns = found["accepting_ns"]
        self.has_session(found["session"], found["seen_ns"])
        proof = found.get("proof")
        if unknown:
            cursor.next = max(cursor.next, found["begin"] - len(found["before"]))
            cursor.assume(proof)
        elif not same_json(proof, cursor.proof):
            raise HistoryError(f"the items before do not show of the session at {self.name} that its proof is {proof}")
        self.looked(found["before"], found["begin"], found["seen_ns"])
        self.take(found["before"], found["begin"], found["asked_ns"])
        if not found["quiet"]:
            cursor.forget_faults()

    def restart(self) -> None:
        """Take into account that the device was started again: its journal counts from 0, and so do its connections."""
        self.cursor.restart()
        self._connections.restart()
        self._opened = (0, 0)
        self._examined = 0

    def has_session(self, session: SessionStart | None, seen_ns: int) -> None:
        """Begin a session that was there at ``seen_ns``, if its number is not that of the session before."""
        if session is not None and (self.cursor.session is None or session[0] != self.cursor.session[0]):
            number, seq = session
            self.open_session(seq, seen_ns, number)

    def open_session(self, seq: int, by_ns: int, number: int | None = None) -> None:
        """Begin a session.

        Args:
            seq: sequence number of the journal at which it began.
            by_ns: moment at which it had begun: entries from after that are not from before the session.
            number: of the session; by default the next one.
        """
        self.cursor.open_session(seq, number)
        self._opened = (seq, by_ns)

    def looked(self, entries: Sequence[JournalEntry], until: int, seen_ns: int) -> None:
        """Check what a look at the journal showed: the entries from the end of the last slice to before ``until``.

        Raises:
            HistoryError: there is a gap, or the time of an entry does not fit; or as :meth:`_examine`.
        """
        begin = self.cursor.next
        if until < begin:
            raise HistoryError(
                f"the journal of {self.name} was taken up to entry {begin}, the record goes back to {until}"
            )
        found = [entry["seq"] for entry in entries]
        if len(found) != until - begin or any(seq != begin + index for index, seq in enumerate(found)):
            wanted = f"the entries {begin} to {until - 1}" if until > begin else "no entries"
            raise HistoryError(f"the journal of {self.name} should have {wanted}, it has {_listed(found)}")
        last_ns = max(self._last_ns, self._floor_ns)
        opened, by_ns = self._opened
        for entry in entries:
            if entry["seq"] < opened and entry["t_ns"] > by_ns:
                raise HistoryError(
                    f"the session at {self.name} began before {by_ns} ns, entry {entry['seq']} of the journal is from after "
                    f"that, and the record has the session begin at entry {opened}"
                )
            if not last_ns <= entry["t_ns"] <= seen_ns:
                raise HistoryError(
                    f"entry {entry['seq']} of the journal of {self.name} is not of its time: {entry['t_ns']} ns is not "
                    f"between {last_ns} and {seen_ns}"
                )
            last_ns = entry["t_ns"]
        # Before the steps decide by these entries what they do next.
        self._examine(entries)

    def take(self, entries: Sequence[JournalEntry], until: int, asked_ns: int) -> None:
        """Take a slice: the entries after it must be from after it was asked for.

        Raises:
            HistoryError: as :meth:`_examine`.
        """
        self.cursor.take(entries, until)
        self._floor_ns = max(self._floor_ns, asked_ns)
        if entries:
            self._last_ns = entries[-1]["t_ns"]
        self._examine(entries)

    def _examine(self, entries: Sequence[JournalEntry]) -> None:
        """Check the entries that no earlier look has shown.

        Raises:
            HistoryError: an entry contradicts itself or the entries before it, or holds no message.
        """
        for entry in entries:
            if entry["seq"] < self._examined:
                continue
            self._examined = entry["seq"] + 1
            of_order = self._connections.contradiction(entry)
            wrong = _against_contract(entry) or self._unread(entry) or of_order
            if wrong is not None:
                raise HistoryError(f"entry {entry['seq']} of the journal of {self.name} {wrong}")

    def _unread(self, entry: JournalEntry) -> str | None:
        """Say of an entry that it was not read from a frame as it should have been; None of any other."""
        if self._protocol.framing is None:
            return None
        if "frame" in entry:
            return "has a frame that is no message" if entry["kind"] == "malformed" else None
        is_event = entry["origin"] == "kit" or entry["kind"] in EVENTS or entry["kind"] in self._protocol.events
        if (is_event and not entry["request"]) or REDACTED in str(entry):
            return None
        return f"is called {entry['kind']!r}, and has no frame"


def _against_contract(entry: JournalEntry) -> str | None:
    """Say what no entry of any protocol can be (:mod:`pytest_otmcp.core.journal_entry`); None where it can."""
    if entry["direction"] == "out" and entry["kind"] in ("CONNECTED", "DISCONNECTED"):
        return f"is a {entry['kind']!r}, and is called an answer of the device"
    if entry["direction"] == "out" and (entry["request"] or entry["state_changing"]):
        return "was sent by the device, and is called a request"
    if entry["state_changing"] and not entry["request"]:
        return "may change the plant, and is called no request"
    if entry["request"] and entry["kind"] in EVENTS:
        return f"is a {entry['kind']!r}, which asks nothing, and is called a request"
    return None


def _listed(numbers: Sequence[int]) -> str:
    shown = ", ".join(map(str, numbers[:8]))
    return f"[{shown}{', …' if len(numbers) > 8 else ''}]"
