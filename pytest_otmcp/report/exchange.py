"""One repetition as a conversation: messages of host and adapter, and journal entries of the device, in order of time. Pure.

Calls and journals have the same clock, the machine's monotonic clock. Events without a time come first, and a reply that
never came comes last.
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from ..protocols.journal import JournalEntry
from ..protocols.registry import protocols
from .text import clipped

__all__ = ["Event", "conversation", "told_by_the_device"]

_HEAD, _TAIL, _BAD, _AROUND = 40, 10, 10, 3
"""Numbers of events shown of a long conversation: first ones, last ones, bad ones, and those on each side of a bad one."""

_DETAILED = 12
"""Calls shown with envelope and frames."""

_SHORT, _LONG = 300, 3_000
"""Characters of a line, and of an envelope or a frame."""

_NEVER = 2**63
"""Time of a reply that did not come: after everything that the device saw."""

_ROLES = {
    "task": "",
    "control": "control",
    "setup": "set-up",
    "warmup": "warm-up",
    "recovery": "while recovering",
}
_LEFT_OUT = frozenset({"stranger", "former", "unknown"})
_PLACED = frozenset({"protocol", "variant", *JournalEntry.__annotations__})
"""Members of an entry that are not listed among its facts: its place in the conversation shows them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One message, or event of a connection, in a conversation.

    Attributes:
        at_ms: milliseconds since the first event whose time is known; None when its own time is not known.
        lane: ``adapter`` (between host and adapter) or ``device`` (on the device's wire).
        towards: the message goes in the direction of the device.
        who: adapter or device, with variant and role where they matter.
        what: kind of the message, in a word or two.
        text: content in one line.
        bad: the message was not what the item expected, as far as this is known of a single call.
        changes: the device counts the message as a request that changes its state.
        more: name and text of each part that is too long for a line.
    """

    at_ms: float | None
    lane: str
    towards: bool
    who: str
    what: str
    text: str
    bad: bool = False
    changes: bool = False
    more: tuple[tuple[str, str], ...] = ()


def conversation(calls: Sequence[Mapping[str, object]], entries: Iterable[Mapping[str, object]]) -> list[Event | int]:
    """Return the events in their order; a number stands for that many events that are left out."""
    # Envelopes and frames of failed calls are more useful than those of the first calls.
    ranked = sorted(range(len(calls)), key=lambda index: (calls[index]["ok"], index))
    detailed = set(ranked[:_DETAILED])
    timed: list[tuple[int | None, Event]] = []
    for index, call in enumerate(calls):
        timed += _call(call, detailed=index in detailed)
    timed += [(_whole(entry.get("t_ns")), _entry(entry)) for entry in entries]
    begun = min((at for at, _ in timed if at is not None and at != _NEVER), default=0)
    # The sort is stable: events with the same time, or none, stay in the order of the record.
    timed.sort(key=lambda pair: (pair[0] is not None, pair[0] or 0))
    return _cut([_at(event, at, begun) for at, event in timed])


def _cut(events: list[Event]) -> list[Event | int]:
    bad = [index for index, event in enumerate(events) if event.bad and event.lane == "adapter"][:_BAD]
    kept = {*range(_HEAD), *range(len(events) - _TAIL, len(events))}
    kept |= {near for index in bad for near in range(index - _AROUND, index + _AROUND + 1)}
    shown: list[Event | int] = []
    for index, event in enumerate(events):
        if index in kept:
            shown.append(event)
        elif shown and isinstance(shown[-1], int):
            shown[-1] += 1
        else:
            shown.append(1)
    return shown


def _at(event: Event, at: int | None, begun: int) -> Event:
    return event if at in (None, _NEVER) else replace(event, at_ms=(at - begun) / 1e6)


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) else None


def _call(call: Mapping[str, Any], *, detailed: bool) -> list[tuple[int | None, Event]]:
    frames = call.get("frames") or {}
    who = str(call.get("adapter", "adapter"))
    if call.get("variant", "rw") != "rw":
        who += " (writes disabled)"
    if role := _ROLES.get(call["role"], call["role"]):
        who += f", {role}"
    request = Event(
        at_ms=None,
        lane="adapter",
        towards=True,
        who=who,
        what=str(call.get("tool")),
        text=clipped(_json(call.get("arguments")), _SHORT),
        more=_more(detailed, ("request frame", frames.get("request"))),
    )
    what, text = _answer(call, frames)
    envelope = call.get("envelope")
    reply = Event(
        at_ms=None,
        lane="adapter",
        towards=False,
        who=who,
        what=what,
        text=text,
        bad=not call["ok"],
        more=_more(
            detailed,
            ("envelope", None if envelope is None else _json(envelope, indent=2)),
            ("response frame", frames.get("response")),
        ),
    )
    sent, received = _whole(call.get("sent_ns")), _whole(call.get("received_ns"))
    if sent is not None and received is None:
        received = _NEVER
    return [(sent, request), (received, reply)]


def _answer(call: Mapping[str, object], frames: Mapping[str, object]) -> tuple[str, str]:
    latency = call.get("latency_ms")
    if latency is None:
        return "no reply", str(frames.get("failure") or "").replace("_", " ")
    after = f"after {latency:.2f} ms"
    envelope = call.get("envelope")
    if not isinstance(envelope, Mapping):
        return "no envelope", after
    if envelope.get("success") is True:
        return "success", f"{clipped(_json(envelope.get('data')), _SHORT)}, {after}"
    error = envelope.get("error")
    message = error.get("message") if isinstance(error, Mapping) else None
    return str(call.get("error_code") or "failure"), f"{clipped(str(message or ''), _SHORT)}, {after}"


def _more(wanted: bool, *pairs: tuple[str, object]) -> tuple[tuple[str, str], ...]:
    return tuple((name, clipped(str(text), _LONG)) for name, text in pairs if wanted and text is not None)


def told_by_the_device(entry: Mapping[str, object]) -> str:
    """Return what an entry is, and what is in it, in a line."""
    event = _entry(entry)
    return f"{event.what} {event.text}".strip()


def _entry(entry: Mapping[str, object]) -> Event:
    who = f"{entry.get('protocol', '')} device, connection {entry.get('connection')}"
    if (origin := entry.get("origin")) in _LEFT_OUT:
        who += f" ({origin})"
    if entry.get("variant"):
        who += " (writes disabled)"
    facts = [f"{key}={_fact(key, value)}" for key, value in entry.items() if key not in _PLACED and value is not None]
    return Event(
        at_ms=None,
        lane="device",
        towards=entry.get("direction") == "in",
        who=who,
        what=_title(entry),
        text=clipped(" ".join(facts), _SHORT),
        bad=entry.get("exception") is not None,
        changes=entry.get("state_changing") is True,
    )


def _title(entry: Mapping[str, object]) -> str:
    protocol = protocols().get(str(entry.get("protocol")))
    if protocol is None or protocol.title is None:
        return str(entry.get("kind"))
    return protocol.title(cast(JournalEntry, entry))


def _fact(key: str, value: object) -> str:
    if key == "payload" and isinstance(value, str):
        try:
            text = base64.b64decode(value, validate=True).decode()
        except (binascii.Error, UnicodeDecodeError):
            return value
        return _json(text) if text.isprintable() else value
    return value if isinstance(value, str) else _json(value)


def _json(value: object, indent: int | None = None) -> str:
    return json.dumps(value, ensure_ascii=False, indent=indent)
