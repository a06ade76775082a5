"""One call of a failed repetition in plain words: what was asked, what the adapter said, what the device saw, what was due. Pure."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from ..core.finding_registry import finding_codes
from ..protocols.journal import JournalEntry
from ..protocols.registry import protocols
from ..record.schema import Finding
from ..subject.answers import UNCLASSIFIED
from ..subject.model import READ_WRITE
from ..trial.alteration import in_words as told_in_words
from ..trial.alteration import label
from .exchange import told_by_the_device
from .text import clipped

__all__ = ["InWords", "due", "in_words"]

_LETTERS = 160
_NO_REPLY = ("no_reply", "session_lost")
_OF_NO_CALL = {"cannot_start", "start_timeout", "does_not_exit", "stdout_noise", "leak", "connections_left"}
"""Codes of findings about a process or a session: no call of it shows them."""
_SEVERAL = ("written_twice", "unasked_write")
"""Codes of findings about requests of which one was asked for."""
_ABOUT_WRITES = ("device_differs", "not_written_once")
"""Codes of findings about what a write has done, which a read beside it only shows."""
_NO_REQUESTS = ("malformed", "lost")
"""Kinds of what an adapter sent that is no request: bytes that mean nothing, and those on a connection whose end has vanished."""
_SHOWN = 3

_VALUES = re.compile(r"-?\d+(?:\.\d+)?|[0-9a-z]{6,}", re.IGNORECASE)

_CODES = "an error with code {0}"
_OUTPUT = "{0} {1}"
_DUE = {
    code: [(re.compile(pattern), words) for pattern, words in sentences]
    for code, sentences in {
        "not_refused": [(r"expected (?:an error envelope|a failure) with code (.+?), ", _CODES)],
        "wrong_error_code": [(r"error code should be (.+?), it is ", _CODES)],
        "wrong_outcome": [(r"error outcome (?:of \w+ )?should be (.+?), it is ", "an error whose outcome is {0}")],
        "not_successful": [(r"expected success, got ", "success")],
        "no_reply": [(r"no reply within the deadline of ([\d.]+ s)", "an answer within {0}")],
        "other_endpoint": [(r"(meta\.endpoint) should be that of the device, (.+?), it is ", _OUTPUT)],
        "wrong_value": [
            (r"\): ([\w './,-]+?) should be (.+?), the reply says ", _OUTPUT),
            (r"\): expected (.+?), the reply says ", "{0}"),
            (r"\): the device holds (.+?), by the subject file the reply means ", "what means {0} at the device"),
        ],
    }.items()
}
"""What a finding's sentence says was due, by its code: the kit's own words alone are read, never an adapter's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InWords:
    """The call in which a fault shows; ``seen`` has the requests that reached the device meanwhile, none for silence; ``answered`` what the
    device answered to the first of them, as far as the record tells."""

    asked: str
    said: str
    seen: tuple[str, ...]
    more_seen: int
    answered: str = ""


def due(finding: Finding) -> str:
    """Say what the adapter should have said, where the finding tells; empty where it does not."""
    for pattern, words in _DUE.get(finding["code"], ()):
        if found := pattern.search(finding["message"]):
            return clipped(words.format(*found.groups()), _LETTERS)
    return ""


def in_words(
    calls: Sequence[Mapping[str, Any]],
    entries: Sequence[Mapping[str, Any]],
    message: str = "",
    code: str = "",
    evidence: str | None = None,
) -> InWords | None:
    """Tell the call in which the fault shows, as far as a record tells: the one that a finding names, else of those during which came what
    it shows, or that gave the values in it, one that did not go as required, else the last one that changed the device, else the first
    of the task; None without calls, and where the finding is about no call.

    Args:
        message: the finding, without the role that it may begin with.
        code: of the finding. What the device contradicts is a claim, and no refusal of the same call by another launch; a missing answer is
            not that of an equal call at the same time.
        evidence: what a finding about the device shows of it.
    """
    if not calls or code in _OF_NO_CALL:
        return None
    every = calls
    named = [call for call in calls if message.startswith(f"{_label(call)}: ")]
    known = finding_codes().get(code)
    if code in _NO_REPLY:
        named = [call for call in named if call.get("latency_ms") is None] or named
    elif known is not None and known.contradicts:
        named = [call for call in named if _claims_success(call)] or named
    requests = [entry for entry in entries if entry.get("request") and entry.get("origin", "client") == "client"]
    changing = [entry for entry in requests if entry.get("state_changing")]
    if code in _SEVERAL:
        # Of equal calls, the one during which it was written again.
        named = sorted(named, key=lambda call: -sum(_during(call, entry) for entry in changing))[:1]
    if code in _ABOUT_WRITES and not named:
        calls = [call for call in calls if _writes(call)] or calls
    calls = named or _shown(calls, requests, evidence) or _closest(calls, message)
    call = next((call for call in calls if not call["ok"]), None)
    call = call or next((call for call in reversed(calls) if any(_during(call, entry) for entry in changing)), None)
    call = call or next((call for call in calls if call["role"] == "task"), calls[0])
    during = [entry for entry in requests if _during(call, entry)]
    # What is no request reached it all the same.
    during = during or [entry for entry in entries if entry.get("kind") in _NO_REQUESTS and _during(call, entry)]
    # What is told too early comes after the answer.
    after = [] if during else [entry for entry in requests if _after(call, entry)]
    if evidence:
        late = [entry for entry in after if _described(entry) in evidence]
    else:
        # What no answer confirms, as a message of QoS 0, may be on its way when the call is answered.
        late = [
            entry for entry in after if entry.get("state_changing") and _writes(call) and _last(every, entry) is call
        ]
    shown = [entry for entry in during if entry.get("state_changing")] or during or late
    return InWords(
        asked=clipped(f"{call.get('tool')} {_json(told_in_words(call.get('arguments') or {}))}", _LETTERS)
        + _launched(call),
        said=clipped(_said(call), _LETTERS),
        seen=tuple(
            clipped(f"{'' if during else '(after the answer) '}{_described(entry)}", _LETTERS)
            for entry in shown[:_SHOWN]
        ),
        more_seen=max(0, len(shown) - _SHOWN),
        answered=_answer_to(shown[0], entries) if shown else "",
    )


