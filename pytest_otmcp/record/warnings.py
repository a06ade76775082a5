"""The findings of a run by strength, and by place: those about a MUST fail, the others are warnings, of which each kind is told once. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypedDict

from ..core.finding_registry import finding_codes
from ..core.text import counted
from .schema import Finding, Item

__all__ = ["Warned", "WarningTally", "failing", "findings_of", "passed_beside", "said", "warnings"]


class Warned(TypedDict):
    """One kind of warning: its requirement and code, the first message, the items and the number of findings."""

    requirement: str | None
    code: str
    message: str
    items: list[str]
    times: int


def findings_of(item: Item) -> list[Finding]:
    """Return all findings of an item: its repetitions' and its own."""
    return [*(finding for sample in item["samples"] for finding in sample["findings"]), *item["findings"]]


def passed_beside(item: Item) -> bool:
    """Tell whether an item failed for what was seen of its sessions beside its steps, such as a line on standard output, and for nothing
    else: it shows what it is about."""
    codes = {finding["code"] for finding in failing(findings_of(item))}
    known = finding_codes()
    samples = item["samples"]
    through = item.get("ended") is None and len(samples) == item["planned"] and all(sample["ok"] for sample in samples)
    beside = codes != set() and all(code in known and known[code].beside for code in codes)
    return item["status"] == "FAIL" and through and beside


def failing(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings about a MUST."""
    return [finding for finding in findings if finding["strength"] == "MUST"]


class WarningTally:
    """Counts findings about a SHOULD, by requirement and code."""

    def __init__(self) -> None:
        self._kinds: dict[tuple[str | None, str], Warned] = {}

    def add(self, item: str, findings: Iterable[Finding]) -> None:
        """Count the warnings among the findings of an item."""
        for finding in findings:
            if finding["strength"] == "MUST":
                continue
            kind = self._kinds.setdefault(
                (finding["requirement"], finding["code"]),
                {
                    "requirement": finding["requirement"],
                    "code": finding["code"],
                    "message": finding["message"],
                    "items": [],
                    "times": 0,
                },
            )
            kind["times"] += 1
            if item not in kind["items"]:
                kind["items"].append(item)

    @property
    def kinds(self) -> list[Warned]:
        """The warnings, in the order in which they came up first."""
        return list(self._kinds.values())


def warnings(items: Iterable[Item]) -> list[Warned]:
    """Return the warnings of a run, one for each requirement and code."""
    tally = WarningTally()
    for item in items:
        tally.add(item["id"], findings_of(item))
    return tally.kinds


def said(warning: Warned) -> str:
    """Write a warning in one line: its requirement, its items and its first message."""
    rule = f"{warning['requirement']}, " if warning["requirement"] else ""
    return f"{rule}{counted(warning['times'], 'time')} in {' '.join(warning['items'])}: {warning['message']}"
