"""Says which outside witnesses did not run: software that nobody here wrote, such as MCP's own conformance suite and inspector.

A test that needs such software is skipped where it cannot be had, and a green run would look as if the witness had agreed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Protocol

__all__ = ["Skipped", "not_run"]

_FOLDER = "foreign_software/"


class Skipped(Protocol):
    """The report of a skipped test, as far as it is read here; ``longrepr`` ends with the reason."""

    nodeid: str
    longrepr: tuple[str, int, str]


def not_run(skipped: Iterable[Skipped]) -> Iterator[str]:
    """Yield a line for each reason for which tests with foreign software were skipped."""
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in skipped if _FOLDER in report.nodeid)
    for reason, count in reasons.items():
        yield f"OUTSIDE WITNESS NOT RUN (tests with foreign software: {count}): {reason}"
