"""The evidence in a journal entry, and the entry that follows from it. Pure.

A witness records frames. What they say is read from them when a journal is taken, and again whenever a record is read: a record
has of a message its frame and what no frame says, and nothing that could contradict them.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

from ..core.journal_entry import JournalEntry
from .conversation import Conversation, Conversations, Direction, Message

__all__ = ["JournalReader", "entry_of", "evidence"]

_EVIDENCE = ("protocol", "variant", "seq", "t_ns", "connection", "direction", "origin", "process", "frame", "told")
"""Members of a message's entry that do not follow from others."""
_OF_OTHERS = frozenset({"plant", "kit"})

Entry = TypeVar("Entry", bound=Mapping[str, Any])


def entry_of(
    message: Message,
    frame: bytes | None,
    told: Mapping[str, Any],
    *,
    seq: int,
    t_ns: int,
    connection: int,
    origin: str,
) -> JournalEntry:
    """Return the entry of a message.

    Args:
        message: as it was decoded; it gets the number of the entry.
        frame: that made it; None for an event, whose entry is kept as it is.
        told: what the device says beside the frame. Of what the frame says too it is believed about ``answers`` alone, since a fault may
            make an answer name another request, and about what the bytes do not settle (:attr:`Message.unsure`).
        seq, t_ns, connection, origin: see :class:`~pytest_otmcp.core.journal_entry.JournalEntry`.
    """
    of_client = origin not in _OF_OTHERS
    message.seq = seq
    entry: dict[str, Any] = {
        "seq": seq,
        "t_ns": t_ns,
        "connection": connection,
        "direction": message.direction,
        "kind": message.kind,
        "request": message.request and of_client,
        "state_changing": message.state_changing and of_client,
        "answers": None if message.answers is None else message.answers.seq,
        "origin": origin,
        **message.fields,
    }
    unsure = {"answers", *message.unsure}
    more = {
        name: value for name, value in told.items() if name not in entry or (name in unsure and entry[name] != value)
    }
    entry |= more
    if frame is not None and message.kind != "malformed":
        entry["frame"] = " ".join(one.hex() for one in message.frames or (frame,))
        if more:
            entry["told"] = more
    return cast(JournalEntry, entry)


def evidence(entry: Entry) -> Entry:
    """Return what a record keeps of an entry: of a message only what does not follow; an event as it is."""
    if "frame" not in entry:
        return entry
    return cast(Entry, {name: entry[name] for name in _EVIDENCE if name in entry})


class JournalReader:
    """Reader of one device's journal in a record: it makes the entries of the evidence, which must come in order.

    Args:
        conversation: makes the decoder of one connection; None where nothing can be decoded.
    """

    def __init__(self, conversation: Callable[[], Conversation] | None) -> None:
        self._conversation = conversation or _Unread
        self._conversations = Conversations(self._conversation)
        self._last = -1

    def read(self, kept: Entry) -> Entry:
        """Return the next entry from its evidence."""
        if kept["seq"] <= self._last:
            # The device was started again, and its journal with it.
            self._conversations = Conversations(self._conversation)
        self._last = kept["seq"]
        if "frame" not in kept:
            if kept["kind"] == "DISCONNECTED":
                self._conversations.end(kept["connection"])
            return kept
        entry = entry_of(
            self._decoded(kept["connection"], kept["direction"], kept["frame"]),
            b"",
            kept.get("told", {}),
            seq=kept["seq"],
            t_ns=kept["t_ns"],
            connection=kept["connection"],
            origin=kept["origin"],
        )
        # A record may say more of a message than a witness does; none of that is believed.
        return cast(Entry, {**entry, **{name: value for name, value in evidence(kept).items() if name != "told"}})

    def _decoded(self, connection: int, direction: Direction, frames: str) -> Message:
        found: list[Message] = []
        try:
            for frame in frames.split(" "):
                found += self._conversations.decode(connection, direction, bytes.fromhex(frame))
        except (ValueError, LookupError, ArithmeticError, StopIteration, struct.error):
            # A witness cuts frames before they are decoded; this is none that it has cut.
            found = []
        return found[0] if len(found) == 1 else Message(direction=direction, kind="malformed")


class _Unread:
    """A conversation in a protocol that is not installed here."""

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Say nothing of a frame."""
        return [Message(direction=direction, kind="unread")]
