"""The summary of a run for the page of a CI job, in GitHub Flavored Markdown. Pure but for the writing.

Texts of an adapter stand in code spans, where Markdown, mentions and links have no effect; other texts of the record have
their punctuation escaped. GitHub accepts one MiB, so long lists of findings are cut, with a line that says so.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ..core.matrix import KNOWN_SUITES
from ..record.warnings import said, warnings
from ..suite.levels import in_words, not_shown, standings
from ..suite.levels import said as level_of
from ..suite.requirements import catalogue
from ..suite.spoken import spoken, tell
from . import Run, applies, command, deadlines, tally
from .capabilities import earned
from .causes import causes, extent, rows, without_cause
from .families import spoken_families
from .findings import subject_keys
from .limits import narrowed, partial
from .overview import deviations, tasks
from .permission import permission
from .strangers import strangers
from .text import printable

__all__ = ["code", "escape", "summary", "write_markdown"]

_ITEMS = 40
_LETTERS = 400
_MARKS = {"CONFORMANT": "✅", "NOT CONFORMANT": "❌"}
_SIGNS = {
    "PASS": "✅",
    "NOT_APPLICABLE": "⚪",
    "earned": "✅",
    "not claimed": "⚪",
    "not asked": "⚪",
    "not tested": "⚪",
    "undecided": "⚪",
}


def escape(text: str) -> str:
    """Escape a text so that Markdown prints it as it is, on one line, in a table too."""
    escaped = re.sub(r"[\\`*_{}\[\]<>#!|~&@:$]|(?<=www)\.", r"\\\g<0>", _line(text))
    # GitHub looks for mentions and references after the Markdown is converted; a joiner of no width separates their parts.
    return re.sub(r"([@#])(?=\w)", "\\1\u200d", escaped)


def code(text: str) -> str:
    """Make a code span of one line; not for a table, whose cells are cut at bars before code spans are recognised."""
    line = _line(text)
    if len(line) > _LETTERS:
        line = line[:_LETTERS] + "…"
    fence = "`" * (1 + max((len(run) for run in re.findall("`+", line)), default=0))
    return f"{fence} {line} {fence}"


def _line(text: str) -> str:
    return printable(" ".join(text.split()))


def write_markdown(run: Run, path: Path) -> None:
    """Write the summary of a run to ``path``."""
    path.write_text(summary(run), encoding="utf-8", newline="\n")


def summary(run: Run, *, certified: bool = False) -> str:
    """Return the summary of a run as Markdown.

    Args:
        certified: the run has earned a certificate.
    """
    footer, items = run["footer"], run["items"]
    good, planned = tally(items)
    verdict = footer.get("verdict", "INCOMPLETE")
    level = in_words(standings(catalogue(), items, run["subject"]["adapters"]))
    name = f"{run['subject'].get('name')} {run['subject'].get('version')}"
    lines = [
        f"## {_MARKS.get(verdict, '⚪')} {escape(verdict)}: {code(name)}",
        "",
        f"**{tell(spoken(run))}{', ' if level else ''}{level}**; **{good}** of **{planned}** repetitions passed.",
        "",
        *(f"- warning: {code(said(one))}" for one in warnings(items)),
        *(f"- level: {escape(told)}" for told in _levels(run)),
        *(f"- deadlines of a call: {escape(told)}" for told in [deadlines(run)] if told),
        f"- {escape(permission(run, certified=certified))}",
        *(["- A partial pass: see what was earned, and the lines below."] if partial(run) else []),
        *(f"- {escape(reason)}" for reason in narrowed(run)),
        *(f"- Note: {escape(sentence)}." for sentence in strangers(run)),
        *(
            f"- known deviation {escape(one.item)}: {code(one.reason)}, until {escape(one.expires)}; {one.state}"
            for one in deviations(run)
        ),
        "",
        *_earned(run),
        *_causes(run),
        *_findings(run),
    ]
    for suite in KNOWN_SUITES:
        lines += _suite(run, suite)
    kit = run["kit"]
    lines += [
        f"{escape(str(kit.get('name')))} {escape(str(kit.get('version')))}, record {code(footer.get('digest', 'unfinished'))},"
        f" made by {code(command(run))}",
        "",
    ]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines))


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)] + [""]


def _levels(run: Run) -> list[str]:
    found = standings(catalogue(), run["items"], run["subject"]["adapters"])
    return list(map(level_of, found)) or [not_shown(run["items"])]


def _earned(run: Run) -> list[str]:
    columns = spoken_families(run)
    rows = []
    for heading, by_family in earned(run):
        grades = [by_family[family] for family in columns]
        cells = [f"{_SIGNS.get(one.grade, '❌')} {one.grade}" for one in grades]
        rows.append([heading.name, *cells])
    return _table(["What it was shown to do", *map(escape, columns)], rows)


def _causes(run: Run) -> Iterator[str]:
    found = causes(run)
    if not found:
        return
    yield "### Causes"
    yield ""
    for one in found[:_ITEMS]:
        yield f"- **{escape(one.rule)}** {escape(one.family)}: {escape(one.headline)}"
        yield f"  - {code(one.first['message'])} {escape(one.first['code'])}"
        for label, texts in rows(one):
            yield f"  - {label}: {', '.join(code(text) for text in texts) or 'nothing'}"
        yield from (f"  - change: {change}" for change in one.changes)
        yield from (f"  - in the subject file: {code(key)}" for key in subject_keys(one.where, one.first))
        yield f"  - in {escape(' '.join(one.items))}{f'; {told}' if (told := extent(one)) else ''}"
        yield f"  - again: {code(command(run, one.where, one.repetition or 0))}"
    if len(found) > _ITEMS:
        yield f"- {len(found) - _ITEMS} more causes; see report.html"
    yield ""


def _findings(run: Run) -> Iterator[str]:
    """Yield the items that did not pass and have no finding, which is what a cause is made of."""
    failing = without_cause(run)
    if not failing:
        return
    yield "### Further items that did not pass"
    yield ""
    for item in failing[:_ITEMS]:
        yield f"- **{escape(item['id'])}** {escape(item['status'])}: {code(item['reason'] or item['title'])}"
        yield f"  - again: {code(command(run, item))}"
    if len(failing) > _ITEMS:
        yield f"- {len(failing) - _ITEMS} more; see report.html"
    yield ""


def _suite(run: Run, suite: str) -> list[str]:
    rows = [row for row in tasks(run, suite) if applies(row.item)]
    if not rows:
        return []
    cells = [
        [
            escape(row.item["id"]),
            f"{_SIGNS.get(row.item['status'], '❌')} {escape(row.item['status'])}",
            row.passed,
            row.least,
            row.median,
            row.p95,
            escape(row.item["title"]),
        ]
        for row in rows
    ]
    head = ["Item", "Result", "Passed", "At least", "Median ms", "p95 ms", "Task"]
    return [f"### {suite.capitalize()}", "", *_table(head, cells)]
