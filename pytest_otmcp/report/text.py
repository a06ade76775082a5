"""Text of the reports: texts from outside made harmless, and numbers as tables print them. Pure.

The adapter under test may have written any text in a run record: its messages, its tool names, its topics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..core.text import counted, printable
from ..record.schema import Counted

__all__ = [
    "at_least",
    "calls_made",
    "clipped",
    "count",
    "counted",
    "interval",
    "number",
    "percent_down",
    "printable",
    "shortened",
]


def calls_made(calls: Mapping[Counted, int]) -> str:
    """Name the calls of the benchmark, and apart from them those of the requirement suite; what prepares and surrounds them is not counted."""
    checks, tasks = calls.get("check", 0), calls.get("task", 0)
    told = [counted(tasks, "tool call")] if tasks or not checks else []
    told += [f"{counted(checks, 'tool call')} of the requirement suite"] if checks else []
    return ", ".join(told)


def clipped(text: str, limit: int) -> str:
    """Return at most ``limit`` characters of a text, and how many there were."""
    return text if len(text) <= limit else f"{text[:limit]}… ({len(text)} characters in all)"


def shortened(text: str, width: int) -> str:
    """Return as much of a text as fits a line of a terminal, made printable."""
    text = printable(text)
    return text if len(text) <= width else text[: width - 3].rstrip() + "..."


def count(good: int, total: int, none: str) -> str:
    """Write ``good/total``, or ``none`` where nothing was counted."""
    return f"{good}/{total}" if total else none


def number(value: float | None, none: str, digits: int = 2) -> str:
    """Write a number with ``digits`` decimals, or ``none`` where there is no number."""
    return none if value is None else f"{value:.{digits}f}"


def percent_down(rate: float) -> float:
    """Return a lower bound, a rate from 0 to 1, in percent with one decimal, rounded down: a bound must not be overstated."""
    return math.floor(1000 * rate) / 10


def at_least(rate: float | None, none: str) -> str:
    """Write a lower bound in percent, such as ``90.4 %``, or ``none`` where there is no bound."""
    return none if rate is None else f"{percent_down(rate):.1f} %"


def interval(bounds: tuple[float, float] | None, none: str, between: str) -> str:
    """Write an interval with ``between`` its bounds, or ``none`` where there is no interval."""
    return none if bounds is None else f"{bounds[0]:.2f}{between}{bounds[1]:.2f}"
