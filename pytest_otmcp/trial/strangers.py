"""What others than the adapter under test did at the devices of an item: left out of the judgement, and noted. Pure.

Bytes of a stranger, or of a process whose session is over, accuse nobody and prove nothing. Only when a stranger has changed what
a device holds, nothing that was seen from then on says anything about the adapter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ..core.text import printable
from ..protocols.journal import Entries, JournalEntry
from ..protocols.registry import protocols
from ..record.schema import Stranger

__all__ = ["Strangers"]

_Other = Literal["former", "stranger", "unknown"]

_SHOWN = 3
_SHOWN_BYTES = 24


@dataclass(slots=True)
class _Group:
    connections: set[tuple[int, int]] = field(default_factory=set)
    received: int = 0
    sent: dict[str, None] = field(default_factory=dict)


class Strangers:
    """Collects the entries of journals that are nobody's under test.

    Attributes:
        disturbance: the sentence on the first request of another program that changed what a device holds; None without one.
    """

    def __init__(self) -> None:
        self._groups: dict[tuple[str, _Other, str | None], _Group] = {}
        self._unanswered: dict[str, dict[int, JournalEntry]] = {}
        self.disturbance: str | None = None

    def take(self, at: str, entries: Entries, *, watched: bool = True) -> None:
        """Take a slice of a journal.

        Args:
            at: name of the adapter whose device it is.
            watched: the device is in the state that the item needs; before, a change does no harm.
        """
        unanswered = self._unanswered.setdefault(at, {})
        for entry in entries:
            if entry["seq"] == 0:
                # The device was started anew; what was asked of the one before has changed nothing here.
                unanswered.clear()
            asked = None if entry["answers"] is None else unanswered.pop(entry["answers"], None)
            if asked is not None and protocols()[at.partition("@")[0]].carried_out(asked, entry):
                self._disturbed(at, asked)
            origin = entry["origin"]
            if origin == "stranger" or origin == "former" or origin == "unknown":
                self._note(at, entry, origin)
                if watched and entry["state_changing"]:
                    disturbs = _disturbs(at, entry)
                    if disturbs:
                        self._disturbed(at, entry)
                    elif disturbs is None:
                        unanswered[entry["seq"]] = entry

    def _disturbed(self, at: str, entry: JournalEntry) -> None:
        self.disturbance = self.disturbance or (
            f"another program, {_program(entry)}, changed the device of {at} meanwhile "
            f"({printable(_shown(at, entry))}): nothing can be judged; end that program and run this again"
        )

    def _note(self, at: str, entry: JournalEntry, origin: _Other) -> None:
        if origin == "unknown" and entry["kind"] == "CONNECTED":
            # Who it is shows when it speaks, or ends without having spoken.
            return
        if origin == "former" and not entry["request"]:
            # That connections of a session end with it is nothing to speak of.
            return
        group = self._groups.setdefault((at, origin, _name(entry)), _Group())
        process = entry.get("process")
        group.connections.add((0 if process is None else process["pid"], entry["connection"]))
        if entry["direction"] == "in" and entry["kind"] not in ("CONNECTED", "DISCONNECTED"):
            group.received += 1
            if len(group.sent) < _SHOWN:
                group.sent[printable(_shown(at, entry))] = None

    def noted(self) -> list[Stranger]:
        """What the record of the item says of them."""
        return [
            {
                "at": at,
                "origin": origin,
                "program": program,
                "connections": len(group.connections),
                "messages": group.received,
                "sent": list(group.sent),
            }
            for (at, origin, program), group in sorted(self._groups.items(), key=lambda pair: str(pair[0]))
        ]


def _disturbs(at: str, entry: JournalEntry) -> bool | None:
    """Tell whether a state-changing request leaves nothing to be judged; None if its answer decides."""
    protocol = protocols()[at.partition("@")[0]]
    if entry["origin"] == "former":
        # What an adapter says of itself as it ends is its own affair, commands are not.
        return bool(protocol.unsolicited([entry], {}))
    return protocol.carried_out(entry, None)


def _name(entry: JournalEntry) -> str | None:
    process = entry.get("process")
    return None if process is None else printable(process["name"])


def _program(entry: JournalEntry) -> str:
    process = entry.get("process")
    return "which ended at once" if process is None else f"{printable(process['name'])} (process {process['pid']})"


def _shown(at: str, entry: JournalEntry) -> str:
    fields: Mapping[str, Any] = entry
    if entry["kind"] != "malformed":
        return protocols()[at.partition("@")[0]].describe(entry)
    first = bytes.fromhex(fields.get("bytes") or "")[:_SHOWN_BYTES]
    return f"{first!r}, which is no message of the protocol"
