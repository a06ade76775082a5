"""What readers need beside the findings of an item: what it failed for, and what to look at next. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from ..record.schema import Finding
from ..record.warnings import failing, findings_of, passed_beside
from ..suite.catalogue import known_tasks
from ..suite.keys import keys_of_code, keys_of_task
from . import Item

__all__ = ["beside", "subject_keys"]


def beside(item: Item) -> str:
    """Say of an item that failed for what was seen of its sessions beside its steps alone for which rules it did; empty for any other."""
    if not passed_beside(item):
        return ""
    rules = {finding["requirement"] or finding["code"] for finding in failing(findings_of(item))}
    # The item about such a rule does not fail for something beside what it is about.
    return "" if rules & set(item["requirements"]) else f"{' and '.join(sorted(rules))} alone"


def subject_keys(item: Item, finding: Finding) -> list[str]:
    """Describe the keys of the subject file that may be why an item has a finding."""
    return list(dict.fromkeys(_keys(item, finding)))


def _keys(item: Item, finding: Finding) -> Iterator[str]:
    yield from keys_of_code(finding["code"])
    # What an item finds about another rule than its own does not hang on what it asks for. A record may be of another suite.
    about = finding["requirement"] in (None, *item["requirements"])
    if about and (task := known_tasks().get(item["id"])) is not None:
        yield from keys_of_task(task)
