"""The summary of a run as lines of text. Pure: a run record in, lines with a style out.

Lines hold printable characters only: a text from an adapter can neither colour the terminal nor start a line of its own that
looks like a verdict. The kit's own words are ASCII, for terminals that have nothing else.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from ..core.matrix import SUITES
from ..core.statistics import mean, mean_interval, percentile
from ..core.text import MARK, harmless
from ..record.consistency import count_calls
from ..record.warnings import said, warnings
from . import (
    Item,
    Run,
    applied,
    applies,
    deadlines,
    durations,
    least,
    not_reached,
    phases,
    recovered,
    tally,
    timing_valid,
)
from .causes import Cause, causes
from .findings import subject_keys
from .strangers import strangers
from .text import count, interval, number, printable, shortened

__all__ = ["summary"]

Line = tuple[str, str]

_NONE = "---"
_BENCHMARK = ("tool calls", "MCP client", "endpoint restarts", "fresh sessions")
"""Activities that are the benchmark itself, the client's share of a tool call included."""

_SHOWN_CAUSES = 10
_SHOWN_FINDINGS = 2
_WIDE = 120
"""Columns from which on there is room for mean and interval; a narrower terminal shows the task's title instead."""


def summary(run: Run, width: int = 100) -> list[Line]:
    """Return the closing tables, the time breakdown and the verdict.

    Args:
        run: a run record.
        width: columns of the terminal; lines are for 80 columns where it has fewer.

    Returns:
        Lines with a style: ``ok``, ``bad``, ``head`` or ``plain``.
    """
    width = max(80, width)
    lines: list[Line] = []
    for suite in SUITES:
        items = [item for item in run["items"] if item["suite"] == suite]
        if items:
            table = _recovery(run, items, width) if suite == "recovery" else _suite(run, suite, items, width)
            lines += [("", "plain"), *table]
    return [
        *lines,
        ("", "plain"),
        *_causes(run, width),
        *_warnings(run, width),
        *_counts(run, width),
        *_narrowed(run, width),
        *_strangers(run, width),
        _verdict(run),
    ]


def _suite(run: Run, suite: str, items: list[Item], width: int) -> Iterator[Line]:
    more = f"{'mean ms':>9}{'95 % CI':>17}" if width >= _WIDE else ""
    yield f"{suite:<9}{'passed':>9}{'at least':>10}{'median ms':>11}{'p95 ms':>9}{more}   task", "head"
    for item in items:
        times = durations(run, [item])
        rate = least(item)
        row = f"  {item['id']:<7}{_count(*tally([item])):>9}"
        row += f"{_NONE if rate is None else f'{100 * rate:.1f} %':>10}"
        row += f"{_number(percentile(times, 50)):>11}{_number(percentile(times, 95)):>9}"
        if more:
            row += f"{_number(mean(times)):>9}{interval(mean_interval(times), _NONE, '..'):>17}"
        yield shortened(f"{row}   {_title(item)}", width), _style(item)


def _recovery(run: Run, items: list[Item], width: int) -> Iterator[Line]:
    same, fresh = "same session", "fresh session"
    yield f"{'recovery':<11}{'detect ms':>10}{same:>14}{'median ms':>11}{fresh:>15}{'median ms':>11}", "head"
    for item in items:
        row = f"  {item['id']:<9}{_number(percentile(phases(run, item, 'detect'), 50)):>10}"
        for way, columns in (("same_session", 14), ("fresh_session", 15)):
            row += f"{_count(*recovered([item], way)):>{columns}}"
            row += f"{_number(percentile(phases(run, item, way), 50)):>11}"
        note = "" if item["status"] == "PASS" else f"   {item['status']}"
        if applies(item) and (missing := not_reached(item)):
            note += f", {missing} not reached"
        yield shortened(row + note, width), _style(item)


def _count(good: int, total: int) -> str:
    return count(good, total, _NONE)


def _number(value: float | None) -> str:
    return number(value, _NONE)


def _title(item: Item) -> str:
    return str(item["title"] if item["status"] == "PASS" else f"{item['status']}: {item['title']}")


def _style(item: Item) -> str:
    return "plain" if item["status"] in ("PASS", "NOT_APPLICABLE") else "bad"


def _wrapped(text: str, width: int, indent: str) -> Iterator[str]:
    # The lines of a text, such as the last lines of an adapter's stderr, stay lines, but are marked, unlike the kit's own.
    for index, line in enumerate(text.splitlines() or [""]):
        mark = f"{indent}{MARK}" if index else indent
        first = mark if index else ""
        yield from textwrap.wrap(harmless(line), width, initial_indent=first, subsequent_indent=mark) or [""]


