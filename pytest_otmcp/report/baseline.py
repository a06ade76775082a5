"""What is new in a run since an earlier one, and what was mended, by rule. Pure but for the reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..record.condensed import condensed
from ..record.reader import open_record
from . import Run, applies
from .causes import causes

__all__ = ["Baseline", "changes", "read_baseline", "since"]

_SHOWN = 5
"""Rules that are named."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """The rules that were broken in an earlier run.

    Attributes:
        broken: rule and protocol to the items that the cause touched.
        ran: ids of the items that applied.
        subject: name of the adapter.
        suite: digest of the suite that judged it.
    """

    broken: Mapping[tuple[str, str], tuple[str, ...]]
    ran: frozenset[str]
    subject: str
    suite: str


def read_baseline(path: Path) -> Baseline:
    """Read the record of an earlier run.

    Raises:
        RecordError: it cannot be read or believed.
    """
    with open_record(path, allow_incomplete=True) as stored:
        run = condensed(stored)
    return Baseline(
        broken={(one.rule, one.family): one.items for one in causes(run)},
        ran=frozenset(item["id"] for item in run["items"] if applies(item)),
        subject=run["subject"]["name"],
        suite=run["kit"]["suite_digest"],
    )


def changes(baseline: Baseline, run: Run) -> dict[str, list[tuple[str, str]]]:
    """Return the rules, each with its protocol, that are newly broken, broken in items that the baseline did not ask, mended, and neither.

    A rule counts as mended only where every item that showed the fault was run again and passed: one that failed for another reason may
    have ended before it asked.
    """
    broken = {(one.rule, one.family): one.items for one in causes(run)}
    unknown = [name for name in broken if name not in baseline.broken]
    unasked = [name for name in unknown if baseline.ran.isdisjoint(broken[name])]
    passed = {item["id"] for item in run["items"] if item["status"] == "PASS"}
    mended = [name for name, items in baseline.broken.items() if name not in broken and passed.issuperset(items)]
    return {
        "new": [name for name in unknown if name not in unasked],
        "not asked before": unasked,
        "mended": mended,
        "not shown again": [name for name in baseline.broken if name not in broken and name not in mended],
    }


def since(baseline: Baseline, run: Run) -> str:
    """Say what has changed, and what else than the adapter may be its cause."""
    said = [f"{len(names)} {what} ({_named(names)})" for what, names in changes(baseline, run).items() if names]
    other = [f"of {baseline.subject}"] if baseline.subject != run["subject"]["name"] else []
    other += ["by another version of the suite"] if baseline.suite != run["kit"]["suite_digest"] else []
    which = f" ({', '.join(other)})" if other else ""
    return f"since the baseline{which} {', '.join(said) or 'nothing has changed'}"


def _named(names: list[tuple[str, str]]) -> str:
    more = [f"{len(names) - _SHOWN} more"] if len(names) > _SHOWN else []
    return ", ".join([*(f"{rule} {family}" for rule, family in names[:_SHOWN]), *more])
