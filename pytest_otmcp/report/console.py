"""The summary of a run as lines of text. Pure: a run record in, lines with a style out.

Lines hold printable characters only: a text from an adapter can neither colour the terminal nor start a line of its own that
looks like a verdict. The kit's own words are ASCII, for terminals that have nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator

from ..core.matrix import KNOWN_SUITES, REQUIREMENTS
from ..core.walls import missing
from ..record.consistency import count_calls
from ..record.warnings import said, warnings
from ..suite.levels import in_words, not_shown, standings
from ..suite.levels import said as level_of
from ..suite.requirements import catalogue
from ..suite.spoken import spoken, tell
from . import Run, applies, least, tally, timing_valid
from .applying import not_applying, nothing_asked
from .baseline import Baseline, since
from .causes import Cause, causes, extent, remedy, rows
from .console_lines import Line, failed, wrapped
from .console_tables import tables, time_budget
from .families import apart
from .findings import beside, subject_keys
from .limits import partial, unknown_tools
from .overview import deviations, requirements
from .strangers import strangers
from .text import at_least, calls_made, count, counted, printable, shortened

__all__ = ["summary"]

_NONE = "---"
_FEW_ROWS = 8
"""Rows that get a line each; more of them are in the reports."""
_BY = {"kept": " by ", "violated": " by ", "not shown": " over ", "not asked": " over "}
_SHOWN_CAUSES = 10
_SHOWN_FINDINGS = 2
_MANY = 4
"""Items with the same fault that are counted and not named."""
_LEAST_WIDTH = 40
"""Columns that every terminal has."""


def summary(
    run: Run, width: int = 80, *, verbosity: int = 0, fold_verdict: bool = False, baseline: Baseline | None = None
) -> list[Line]:
    """Return what a run says at its end: a line for each suite, the causes of failures, and the verdict.

    Args:
        run: a run record.
        width: columns of the terminal.
        verbosity: as pytest counts it: from 1 on with a table for each suite and the time budget, below 0 causes and verdict
            alone, below -1 the verdict alone.
        fold_verdict: whether the verdict is wrapped as the other lines are. In a log it is one line that programs can find.
        baseline: an earlier run; the verdict says what has changed since.

    Returns:
        Lines with a style: ``ok``, ``bad``, ``head`` or ``plain``.
    """
    width = max(_LEAST_WIDTH, width)
    lines: list[Line] = []
    if verbosity > 0:
        lines += tables(run, width)
    if verbosity >= 0:
        lines += [("", "plain"), *_suites(run, width), *_not_applying(run, width, named=verbosity > 0)]
    if verbosity >= -1:
        lines += [("", "plain"), *_causes(run, width)]
    if verbosity >= 0:
        lines += [*_warnings(run, width), *_counts(run, width)]
    if verbosity > 0:
        lines += time_budget(run, width)
    if verbosity >= 0:
        lines += [*_levels(run, width), *_narrowed(run, width), *_not_measured(run, width), *_strangers(run, width)]
        lines += [*_walls(run, width), *_partial(run, width)]
    if verbosity >= -1:
        lines += _rows(run, width)
    return [*lines, *_verdict(run, width if fold_verdict else None, baseline)]


def _rows(run: Run, width: int) -> Iterator[Line]:
    """Yield what is known of each row, where checks of a few rows alone ran: the verdict is about the whole suite."""
    asked = {item["id"].partition(".")[0] for item in run["items"]}
    if len(asked) > _FEW_ROWS or any(item["suite"] != REQUIREMENTS for item in run["items"]):
        return
    for name, by_family in requirements(run):
        if name in asked:
            states = dict.fromkeys(cell.state for cell in by_family.values())
            told = [
                f"{state}{_BY[state]}{', '.join(family for family, cell in by_family.items() if cell.state == state)}"
                for state in states
            ]
            for line in wrapped(f"{name}: {'; '.join(told)}", width, "  "):
                yield line, "bad" if "violated" in states else "ok" if states.keys() == {"kept"} else "plain"


def _suites(run: Run, width: int) -> Iterator[Line]:
    further, applying = apart(run), [item for item in run["items"] if applies(item)]
    wide = max(len(name) for name in ("normal", *(item["suite"] for item in run["items"]), *further)) + 1
    yield f"{'suite':<{wide}}{'items':>7}{'runs':>10}{'pass rate at least':>20}", "head"
    within = [item for item in applying if item["family"] not in further]
    rows = {suite: [item for item in within if item["suite"] == suite] for suite in KNOWN_SUITES}
    rows |= {family: [item for item in applying if item["family"] == family] for family in further}
    for name, items in rows.items():
        if items:
            red = [item["id"] for item in items if failed(item)]
            bounds = [least(item) for item in items]
            # One item of a suite that fails leaves nothing that could be said of each.
            known = [bound for bound in bounds if bound is not None] if not red and None not in bounds else []
            row = f"{name:<{wide}}{count(len(items) - len(red), len(items), _NONE):>7}{count(*tally(items), _NONE):>10}"
            alone = [item["id"] for item in items if beside(item)]
            named = [name for name in red if len(alone) < _MANY or name not in alone]
            if len(named) < len(red):
                named.append(f"and {len(alone)} for {'; '.join(dict.fromkeys(filter(None, map(beside, items))))}")
            row += f"{at_least(min(known, default=None), _NONE):>20}{'   ' if red else ''}{' '.join(named)}"
            yield shortened(row, width), "bad" if red else "plain"


def _not_applying(run: Run, width: int, *, named: bool) -> Iterator[Line]:
    for line in wrapped(not_applying(run, named=named), width, "  "):
        if line:
            yield line, "plain"


def _causes(run: Run, width: int) -> Iterator[Line]:
    red = [item for item in run["items"] if failed(item)]
    if not red:
        return
    found = causes(run)
    yield "causes", "head"
    for cause in found[:_SHOWN_CAUSES]:
        for line in wrapped(f"  {cause.rule} {cause.family}: {' '.join(cause.items)}", width, "    "):
            yield line, "bad"
        for text in _told(cause):
            for line in wrapped(f"      {text}", width, "        "):
                yield line, "plain"
    if len(found) > _SHOWN_CAUSES:
        yield f"  and {len(found) - _SHOWN_CAUSES} more in report.html", "plain"
    explained = {name for cause in found for name in cause.items}
    for item in red:
        if item["id"] not in explained or item["status"] == "KIT_ERROR":
            for line in wrapped(f"  {item['id']} {item['status']}: {item['reason'] or item['title']}", width, "    "):
                yield line, "bad"
    for line in wrapped("  otmcp explain says what an item, a rule or a code in brackets means", width, "    "):
        yield line, "plain"
    yield "", "plain"


def _told(cause: Cause) -> Iterator[str]:
    if cause.headline:
        yield cause.headline
    place = "" if cause.repetition is None else f" rep {cause.repetition + 1}/{cause.where['planned']}"
    more = f", {counted(cause.times, 'time')} in all" if cause.times > 1 else ""
    yield f"{cause.where['id']}{place}{more}: {cause.first['message']} [{cause.first['code']}]"
    if told := extent(cause):
        yield told
    for label, texts in rows(cause):
        yield f"{label}: {'; '.join(texts) or 'nothing'}"
    for change in cause.changes:
        yield f"change: {change}"
    for message in cause.further[:_SHOWN_FINDINGS]:
        yield f"also: {message}"
    for key in subject_keys(cause.where, cause.first):
        yield f"in the subject file: {key}"


def _warnings(run: Run, width: int) -> Iterator[Line]:
    found = warnings(run["items"])
    if not found:
        return
    yield "warnings", "head"
    for one in found:
        change = remedy(one["requirement"], one["code"])
        for text, indent in (
            (f"  {said(one)}", "    "),
            *([(f"      change: {change}", "        ")] if change else []),
        ):
            for line in wrapped(text, width, indent):
                yield line, "plain"
    yield "", "plain"


def _counts(run: Run, width: int) -> Iterator[Line]:
    calls = count_calls(run["items"])
    samples = sum(len(item["samples"]) for item in run["items"] if applies(item))
    # A killed run has no elapsed time.
    elapsed = run["footer"].get("elapsed_s")
    took = "" if elapsed is None else f" in {elapsed:.1f} s"
    # Without a subject file a run is about the reference adapters, and nobody should take its verdict for another one's.
    subject = run["subject"]
    texts = [
        f"subject: {subject['name']} {subject['version']}".rstrip(),
        f"{counted(samples, 'run')}, {calls_made(calls)}{took}",
    ]
    if not timing_valid(run):
        texts.append("latencies withheld: the run was parallel, so they measure the neighbours too")
    for text in texts:
        for line in wrapped(text, width, "  "):
            yield line, "plain"


def _levels(run: Run, width: int) -> Iterator[Line]:
    told = [level_of(found) for found in standings(catalogue(), run["items"], run["subject"]["adapters"])]
    if not told and run["footer"].get("verdict") == "CONFORMANT":
        # Of a run that failed nobody expects a level.
        told = [not_shown(run["items"])]
    for text in told:
        for line in wrapped(f"level: {text}", width, "  "):
            yield line, "plain"


def _partial(run: Run, width: int) -> Iterator[Line]:
    if partial(run):
        for line in wrapped("note: a partial pass; report.html says what it does not cover", width, "  "):
            yield line, "plain"
        # The benchmark alone calls few tools of a large adapter, and permits nothing.
        for sentence in unknown_tools(run) if REQUIREMENTS in run["settings"].get("suites", ()) else ():
            for line in wrapped(f"note: {printable(sentence)}", width, "  "):
                yield line, "plain"


def _narrowed(run: Run, width: int) -> Iterator[Line]:
    for sentence in run["settings"].get("narrowed", ()):
        for line in wrapped(f"narrowed: {sentence}", width, "  "):
            yield line, "bad"


def _not_measured(run: Run, width: int) -> Iterator[Line]:
    for sentence in run["settings"].get("not_measured", {}).values():
        for line in wrapped(f"note: {sentence}", width, "  "):
            yield line, "plain"


def _walls(run: Run, width: int) -> Iterator[Line]:
    for sentence in missing(run["environment"].get("walls", {})):
        for line in wrapped(f"note: {printable(sentence)}", width, "  "):
            yield line, "plain"


def _strangers(run: Run, width: int) -> Iterator[Line]:
    for sentence in strangers(run):
        for line in wrapped(f"note: {sentence}", width, "  "):
            yield line, "plain"


def _verdict(run: Run, width: int | None, baseline: Baseline | None) -> Iterator[Line]:
    footer, items = run["footer"], run["items"]
    good, planned = tally(items)
    level = in_words(standings(catalogue(), items, run["subject"]["adapters"]))
    note = f"{tell(spoken(run))}{', ' if level else ''}{level}; {good}/{planned} runs passed"
    if found := len(warnings(items)):
        note += f", {counted(found, 'warning')}"
    changed = since(baseline, run) if baseline is not None else None
    known = "; ".join(f"known deviation {one.item} until {one.expires}: {one.state}" for one in deviations(run))
    field = "a field record, at a real device" if "devices" in run["settings"] else None
    for told in (field, nothing_asked(run), footer.get("reason"), known, changed):
        note += f"; {told}" if told else ""
    verdict = footer.get("verdict", "INCOMPLETE")
    line_of_all = printable(f"VERDICT: {verdict} ({note})")
    for line in [line_of_all] if width is None else wrapped(line_of_all, width, "  "):
        yield line, "ok" if verdict == "CONFORMANT" else "bad"
