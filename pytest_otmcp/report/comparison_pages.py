"""A comparison of runs as a page and as Markdown. Pure but for the writing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from . import Run
from .comparison import Cell, Comparison, Row, compared
from .markdown import escape
from .page import filled

__all__ = ["NAMES", "html", "markdown", "write_comparison"]

NAMES = ("comparison.html", "comparison.md")
"""Files that :func:`write_comparison` writes."""

_SIGNS = {"good": "✅", "bad": "❌", "open": "⚪"}


def write_comparison(runs: Sequence[Run], directory: Path) -> Comparison:
    """Write page and Markdown below ``directory``, which is made when it is not there, and return what they say."""
    comparison = compared(runs)
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in zip(NAMES, (html(comparison), markdown(comparison)), strict=True):
        # Nothing is written through a link.
        (directory / name).unlink(missing_ok=True)
        (directory / name).write_text(text, encoding="utf-8", newline="\n")
    return comparison


def html(comparison: Comparison) -> str:
    """Return the comparison as HTML."""
    return filled("comparison.html.jinja", comparison=comparison)


def markdown(comparison: Comparison) -> str:
    """Return the comparison as GitHub Flavored Markdown."""
    names = [escape(column.name) for column in comparison.columns]
    lines = [
        "## Adapters side by side",
        "",
        *_table(["", *names], _about(comparison)),
        *(f"- {escape(note)}" for note in comparison.notes),
        "",
    ]
    changed = [row for row in comparison.items if row.changed]
    for title, rows in (
        ("What was shown", comparison.capabilities),
        ("Rules that are broken", comparison.rules),
        ("Items on which the runs differ", changed),
    ):
        if rows:
            lines += [f"### {title}", "", *_table(["", *names], map(_row, rows))]
    same = len(comparison.items) - len(changed)
    lines += [f"The runs agree on {same} of {len(comparison.items)} items.", ""]
    return "\n".join(lines)


def _about(comparison: Comparison) -> Iterator[list[str]]:
    columns = comparison.columns
    yield ["Verdict", *(_cell(column.verdict) for column in columns)]
    yield ["Items", *(escape(column.items) for column in columns)]
    yield ["Repetitions passed", *(column.passed for column in columns)]
    for index, (name, _) in enumerate(columns[0].identity):
        yield [name, *(escape(column.identity[index][1]) for column in columns)]


def _row(row: Row) -> list[str]:
    return [escape(row.name), *map(_cell, row.cells)]


def _cell(cell: Cell) -> str:
    return f"{_SIGNS[cell.tone]} {escape(cell.text)}" + (f" ({escape(cell.note)})" if cell.note else "")


def _table(head: list[str], rows: Iterator[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)] + [""]
