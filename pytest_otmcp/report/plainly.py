"""One call of a failed repetition in plain words: what was asked, what the adapter said, what the device saw. Pure."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from ..protocols.journal import JournalEntry
from ..protocols.registry import protocols
from .text import clipped

__all__ = ["InWords", "in_words"]

_LETTERS = 160
_SHOWN = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class InWords:
    """The call in which a fault shows; ``seen`` has the requests that reached the device meanwhile, none for silence."""

    asked: str
    said: str
    seen: tuple[str, ...]
    more_seen: int


def in_words(calls: Sequence[Mapping[str, Any]], entries: Sequence[Mapping[str, Any]]) -> InWords | None:
    """Tell the call in which the fault shows, as far as a record tells: one that did not go as required, else the last one
    that changed the device, else the first of the task; None without calls."""
    if not calls:
        return None
    requests = [entry for entry in entries if entry.get("request") and entry.get("origin", "client") == "client"]
    changing = [entry for entry in requests if entry.get("state_changing")]
    call = next((call for call in calls if not call["ok"]), None)
    call = call or next((call for call in reversed(calls) if any(_during(call, entry) for entry in changing)), None)
    call = call or next((call for call in calls if call["role"] == "task"), calls[0])
    during = [entry for entry in requests if _during(call, entry)]
    shown = [entry for entry in during if entry.get("state_changing")] or during
    return InWords(
        asked=clipped(f"{call.get('tool')} {_json(call.get('arguments'))}", _LETTERS),
        said=clipped(_said(call), _LETTERS),
        seen=tuple(clipped(_described(entry), _LETTERS) for entry in shown[:_SHOWN]),
        more_seen=max(0, len(shown) - _SHOWN),
    )


def _during(call: Mapping[str, Any], entry: Mapping[str, Any]) -> bool:
    sent, received, at = call.get("sent_ns"), call.get("received_ns"), entry.get("t_ns")
    if not isinstance(sent, int) or not isinstance(at, int):
        return False
    return sent <= at and (not isinstance(received, int) or at <= received)


def _said(call: Mapping[str, Any]) -> str:
    envelope = call.get("envelope")
    if call.get("latency_ms") is None:
        return "nothing"
    if not isinstance(envelope, Mapping):
        return "something that is no envelope"
    if envelope.get("success") is True:
        return f"success, {_json(envelope.get('data'))}"
    error = envelope.get("error")
    message = error.get("message") if isinstance(error, Mapping) else None
    return f"{call.get('error_code') or 'failure'}, {_json(message)}"


def _described(entry: Mapping[str, Any]) -> str:
    protocol = protocols().get(str(entry.get("protocol")))
    try:
        return str(entry.get("kind")) if protocol is None else protocol.describe(cast(JournalEntry, entry))
    except (KeyError, TypeError):
        # A record of another kit may have entries with other members.
        return str(entry.get("kind"))


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)
