"""The verdict over a run: pure functions of what every item came to.

The rules of this file:

1. Nothing turns green by not having been tested. An item that did not run makes a run incomplete, a claimed operation
   that cannot be exercised fails, and where nothing at all passed there is no evidence of anything.
2. A fault of the kit says nothing about the adapter: the verdict is indeterminate, whatever else was found.
3. A known deviation is a debt. It can turn the exit code green, never the verdict, and only until its day; one that is
   not needed any more fails, so that no list of excuses outlives its reasons.
4. What is worse for one item is never better for the run, and the order of the items does not matter.

The verdicts, best first: ``CONFORMANT``, ``INCOMPLETE``, ``NOT CONFORMANT``, ``INDETERMINATE``.
"""

from __future__ import annotations

import datetime
import difflib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Protocol

from .errors import UsageError

__all__ = [
    "DeviationReport",
    "ExitCode",
    "KnownDeviation",
    "Status",
    "Verdict",
    "decide",
    "exit_code",
    "judge_deviations",
]


class Status(StrEnum):
    """What one item came to."""

    PASS = "PASS"  # noqa: S105  (no password)
    FAIL = "FAIL"
    NOT_APPLICABLE = "NOT_APPLICABLE"
    """The subject does not claim what the item needs: the only legitimate skip."""
    NOT_TESTABLE = "NOT_TESTABLE"
    """Claimed, but cannot be exercised: counts as a failure."""
    KIT_ERROR = "KIT_ERROR"
    """A fault of the kit; nothing is said about the adapter."""
    INTERRUPTED = "INTERRUPTED"
    """The run ended while the item was running."""


class Verdict(StrEnum):
    """What a run says about its subject."""

    CONFORMANT = "CONFORMANT"
    """Every item of the set that applies passed, and at least one applies."""
    NOT_CONFORMANT = "NOT CONFORMANT"
    """Something failed: true of the subject however much of the set is missing."""
    INDETERMINATE = "INDETERMINATE"
    """The kit failed, or nothing applied: nothing is said about the subject."""
    INCOMPLETE = "INCOMPLETE"
    """What ran passed, but that was not the whole set."""


class ExitCode(IntEnum):
    """What a run, and the command ``otmcp``, tell a shell."""

    CONFORMANT = 0
    NOT_CONFORMANT = 1
    """Also for a set that is not complete, and for deviations that are stale or expired."""
    USAGE = 2
    """What was asked for cannot be done, or the user interrupted it."""
    INDETERMINATE = 3
    """A fault of the kit, or nothing that applies."""


_EXIT_CODES = {
    Verdict.CONFORMANT: ExitCode.CONFORMANT,
    Verdict.NOT_CONFORMANT: ExitCode.NOT_CONFORMANT,
    Verdict.INCOMPLETE: ExitCode.NOT_CONFORMANT,
    Verdict.INDETERMINATE: ExitCode.INDETERMINATE,
}
_FAILURES = (Status.FAIL, Status.NOT_TESTABLE)


def decide(statuses: Mapping[str, Status], required: Collection[str]) -> Verdict:
    """The verdict.

    Args:
        statuses: item id to status, for every item that ran.
        required: ids of all items that the whole set has.
    """
    found = set(statuses.values())
    if Status.KIT_ERROR in found:
        return Verdict.INDETERMINATE
    if not found.isdisjoint(_FAILURES):
        return Verdict.NOT_CONFORMANT
    if Status.INTERRUPTED in found or not set(required) <= statuses.keys():
        return Verdict.INCOMPLETE
    if Status.PASS not in found:
        # Nothing applied: that is no evidence of anything.
        return Verdict.INDETERMINATE
    return Verdict.CONFORMANT


class KnownDeviation(Protocol):
    """A failure that the vendor knows of and wants to be excused for a while."""

    @property
    def item(self) -> str:
        """Id of the item that fails."""

    @property
    def expires(self) -> datetime.date:
        """The last day on which it is excused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviationReport:
    """What became of the known deviations, as the footer of ``run.json`` has it.

    Attributes:
        used: items whose failure is excused.
        stale: items that have nothing to excuse: they passed, or do not apply.
        expired: items whose excuse has run out, and that did not turn out well since.
        left: the verdict if the excused items were not claimed.
    """

    used: tuple[str, ...]
    stale: tuple[str, ...]
    expired: tuple[str, ...]
    left: Verdict

    @property
    def sound(self) -> bool:
        """Every deviation is one that may still be there."""
        return not self.stale and not self.expired

    def as_record(self) -> dict[str, list[str]]:
        """The three lists."""
        return {"used": list(self.used), "stale": list(self.stale), "expired": list(self.expired)}


def judge_deviations(
    deviations: Iterable[KnownDeviation],
    statuses: Mapping[str, Status],
    required: Collection[str],
    today: datetime.date,
) -> DeviationReport:
    """What became of the known deviations.

    A deviation whose item did not run, or ended in a fault of the kit, is neither used nor stale.

    Args:
        deviations: of the subject.
        statuses, required: as for :func:`decide`.
        today: a deviation holds until the end of the day on which it expires.

    Raises:
        UsageError: a deviation is about an item that the set does not have; one sentence.
    """
    used, stale, expired = set[str](), set[str](), set[str]()
    for deviation in deviations:
        item = deviation.item
        if item not in statuses and item not in required:
            near = difflib.get_close_matches(item, {*required, *statuses}, 1)
            hint = f"did you mean {near[0]!r}?" if near else "remove the deviation"
            raise UsageError(f"deviation: there is no item {item!r} in the suite; {hint}")
        status = statuses.get(item)
        if status in (Status.PASS, Status.NOT_APPLICABLE):
            stale.add(item)
        elif today > deviation.expires:
            expired.add(item)
        elif status in _FAILURES:
            used.add(item)
    used -= expired
    # An excuse takes an item out, it does not make it a pass: what excuses everything leaves no evidence either.
    left = {item: Status.NOT_APPLICABLE if item in used else status for item, status in statuses.items()}
    return DeviationReport(
        used=tuple(sorted(used)),
        stale=tuple(sorted(stale)),
        expired=tuple(sorted(expired)),
        left=decide(left, required),
    )


def exit_code(verdict: Verdict, deviations: DeviationReport | None = None) -> ExitCode:
    """The exit code of a run.

    Known deviations turn a failure green when nothing else is wrong; one that is stale or expired turns success red.

    Args:
        verdict: of the whole run, deviations not considered.
        deviations: what became of them, or None for a subject without any.
    """
    if deviations is None or _EXIT_CODES[verdict] == ExitCode.INDETERMINATE:
        return _EXIT_CODES[verdict]
    if not deviations.sound:
        return ExitCode.NOT_CONFORMANT
    return ExitCode.CONFORMANT if deviations.left is Verdict.CONFORMANT else _EXIT_CODES[verdict]
