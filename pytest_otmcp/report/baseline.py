"""What is new in a run since an earlier one, and what was mended, by rule. Pure but for the reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..record.condensed import condensed
from ..record.reader import open_record
from . import Run, applies
from .causes import causes

__all__ = ["Baseline", "read_baseline", "since"]

_SHOWN = 5
"""Rules that are named."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """The rules that were broken in an earlier run.

    Attributes:
        broken: rule and protocol to the items that the cause touched.
    """

    broken: Mapping[tuple[str, str], tuple[str, ...]]


def read_baseline(path: Path) -> Baseline:
    """Read the record of an earlier run.

    Raises:
        RecordError: it cannot be read or believed.
    """
    with open_record(path, allow_incomplete=True) as stored:
        return Baseline({(one.rule, one.family): one.items for one in causes(condensed(stored))})


def since(baseline: Baseline, run: Run) -> str:
    """Say which rules are broken that were not, and which are kept that were broken.

    A rule counts as mended only where every item that showed the fault was run again and applies.
    """
    broken = [(one.rule, one.family) for one in causes(run)]
    ran = {item["id"] for item in run["items"] if applies(item)}
    new = [name for name in broken if name not in baseline.broken]
    mended = [name for name, items in baseline.broken.items() if name not in broken and ran.issuperset(items)]
    unknown = [name for name in baseline.broken if name not in broken and name not in mended]
    told = [(new, "new"), (mended, "mended"), (unknown, "not asked again")]
    said = [f"{len(names)} {what} ({_named(names)})" for names, what in told if names]
    return f"since the baseline {', '.join(said) or 'nothing has changed'}"


def _named(names: list[tuple[str, str]]) -> str:
    more = [f"{len(names) - _SHOWN} more"] if len(names) > _SHOWN else []
    return ", ".join([*(f"{rule} {family}" for rule, family in names[:_SHOWN]), *more])
