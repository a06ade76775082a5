"""The evidence of failed items: for each item the repetitions that show a fault, with findings and conversation. Pure.

All evidence is in the record. A page holds enough of it to understand a fault, and stays small enough to be opened even when
an adapter fails everywhere with texts of the greatest length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import escape

from ..record.warnings import failing
from . import Item, Run, command
from .exchange import Event, conversation
from .findings import beside
from .text import clipped

__all__ = ["Evidence", "Failure", "failures"]

_LETTERS = 6_000_000
"""Letters of evidence, as HTML has them: items after so many are shown with their first findings only."""
_REPETITIONS = 3
_EVENT_LETTERS = 700
"""Letters that the markup of an event takes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Limits:
    """Limits of what is shown of a repetition: number of findings, and letters of their texts."""

    findings: int
    letters: int
    conversation: bool


_FULL = _Limits(findings=8, letters=1_000, conversation=True)
_SHORT = _Limits(findings=2, letters=200, conversation=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """A part of an item that failed: one repetition, or the steps around the repetitions.

    Attributes:
        command: shell command that runs this part again.
        findings: with ``message``, ``requirement``, ``code`` and ``evidence``.
        more_findings: number of findings that are not shown.
        events: the conversation; see :func:`pytest_otmcp.report.exchange.conversation`.
    """

    title: str
    command: str
    findings: list[dict[str, object]]
    more_findings: int
    events: list[Event | int]

    @property
    def letters(self) -> int:
        """Estimated number of letters of its HTML."""
        texts = [str(value) for finding in self.findings for value in finding.values()]
        for event in self.events:
            if isinstance(event, Event):
                texts += [event.text, *(text for _, text in event.more)]
        return sum(len(escape(text)) for text in texts) + _EVENT_LETTERS * len(self.events)


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """An item that did not pass, with the evidence that is shown, and a note on the evidence that is not."""

    item: Item
    evidence: list[Evidence]
    note: str


def failures(run: Run) -> list[Failure]:
    """Return every item that applies and did not pass, with its evidence."""
    found: list[Failure] = []
    letters = 0
    for item in run["items"]:
        if item["status"] not in ("PASS", "NOT_APPLICABLE"):
            failure = _failure(run, item, _FULL if letters < _LETTERS else _SHORT)
            letters += sum(part.letters for part in failure.evidence)
            found.append(failure)
    return found


def _failure(run: Run, item: Item, limits: _Limits) -> Failure:
    # The same fault in thirty repetitions is one fault: one repetition of each kind of failure is shown.
    kinds: dict[tuple[str, ...], list[int]] = {}
    for index, sample in enumerate(item["samples"]):
        if not sample["ok"]:
            found = failing(sample["findings"])
            kind = tuple(sorted({f"{finding['code']} {finding.get('requirement')}" for finding in found}))
            kinds.setdefault(kind, []).append(index)
    evidence = [_repetition(run, item, alike, limits) for alike in list(kinds.values())[:_REPETITIONS]]
    if own := failing(item["findings"]):
        calls = [call for part in item["around"] for call in part["calls"] if call.get("frames")]
        device = [entry for part in item["around"] for entry in part["device"]]
        title = "Around the repetitions: warm-up, set-up and controls"
        evidence.append(_evidence(title, command(run, item), own, calls, device, limits))
    notes = []
    if told := beside(item):
        notes.append(f"It failed for {told}: what it is about is shown.")
    if len(kinds) > _REPETITIONS:
        notes.append(f"{len(kinds) - _REPETITIONS} more kinds of failing repetitions are in run.json.")
    if missing := item["planned"] - len(item["samples"]):
        notes.append(f"{missing} of {item['planned']} repetitions did not run.")
    if not limits.conversation:
        notes.append("What was said and seen is in run.json.")
    return Failure(item=item, evidence=evidence, note=" ".join(notes))


def _repetition(run: Run, item: Item, alike: Sequence[int], limits: _Limits) -> Evidence:
    sample = item["samples"][alike[0]]
    title = f"Repetition {alike[0] + 1} of {item['planned']}"
    if len(alike) > 1:
        title += f", and {len(alike) - 1} more like it"
    again = command(run, item, alike[0])
    return _evidence(title, again, failing(sample["findings"]), sample["calls"], sample.get("device", []), limits)


def _evidence(
    title: str,
    again: str,
    findings: Sequence[Mapping[str, Any]],
    calls: Sequence[Mapping[str, Any]],
    device: Sequence[Mapping[str, Any]],
    limits: _Limits,
) -> Evidence:
    shown = [
        {
            "message": clipped(finding["message"], limits.letters),
            "requirement": finding.get("requirement"),
            "code": finding["code"],
            "evidence": clipped(str(finding.get("evidence") or ""), limits.letters),
        }
        for finding in findings[: limits.findings]
    ]
    return Evidence(
        title=title,
        command=again,
        findings=shown,
        more_findings=len(findings) - len(shown),
        events=conversation(calls, device) if limits.conversation else [],
    )