def _answer_to(request: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]) -> str:
    number = request.get("seq")
    answers = (entry for entry in entries if number is not None and entry.get("answers") == number)
    return clipped(next(map(told_by_the_device, answers), ""), _LETTERS)


def _writes(call: Mapping[str, Any]) -> bool:
    protocol = protocols().get(str(call.get("adapter")))
    operation = None if protocol is None else protocol.operations.get(str(call.get("operation")))
    return operation is not None and operation.writes


def _claims_success(call: Mapping[str, Any]) -> bool:
    envelope = call.get("envelope")
    return isinstance(envelope, Mapping) and envelope.get("success") is True


def _launched(call: Mapping[str, Any]) -> str:
    variant = call.get("variant", READ_WRITE)
    return "" if variant == READ_WRITE else f" (of the launch {variant!r})"


def _shown(
    calls: Sequence[Mapping[str, Any]], requests: Sequence[Mapping[str, Any]], evidence: str | None
) -> Sequence[Mapping[str, Any]]:
    """Return the calls during which a request came that the evidence shows."""
    if not evidence:
        return []
    meant = [entry for entry in requests if _described(entry) in evidence]
    return [call for call in calls if any(_during(call, entry) for entry in meant)]


def _closest(calls: Sequence[Mapping[str, Any]], message: str) -> Sequence[Mapping[str, Any]]:
    """Return the calls that gave most of the values in a sentence about the device; all of them where none gave one."""
    told = {*_VALUES.findall(message)}

    def shared(call: Mapping[str, Any]) -> int:
        # A random value says more than a small address, which many calls have.
        return sum(len(value) for value in {*_VALUES.findall(_json(call.get("arguments")))} & told if len(value) > 2)

    most = max(map(shared, calls))
    return [call for call in calls if shared(call) == most]


def _during(call: Mapping[str, Any], entry: Mapping[str, Any]) -> bool:
    sent, received, at = call.get("sent_ns"), call.get("received_ns"), entry.get("t_ns")
    if not isinstance(sent, int) or not isinstance(at, int):
        return False
    return sent <= at and (not isinstance(received, int) or at <= received)


def _after(call: Mapping[str, Any], entry: Mapping[str, Any]) -> bool:
    received, at = call.get("received_ns"), entry.get("t_ns")
    return isinstance(received, int) and isinstance(at, int) and at > received


def _last(calls: Sequence[Mapping[str, Any]], entry: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the call that was made last before an entry."""
    return max(
        (call for call in calls if (call.get("sent_ns") or 0) <= entry["t_ns"]),
        key=lambda call: call.get("sent_ns") or 0,
    )


def _said(call: Mapping[str, Any]) -> str:
    envelope = call.get("envelope")
    if call.get("latency_ms") is None:
        return "nothing"
    if not isinstance(envelope, Mapping):
        return "something that is no envelope"
    if _claims_success(call):
        return f"success, {_json(envelope.get('data'))}"
    error = envelope.get("error")
    message = error.get("message") if isinstance(error, Mapping) else None
    outcome = error.get("outcome") if isinstance(error, Mapping) else None
    meta = envelope.get("meta")
    if isinstance(meta, Mapping) and meta.get("synthesised") is True:
        # Code and outcome are the subject file's.
        code = call.get("error_code") or UNCLASSIFIED
        return f"a failure, {_json(message)}" + (
            "" if code == UNCLASSIFIED else f", which the subject file calls {code}"
        )
    return f"{call.get('error_code') or 'failure'}{f' (outcome {outcome})' if outcome else ''}, {_json(message)}"


def _label(call: Mapping[str, Any]) -> str:
    return label(call.get("tool"), call.get("arguments") or {})


def _described(entry: Mapping[str, Any]) -> str:
    if entry.get("kind") == "lost":
        return f"{entry.get('count')} bytes on a connection whose other end has vanished"
    protocol = protocols().get(str(entry.get("protocol")))
    try:
        return str(entry.get("kind")) if protocol is None else protocol.describe(cast(JournalEntry, entry))
    except (KeyError, TypeError):
        # A record of another kit may have entries with other members.
        return str(entry.get("kind"))


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)