def _causes(run: Run, width: int) -> Iterator[Line]:
    failed = [item for item in run["items"] if item["status"] not in ("PASS", "NOT_APPLICABLE")]
    if not failed:
        return
    found = causes(run)
    yield "causes", "head"
    for cause in found[:_SHOWN_CAUSES]:
        for line in _wrapped(f"  {cause.rule} {cause.family}: {' '.join(cause.items)}", width, "    "):
            yield line, "bad"
        for text in _told(cause):
            for line in _wrapped(f"      {text}", width, "        "):
                yield line, "plain"
    if len(found) > _SHOWN_CAUSES:
        yield f"  and {len(found) - _SHOWN_CAUSES} more in report.html", "plain"
    explained = {name for cause in found for name in cause.items}
    for item in failed:
        if item["id"] not in explained or item["status"] == "KIT_ERROR":
            for line in _wrapped(f"  {item['id']} {item['status']}: {item['reason'] or item['title']}", width, "    "):
                yield line, "bad"
    yield "  otmcp explain says what an item, a rule or a code in brackets means", "plain"
    yield "", "plain"


def _told(cause: Cause) -> Iterator[str]:
    if cause.statement:
        yield cause.statement
    place = "" if cause.repetition is None else f" rep {cause.repetition + 1}/{cause.where['planned']}"
    more = f", {cause.times} times in all" if cause.times > 1 else ""
    yield f"{cause.where['id']}{place}{more}: {cause.first['message']} [{cause.first['code']}]"
    for message in cause.further[:_SHOWN_FINDINGS]:
        yield f"also: {message}"
    for key in subject_keys(cause.where):
        yield f"in the subject file: {key}"


def _warnings(run: Run, width: int) -> Iterator[Line]:
    found = warnings(run["items"])
    if not found:
        return
    yield "warnings", "head"
    for one in found:
        for line in _wrapped(f"  {said(one)}", width, "    "):
            yield line, "plain"
    yield "", "plain"


def _counts(run: Run, width: int) -> Iterator[Line]:
    footer = run["footer"]
    calls = count_calls(run["items"])
    samples = sum(len(item["samples"]) for item in run["items"])
    others = ", ".join(f"{calls[role]} {role}" for role in ("recovery", "control", "setup", "warmup"))
    texts = [f"{samples} runs, {calls['task']} tool calls ({others} calls counted apart)"]
    # A killed run has neither a time breakdown nor an elapsed time.
    if spent := footer.get("breakdown_s"):
        total = sum(spent.values()) or 1.0
        parts = (
            f"{what} {seconds:.1f} s ({100 * seconds / total:.0f} %)"
            for what, seconds in sorted(spent.items(), key=lambda entry: -entry[1])
        )
        outside = 100 * (1 - sum(spent.get(what, 0.0) for what in _BENCHMARK) / total)
        texts.append(f"{footer['elapsed_s']:.1f} s: {', '.join(parts)}")
        texts.append(f"{outside:.0f} % of that outside of tool calls, endpoint restarts and fresh sessions")
    if told := deadlines(run):
        texts.append(f"deadlines of a call: {told}")
    if not timing_valid(run):
        texts.append("latencies withheld: the run was parallel, so they measure the neighbours too")
    for text in texts:
        for line in _wrapped(text, width, "  "):
            yield line, "plain"


def _narrowed(run: Run, width: int) -> Iterator[Line]:
    for sentence in run["settings"].get("narrowed", ()):
        for line in _wrapped(f"narrowed: {sentence}", width, "  "):
            yield line, "bad"


def _strangers(run: Run, width: int) -> Iterator[Line]:
    for sentence in strangers(run):
        for line in _wrapped(f"note: {sentence}", width, "  "):
            yield line, "plain"


def _verdict(run: Run) -> Line:
    footer, items = run["footer"], run["items"]
    good, planned = tally(items)
    note = f"{applied(run)}, {good}/{planned} runs passed"
    if found := len(warnings(items)):
        note += f", {found} warning{'s' if found > 1 else ''}"
    if footer.get("reason"):
        note += f"; {footer['reason']}"
    verdict = footer.get("verdict", "INCOMPLETE")
    return printable(f"VERDICT: {verdict} ({note})"), "ok" if verdict == "CONFORMANT" else "bad"
