"""The wire beside a finding: the call that it is about, and what the device's journal has of it, in lines of text. Pure."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from itertools import chain

from pytest_otmcp.core.text import printable
from pytest_otmcp.protocols.journal import ADAPTER
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.schema import Around, Call, DeviceEntry, Finding, Sample
from pytest_otmcp.report.causes import Cause
from pytest_otmcp.report.exchange import Event, conversation

__all__ = ["wire"]

_LINES = 12
_WIDTH = 150
_OF_THE_PROCESS = {"cannot_start", "does_not_exit", "not_proven", "not_proven_again", "start_timeout", "stdout_noise"}
"""Codes of findings that are about the process or its session, not about a call."""
_NONCE = re.compile(r"nonce-[0-9a-f]+")


def wire(cause: Cause) -> list[str]:
    """Return the conversation around the call that a cause's first finding is about; nothing where no call was made."""
    finding = cause.first
    parts = _parts(cause)
    calls = [call for part in parts for call in part["calls"]]
    device = [entry for part in parts for entry in part["device"]]
    calls = [call for call in calls if call["role"] != "setup" or finding["message"].startswith("setup: ")]
    if finding["code"] in _OF_THE_PROCESS or not calls:
        return []
    call = _about(finding, calls, device)
    begin = call["sent_ns"]
    later = [other["sent_ns"] for other in calls if other["sent_ns"] > (call["received_ns"] or begin)]
    end = min(later, default=None)
    nonces = [base64.b64encode(nonce.encode()).decode() for nonce in _NONCE.findall(finding["message"])]
    entries = [
        entry
        for entry in device
        if entry["origin"] == ADAPTER
        and ((entry["t_ns"] >= begin and (end is None or entry["t_ns"] < end)) or entry.get("payload") in nonces)
    ]
    events = [event for event in conversation([call], entries) if isinstance(event, Event)]
    began = min([begin, *(entry["t_ns"] for entry in entries)])
    ended = max([call["received_ns"] or begin, *(entry["t_ns"] for entry in entries)])
    timed = [(event.at_ms or 0.0, _line(event)) for event in events]
    timed += [
        ((at - began) / 1e6, f"{(at - began) / 1e6:>9.2f} {words}") for at, words in _outages(parts, began, ended)
    ]
    # The sort is stable: what has the same time stays in the order of the record.
    lines = [line for _, line in sorted(timed, key=lambda pair: pair[0])]
    if len(lines) > _LINES:
        lines = [*lines[: _LINES - 2], f"          … {len(lines) - _LINES + 1} more …", lines[-1]]
    if not entries:
        lines.append("          the device saw nothing of it")
    return lines


def _parts(cause: Cause) -> Sequence[Sample | Around]:
    """Return what the finding is about: its repetition, or the steps of its role around the repetitions."""
    if cause.repetition is not None:
        return [cause.where["samples"][cause.repetition]]
    role = cause.first["message"].partition(": ")[0]
    return [part for part in cause.where["around"] if part["role"] == role]


def _outages(parts: Sequence[Sample | Around], began: int, ended: int) -> list[tuple[int, str]]:
    """Return when the device was stopped and started meanwhile, and which of the two came last before."""
    looks = [look for part in parts for look in part["observations"]]
    moments = [(look["seen_ns"], "the device is stopped") for look in looks if "stop" in look]
    moments += [(look["start"]["accepting_ns"], "the device is started") for look in looks if "start" in look]
    before = sorted(moment for moment in moments if moment[0] < began)[-1:]
    return [*before, *(moment for moment in moments if began <= moment[0] <= ended)]


def _about(finding: Finding, calls: Sequence[Call], device: Sequence[DeviceEntry]) -> Call:
    """Return the call that a finding is about: the one that it names, or the first that was not as expected.

    Where every reply was as expected the device tells: of the call that had just been made when it saw what the finding has for
    evidence, or of the last one.
    """
    named = [call for call in calls if _names(finding, call)]
    nonces = _NONCE.findall(finding["message"])
    given = (call for call in calls if any(value in nonces for value in call["arguments"].values()))
    bad = [call for call in calls if not call["ok"]]
    seen_ns = next((entry["t_ns"] for entry in device if _shows(finding, entry)), 0)
    made = [call for call in calls if call["sent_ns"] <= seen_ns][-1:]
    return next(chain((call for call in named if call in bad), given, named, bad, made), calls[-1])


def _shows(finding: Finding, entry: DeviceEntry) -> bool:
    """Tell whether a finding's evidence begins with this request of the adapter."""
    evidence = finding["evidence"] or ""
    words = protocols()[entry["protocol"]].describe(entry) if entry["request"] and entry["origin"] == ADAPTER else ""
    return bool(words) and evidence.startswith(words)


def _names(finding: Finding, call: Call) -> bool:
    """Tell whether a finding begins, after its role, with the tool of this call, and has its arguments."""
    values = (repr(value) for value in call["arguments"].values())
    return f"{call['tool']}(" in finding["message"] and all(value in finding["message"] for value in values)


def _line(event: Event) -> str:
    at = "" if event.at_ms is None else f"{event.at_ms:.2f}"
    ends = ("host", "adapter") if event.lane == "adapter" else ("adapter", "device")
    arrow = "→" if event.towards else "←"
    line = printable(f"{at:>9} {ends[0]} {arrow} {ends[1]}  {event.what} {event.text}".rstrip())
    return line if len(line) <= _WIDTH else line[: _WIDTH - 1] + "…"
