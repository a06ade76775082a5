"""The verdict over a run: a pure function of what every item came to.

Nothing turns green by not having been tested: an item that did not run makes a run incomplete, a claimed operation
that cannot be exercised fails, and a fault of the kit makes the verdict indeterminate.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from enum import StrEnum

__all__ = ["Status", "Verdict", "decide"]


class Status(StrEnum):
    """What one item came to."""

    PASS = "PASS"  # noqa: S105  (no password)
    FAIL = "FAIL"
    NOT_APPLICABLE = "NOT_APPLICABLE"
    """The subject does not claim the protocol: the only legitimate skip."""
    NOT_TESTABLE = "NOT_TESTABLE"
    """Claimed, but cannot be exercised: counts as a failure."""
    KIT_ERROR = "KIT_ERROR"
    """A fault of the kit; nothing is said about the adapter."""
    INTERRUPTED = "INTERRUPTED"
    """The run ended while the item was running."""


class Verdict(StrEnum):
    """What a run says about its subject."""

    CONFORMANT = "CONFORMANT"
    NOT_CONFORMANT = "NOT CONFORMANT"
    INDETERMINATE = "INDETERMINATE"
    INCOMPLETE = "INCOMPLETE"


def decide(statuses: Mapping[str, Status], required: Collection[str]) -> Verdict:
    """The verdict.

    Args:
        statuses: item id to status, for every item that ran.
        required: ids of all items that the whole set has.
    """
    found = set(statuses.values())
    if Status.KIT_ERROR in found:
        return Verdict.INDETERMINATE
    if found & {Status.FAIL, Status.NOT_TESTABLE}:
        return Verdict.NOT_CONFORMANT
    if Status.INTERRUPTED in found or not set(required) <= statuses.keys():
        return Verdict.INCOMPLETE
    if Status.PASS not in found:
        # Nothing applied: that is no evidence of anything.
        return Verdict.INDETERMINATE
    return Verdict.CONFORMANT
