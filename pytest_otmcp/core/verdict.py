"""The verdict over a run: pure functions of the statuses of its items.

The rules of this file:

1. An item that was not tested never counts as passed. An item that did not run makes a run incomplete, a claimed
   operation that cannot be exercised fails, and a run in which no item passed is not evidence of conformance.
2. A fault of the kit says nothing about the adapter: the verdict is indeterminate, also where the adapter failed.
3. A known deviation can make the exit code a success until the deviation expires; it never changes the verdict. A
   deviation that is no longer needed makes the run fail, so that the list of deviations does not become out of date.
4. A worse status of one item never gives a better verdict, and the order of the items does not matter.

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
    "INEXPRESSIBLE",
    "UNBOUND",
    "DeviationReport",
    "ExitCode",
    "KnownDeviation",
    "Status",
    "Verdict",
    "decide",
    "exit_code",
    "judge_deviations",
]

INEXPRESSIBLE = (
    "the subject reads by named readings alone, and the item asks for",
    "no named command of the subject can express",
)
"""Beginnings of the reason for which an item does not apply that asks for a read, or for a write, which only other adapters can make."""

UNBOUND = "no binding of the subject is for"
"""Beginning of the reason for which an item does not apply that asks for what an adapter has no tool for, or only with other inputs."""


class Status(StrEnum):
    """The result of one item."""

    PASS = "PASS"  # noqa: S105  (no password)
    FAIL = "FAIL"
    NOT_APPLICABLE = "NOT_APPLICABLE"
    """The subject does not claim an operation or facet that the item needs: the only legitimate skip."""
    NOT_TESTABLE = "NOT_TESTABLE"
    """The subject claims the operation, but the kit cannot exercise it: counts as a failure."""
    KIT_ERROR = "KIT_ERROR"
    """The kit failed; this says nothing about the adapter."""
    INTERRUPTED = "INTERRUPTED"
    """The run ended while the item was running."""


class Verdict(StrEnum):
    """The verdict on the subject of a run."""

    CONFORMANT = "CONFORMANT"
    """Every item of the set that applies passed, and at least one applies."""
    NOT_CONFORMANT = "NOT CONFORMANT"
    """At least one item failed; further items could not change that, so the set need not be complete."""
    INDETERMINATE = "INDETERMINATE"
    """The kit failed, or no item applied; this says nothing about the subject."""
    INCOMPLETE = "INCOMPLETE"
    """Every item that ran passed, but some of the set did not run."""


class ExitCode(IntEnum):
    """The exit code of a run, and of the command ``otmcp``."""

    CONFORMANT = 0
    NOT_CONFORMANT = 1
    """The verdict is NOT CONFORMANT or INCOMPLETE, or a deviation is stale or expired."""
    USAGE = 2
    """A request of the user cannot be carried out, or the user interrupted the run, or nothing applied: the subject file claims nothing
    that could be asked."""
    INDETERMINATE = 3
    """The kit failed."""


_EXIT_CODES = {
    Verdict.CONFORMANT: ExitCode.CONFORMANT,
    Verdict.NOT_CONFORMANT: ExitCode.NOT_CONFORMANT,
    Verdict.INCOMPLETE: ExitCode.NOT_CONFORMANT,
    Verdict.INDETERMINATE: ExitCode.INDETERMINATE,
}
_FAILURES = (Status.FAIL, Status.NOT_TESTABLE)


def decide(statuses: Mapping[str, Status], required: Collection[str]) -> Verdict:
    """Return the verdict on a run.

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
        # No item applied, so there is no evidence.
        return Verdict.INDETERMINATE
    return Verdict.CONFORMANT


class KnownDeviation(Protocol):
    """A known failure that the vendor wants to be excused until a certain day."""

    @property
    def item(self) -> str:
        """Id of the item that fails."""

    @property
    def expires(self) -> datetime.date:
        """The last day on which it is excused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviationReport:
    """The known deviations of a subject after a run, sorted as in the footer of ``run.json``.

    Attributes:
        used: items whose failure is excused.
        stale: items without a failure to excuse: they passed, or do not apply.
        expired: items whose excuse has expired, and that still do not pass.
        verdict_without_excused: the verdict if the excused items were not claimed.
    """

    used: tuple[str, ...]
    stale: tuple[str, ...]
    expired: tuple[str, ...]
    verdict_without_excused: Verdict

    @property
    def sound(self) -> bool:
        """True when no deviation is stale or expired."""
        return not self.stale and not self.expired

    def as_record(self) -> dict[str, list[str]]:
        """Return the three lists as the footer of ``run.json`` has them."""
        return {"used": list(self.used), "stale": list(self.stale), "expired": list(self.expired)}


def judge_deviations(
    deviations: Iterable[KnownDeviation],
    statuses: Mapping[str, Status],
    required: Collection[str],
    today: datetime.date,
) -> DeviationReport:
    """Sort the known deviations into used, stale and expired ones.

    A deviation whose item did not run, or ended in a fault of the kit, is neither used nor stale.

    Args:
        deviations: the known deviations of the subject.
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
    # An excused item is left out; it does not count as passed. If every item is excused, no evidence is left.
    remaining = {item: Status.NOT_APPLICABLE if item in used else status for item, status in statuses.items()}
    return DeviationReport(
        used=tuple(sorted(used)),
        stale=tuple(sorted(stale)),
        expired=tuple(sorted(expired)),
        verdict_without_excused=decide(remaining, required),
    )


def exit_code(
    verdict: Verdict, deviations: DeviationReport | None = None, *, statuses: Iterable[Status] = ()
) -> ExitCode:
    """Return the exit code of a run.

    Known deviations turn a failure into success when nothing else is wrong; a stale or expired one turns success into
    failure.

    Args:
        verdict: verdict on the whole run, deviations not considered.
        deviations: the sorted deviations, or None for a subject without any.
        statuses: of all items: where none of them applied, what is wrong is the subject file.
    """
    if verdict is Verdict.INDETERMINATE and set(statuses) == {Status.NOT_APPLICABLE}:
        return ExitCode.USAGE
    if deviations is None or _EXIT_CODES[verdict] == ExitCode.INDETERMINATE:
        return _EXIT_CODES[verdict]
    if not deviations.sound:
        return ExitCode.NOT_CONFORMANT
    return ExitCode.CONFORMANT if deviations.verdict_without_excused is Verdict.CONFORMANT else _EXIT_CODES[verdict]
