"""What a verbose run prints besides: a table for each suite, and what the time was spent on. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from ..core.matrix import KNOWN_SUITES
from ..core.statistics import mean, mean_interval, percentile
from ..record.consistency import count_calls
from . import Item, Run, applies, deadlines, durations, least, not_reached, phases, recovered, tally
from .console_lines import Line, failed, wrapped
from .text import at_least, count, interval, number, shortened

__all__ = ["tables", "time_budget"]

_NONE = "---"
_BENCHMARK = ("tool calls", "MCP client", "endpoint restarts", "fresh sessions")
"""Activities that are the benchmark itself, the client's share of a tool call included."""

_WIDE = 120
"""Columns from which on there is room for mean and interval; a narrower terminal shows the task's title instead."""

_NARROW = 80
"""Columns below which the recovery table has short headings."""


def tables(run: Run, width: int) -> Iterator[Line]:
    """Yield the table of each suite that ran, without the items that do not apply."""
    for suite in KNOWN_SUITES:
        items = [item for item in run["items"] if item["suite"] == suite and applies(item)]
        if items:
            yield "", "plain"
            yield from _recovery(run, items, width) if suite == "recovery" else _suite(run, suite, items, width)


def _suite(run: Run, suite: str, items: list[Item], width: int) -> Iterator[Line]:
    more = f"{'mean ms':>9}{'95 % CI':>17}" if width >= _WIDE else ""
    wide = max(7, *(len(item["id"]) + 1 for item in items))
    yield f"{suite:<{wide + 2}}{'passed':>9}{'at least':>10}{'median ms':>11}{'p95 ms':>9}{more}   task", "head"
    for item in items:
        times = durations(run, [item])
        row = f"  {item['id']:<{wide}}{_count(*tally([item])):>9}{at_least(least(item), _NONE):>10}"
        row += f"{_number(percentile(times, 50)):>11}{_number(percentile(times, 95)):>9}"
        if more:
            row += f"{_number(mean(times)):>9}{interval(mean_interval(times), _NONE, '..'):>17}"
        title = item["title"] if item["status"] == "PASS" else f"{item['status']}: {item['title']}"
        yield shortened(f"{row}   {title}", width), _style(item)


def _recovery(run: Run, items: list[Item], width: int) -> Iterator[Line]:
    names = ("same session", "median ms", "fresh session", "median ms")
    columns = (14, 11, 15, 11)
    if width < _NARROW:
        names, columns = ("same", "ms", "fresh", "ms"), (8, 9, 8, 9)
    heads = "".join(f"{name:>{column}}" for name, column in zip(names, columns, strict=True))
    yield f"{'recovery':<11}{'detect ms':>10}{heads}", "head"
    for item in items:
        cells = [_number(percentile(phases(run, item, "detect"), 50)).rjust(10)]
        for index, way in enumerate(("same_session", "fresh_session")):
            cells.append(_count(*recovered([item], way)).rjust(columns[2 * index]))
            cells.append(_number(percentile(phases(run, item, way), 50)).rjust(columns[2 * index + 1]))
        note = "" if item["status"] == "PASS" else f"   {item['status']}"
        if missing := not_reached(item):
            note += f", {missing} not reached"
        yield shortened(f"  {item['id']:<9}{''.join(cells)}{note}", width), _style(item)


def _count(good: int, total: int) -> str:
    return count(good, total, _NONE)


def _number(value: float | None) -> str:
    return number(value, _NONE)


def _style(item: Item) -> str:
    return "bad" if failed(item) else "plain"


def time_budget(run: Run, width: int) -> Iterator[Line]:
    """Yield what the time was spent on, which calls are counted apart, and the deadlines of a call."""
    calls = count_calls(run["items"])
    others = ", ".join(f"{count} {role}" for role, count in calls.items() if role != "task")
    texts = ["", f"calls counted apart: {others}"]
    # A killed run has neither a time breakdown nor an elapsed time.
    if spent := run["footer"].get("breakdown_s"):
        total = sum(spent.values()) or 1.0
        parts = (
            f"{what} {seconds:.1f} s ({100 * seconds / total:.0f} %)"
            for what, seconds in sorted(spent.items(), key=lambda entry: -entry[1])
        )
        outside = 100 * (1 - sum(spent.get(what, 0.0) for what in _BENCHMARK) / total)
        texts.append(f"{run['footer']['elapsed_s']:.1f} s: {', '.join(parts)}")
        texts.append(f"{outside:.0f} % of that outside of tool calls, endpoint restarts and fresh sessions")
    if told := deadlines(run):
        texts.append(f"deadlines of a call: {told}")
    for text in texts:
        for line in wrapped(text, width, "  "):
            yield line, "plain"
