"""The summary of a run for the page of a CI job, in GitHub Flavored Markdown. Pure but for the writing.

Texts of an adapter stand in code spans, where Markdown, mentions and links have no effect; other texts of the record have
their punctuation escaped. GitHub accepts one MiB, so long lists of findings are cut, with a line that says so.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ..core.matrix import SUITES
from ..record.warnings import said, warnings
from ..suite.levels import NOT_SHOWN, standings
from ..suite.levels import said as level_of
from ..suite.requirements import catalogue
from . import Item, Run, applied, applies, command, deadlines, tally
from .capabilities import earned
from .causes import causes, extent
from .evidence import failures
from .families import applying_families
from .findings import beside, cited, faults, subject_keys
from .limits import narrowed
from .overview import deviations, tasks
from .strangers import strangers
from .text import printable

__all__ = ["code", "escape", "summary", "write_markdown"]

_ITEMS = 40
_ALIKE = 3
"""Items with a fault of their sessions alone that are still told one by one."""
_FINDINGS = 3
_LETTERS = 400
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


def summary(run: Run) -> str:
    """Return the summary of a run as Markdown."""
    footer, items = run["footer"], run["items"]
    good, planned = tally(items)
    verdict = footer.get("verdict", "INCOMPLETE")
    name = f"{run['subject'].get('name')} {run['subject'].get('version')}"
    lines = [
        f"## {'✅' if verdict == 'CONFORMANT' else '❌'} {escape(verdict)}: {code(name)}",
        "",
        f"**{applied(run)}**, **{good}** of **{planned}** repetitions passed.",
        "",
        *(f"- warning: {code(said(one))}" for one in warnings(items)),
        *(f"- level: {escape(told)}" for told in _levels(run)),
        *(f"- deadlines of a call: {escape(told)}" for told in [deadlines(run)] if told),
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
    for suite in SUITES:
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
    return list(map(level_of, found)) or [NOT_SHOWN]


def _earned(run: Run) -> list[str]:
    columns = applying_families(run)
    rows = []
    for heading, by_family in earned(run):
        grades = [by_family[family] for family in columns]
        cells = [f"{_SIGNS.get(one.grade, '❌')} {one.grade}" for one in grades]
        rows.append([heading.name, *cells])
    return _table(["What may be connected, and what for", *map(escape, columns)], rows)


def _causes(run: Run) -> Iterator[str]:
    found = causes(run)
    if not found:
        return
    yield "### Causes"
    yield ""
    for one in found[:_ITEMS]:
        told = escape(one.statement) or code(one.first["message"])
        yield f"- **{escape(one.rule)}** {escape(one.family)}, in {escape(' '.join(one.items))}: {told}"
        if told_of := extent(one):
            yield f"  - {told_of}"
        yield from (f"  - by library: {change}" for change in one.by_library)
    if len(found) > _ITEMS:
        yield f"- {len(found) - _ITEMS} more causes; see report.html"
    yield ""


def _findings(run: Run) -> Iterator[str]:
    failing = failures(run)
    if not failing:
        return
    yield "### Findings"
    yield ""
    alone: dict[str, list[str]] = {}
    for one in failing:
        if told := beside(one.item):
            alone.setdefault(told, []).append(one.item["id"])
    counted = {name for names in alone.values() if len(names) > _ALIKE for name in names}
    others = [one.item for one in failing if one.item["id"] not in counted]
    for item in others[:_ITEMS]:
        yield from _finding(run, item)
    if len(others) > _ITEMS:
        yield f"- {len(others) - _ITEMS} more items did not pass; see report.html"
    for told, names in alone.items():
        if len(names) > _ALIKE:
            yield f"- {len(names)} items failed for {escape(told)}, and show what they are about: {escape(' '.join(names))}"
    yield ""


def _finding(run: Run, item: Item) -> Iterator[str]:
    yield f"- **{escape(item['id'])}** {escape(item['status'])}: {escape(item['title'])}"
    found = faults(item)
    for fault in found[:_FINDINGS]:
        yield f"  - {code(fault.finding['message'])} {escape(cited(fault.finding))}"
    if len(found) > _FINDINGS:
        yield f"  - {len(found) - _FINDINGS} more findings; see report.html"
    if not found and item["reason"]:
        yield f"  - {code(item['reason'])}"
    yield from (f"  - in the subject file: {code(key)}" for key in subject_keys(item))
    first = next((sample["repetition"] for sample in item["samples"] if not sample["ok"]), 0)
    yield f"  - again: {code(command(run, item, first))}"


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
