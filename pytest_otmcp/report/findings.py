"""The findings of an item as readers need them: each fault once, and what to look at next. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ..core.finding import Kind, kind_of
from ..record.schema import Finding
from ..record.warnings import failing, findings_of, passed_beside
from ..suite.catalogue import all_tasks
from ..suite.keys import keys_of_code, keys_of_task
from . import Item

__all__ = ["Fault", "beside", "cited", "faults", "subject_keys"]


@dataclass(slots=True, kw_only=True)
class Fault:
    """A finding, and the repetitions that show it.

    Attributes:
        finding: the first of its kind.
        repetitions: from 0; none for one that was found before, between or after them.
    """

    finding: Finding
    repetitions: list[int]

    def where(self, planned: int) -> str:
        """Say which repetitions show it, before the message."""
        if not self.repetitions:
            return ""
        more = f" and {len(self.repetitions) - 1} more" if len(self.repetitions) > 1 else ""
        return f"rep {self.repetitions[0] + 1}/{planned}{more}: "


def faults(item: Item) -> list[Fault]:
    """Return every fault of an item about a MUST once: first those that no repetition shows, which may explain the others."""
    found: dict[Kind, Fault] = {}

    def add(finding: Finding, repetition: int | None) -> None:
        kind = kind_of(finding["code"], finding["requirement"], finding["message"])
        fault = found.setdefault(kind, Fault(finding=finding, repetitions=[]))
        if repetition is not None and repetition not in fault.repetitions[-1:]:
            fault.repetitions.append(repetition)

    for finding in failing(item["findings"]):
        add(finding, None)
    for sample in item["samples"]:
        for finding in failing(sample["findings"]):
            add(finding, sample["repetition"])
    return list(found.values())


def cited(finding: Finding) -> str:
    """Return what ``otmcp explain`` can be asked about a finding: its requirement, if it has one, and its code."""
    return ", ".join(name for name in (finding["requirement"], finding["code"]) if name)


def beside(item: Item) -> str:
    """Say of an item that failed for what was seen of its sessions beside its steps alone for which rules it did; empty for any other."""
    if not passed_beside(item):
        return ""
    rules = {finding["requirement"] or finding["code"] for finding in failing(findings_of(item))}
    # The item about such a rule does not fail for something beside what it is about.
    return "" if rules & set(item["requirements"]) else f"{' and '.join(sorted(rules))} alone"


def subject_keys(item: Item) -> list[str]:
    """Describe the keys of the subject file that may be why an item did not pass."""
    return list(dict.fromkeys(_keys(item)))


def _keys(item: Item) -> Iterator[str]:
    for code in dict.fromkeys(finding["code"] for finding in failing(findings_of(item))):
        yield from keys_of_code(code)
    # A record may be of another suite than the one that is installed here.
    if item["status"] == "FAIL" and (task := all_tasks().get(item["id"])) is not None:
        yield from keys_of_task(task)
