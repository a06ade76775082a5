"""Says what did not run: outside witnesses, which is software that nobody here wrote, and walls that this machine refuses.

A test that needs one is skipped where it cannot be had, and a green run would look as if the witness had agreed and the walls had stood.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Protocol

__all__ = ["Skipped", "not_run"]

_TOLD = {
    "foreign_software/": "OUTSIDE WITNESS NOT RUN (tests with foreign software: {count}): {reason}",
    "test_walls": "WALLS NOT TRIED (tests: {count}): {reason}",
}
"""A part of a test's id, and the line about such tests."""


class Skipped(Protocol):
    """The report of a skipped test, as far as it is read here; ``longrepr`` ends with the reason."""

    nodeid: str
    longrepr: tuple[str, int, str]


def not_run(skipped: Iterable[Skipped]) -> Iterator[str]:
    """Yield a line for each reason for which such tests were skipped."""
    reasons = Counter(
        (part, report.longrepr[2].removeprefix("Skipped: "))
        for report in skipped
        for part in _TOLD
        if part in report.nodeid
    )
    for (part, reason), count in reasons.items():
        yield _TOLD[part].format(count=count, reason=reason)
