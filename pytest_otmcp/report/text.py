"""Text of the reports: what came from outside made harmless, and figures as tables print them. Pure.

Everything in a run record may have been written by the adapter under test: its messages, its tool names, its topics.
"""

from __future__ import annotations

from ..core.text import printable

__all__ = ["clipped", "count", "interval", "number", "printable", "shortened"]


def clipped(text: str, limit: int) -> str:
    """Return at most ``limit`` characters of a text, and how many there were."""
    return text if len(text) <= limit else f"{text[:limit]}… ({len(text)} characters, all are in run.json)"


def shortened(text: str, width: int) -> str:
    """Return as much of a text as fits a line of a terminal, made printable."""
    text = printable(text)
    return text if len(text) <= width else text[: width - 3].rstrip() + "..."


def count(good: int, total: int, none: str) -> str:
    """Write ``good/total``, or ``none`` where there was nothing to count."""
    return f"{good}/{total}" if total else none


def number(value: float | None, none: str, digits: int = 2) -> str:
    """Write a figure with ``digits`` decimals, or ``none`` where there is none."""
    return none if value is None else f"{value:.{digits}f}"


def interval(bounds: tuple[float, float] | None, none: str, between: str) -> str:
    """Write an interval with ``between`` its bounds, or ``none`` where there is none."""
    return none if bounds is None else f"{bounds[0]:.2f}{between}{bounds[1]:.2f}"
