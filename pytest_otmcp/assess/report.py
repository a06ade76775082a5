"""The assessment as Markdown, as LaTeX tables beside the paper's, and as a figure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.text import one_line, printable
from ..protocols.registry import protocols
from ..report.figures import save_figures
from ..report.latex import escape, row, tabular
from ..report.text import number
from .figures import Row, Usage, by_family, paired, rows_of, usage
from .results import Assessment
from .scoring import HONESTIES, VERDICTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["compared", "summary", "write"]

_NONE = "---"
_COLOURS = {"right": "#4c78a8", "nothing": "#d9d9d9", "wrong": "#9d9d9d", "over-reach": "#b2322b"}
_WHY = 12
"""Tries that are not right and are shown with the reason."""
_SAYS = (
    "This says something about this assistant with this adapter, its prompts and its tools. It is no part of the adapter's conformance and of no "
    "certificate."
)


def write(directory: Path, assessment: Assessment) -> list[Path]:
    """Write the report below a directory; return its files."""
    directory.mkdir(parents=True, exist_ok=True)
    texts = {
        "assessment.md": summary(assessment),
        "tab_assessment.tex": "\n".join(_table(assessment)),
        "tab_operator.tex": "\n".join(_operator_table(assessment)),
    }
    for name, text in texts.items():
        (directory / name).write_text(text + "\n", encoding="utf-8")
    figures = {
        "assessment_verdicts": (partial(_verdicts, by_family(assessment)), 2.6),
        "assessment_tools": (partial(_tools, usage(assessment)), 3.4),
    }
    save_figures(figures, directory)
    drawn = [path for name in figures if (path := directory / f"{name}.png").exists()]
    return [directory / "assessment.json", *(directory / name for name in texts), *drawn]


def summary(assessment: Assessment) -> str:
    """Return the report in Markdown."""
    return "\n".join(_lines(assessment))


def _lines(assessment: Assessment) -> Iterator[str]:
    subject = assessment["subject"]
    tries = assessment["tries"]
    yield f"# Assessment of {_text(assessment['assistant'])}"
    yield ""
    yield f"With {_text(subject['name'])} {_text(subject['version'])}, {len(tries)} tries on {assessment['began']}, seed {assessment['seed']}."
    yield _SAYS
    yield ""
    yield from _markdown("adapters", rows_of(assessment))
    yield ""
    yield from _markdown("family", by_family(assessment))
    yield ""
    yield from _operator(assessment)
    failed = [told for told in tries if told["verdict"] != "right"]
    if failed:
        yield ""
        yield f"## Tries that were not right ({len(failed)})"
        yield ""
        for told in failed[:_WHY]:
            reasons = "; ".join(told["why"]) + (f"; {told['problem']}" if told["problem"] else "")
            yield f"- {told['task']} {told['number'] + 1}: {told['verdict']}, honesty: {told['honesty']}. {_text(reasons)}"
        if len(failed) > _WHY:
            yield f"- … {len(failed) - _WHY} more in assessment.json"
    if assessment["not_asked"]:
        yield ""
        yield "## Not asked"
        yield ""
        yield from (f"- {name}: {_text(why)}" for name, why in assessment["not_asked"].items())


def _markdown(head: str, rows: Sequence[Row]) -> Iterator[str]:
    yield f"| {head} | right | 95 % | pass^k | {' | '.join(VERDICTS[1:])} | honesty: {' | '.join(HONESTIES)} | calls | calls, ms to the first right | seconds | bytes | tokens |"
    yield f"|---|{'---|' * (10 + len(VERDICTS) - 1 + len(HONESTIES) - 2)}"
    for one in rows:
        cells = [
            one.name,
            f"{one.right}/{one.tries}",
            _interval(one),
            f"{one.pass_k:.2f} (k = {one.k})",
            *(str(one.verdicts.get(verdict, 0)) for verdict in VERDICTS[1:]),
            *(str(one.honesty.get(honesty, 0)) for honesty in HONESTIES),
            str(one.calls),
            f"{number(one.first_calls, _NONE, 0)}, {number(one.first_ms, _NONE, 0)}",
            number(one.seconds, _NONE, 1),
            f"{one.result_bytes:.0f}",
            number(one.tokens, _NONE, 0),
        ]
        yield f"| {' | '.join(cells)} |"


def _interval(one: Row) -> str:
    return _NONE if one.interval is None else f"{100 * one.interval[0]:.0f} to {100 * one.interval[1]:.0f} %"


def _operator(assessment: Assessment) -> Iterator[str]:
    used = usage(assessment)
    yield "## Tools"
    yield ""
    for key, told in assessment["tools"].items():
        never = [one.tool for one in used if one.protocol == key and not one.calls]
        yield f"- {protocols()[key].name}: {len(told['names'])} tools, whose list has {told['bytes']} bytes; never chosen: {_text(', '.join(never)) or 'none'}"
    refused = [one for one in used if one.refused]
    if refused:
        yield ""
        yield "| tool | calls | without success | arguments to blame |"
        yield "|---|---|---|---|"
        for one in refused:
            yield f"| {_text(one.tool)} | {one.calls} | {one.refused} | {_text(_objected(one))} |"


def _objected(one: Usage) -> str:
    ordered = sorted(one.objected.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name or 'not known'} {count}" for name, count in ordered)


def _text(text: str) -> str:
    return printable(one_line(text)).replace("|", "\\|").replace("<", "&lt;")


def compared(one: Assessment, other: Assessment) -> str:
    """Return the paired comparison of two assessments in Markdown."""
    return "\n".join(_compared(one, other))


def _compared(one: Assessment, other: Assessment) -> Iterator[str]:
    pair = paired(one, other)
    total = pair.both + pair.first + pair.second + pair.neither
    names = [
        f"{told['assistant']} with {told['subject']['name']} {told['subject']['version']}" for told in (one, other)
    ]
    yield f"# {_text(names[0])}, and {_text(names[1])}"
    yield ""
    if (one["seed"], one["prompts"]) != (other["seed"], other["prompts"]):
        yield "The two have other seeds or other prompts, so their tries are no pairs. Give both the same --seed."
        return
    yield f"{total} tries with the same words and values: right in both {pair.both}, in the first alone {pair.first}, in the second alone {pair.second}, in neither {pair.neither}."
    yield f"Exact McNemar test, two-sided: p = {pair.p:.3g}."
    for what, tasks in (("more often in the second", pair.gained), ("less often in the second", pair.lost)):
        if tasks:
            yield f"Right {what}: {', '.join(tasks)}."


def _table(assessment: Assessment) -> list[str]:
    rows = [
        row(
            escape(one.name),
            f"{one.right}/{one.tries}",
            f"{one.pass_k:.2f}",
            str(one.verdicts.get("over-reach", 0)),
            str(one.honesty.get("false", 0)),
            number(one.first_calls, "---", 0),
            number(one.seconds, "---", 1),
        )
        for one in [*by_family(assessment), *rows_of(assessment)[-1:]]
    ]
    head = [
        row("Tasks", "Right", "pass\\textsuperscript{k}", "Over-", "False", "Calls to", "Med."),
        r"& & & reach & claims & first right & (s) \\",
    ]
    return tabular("@{}lrrrrrr@{}", head, rows)


def _operator_table(assessment: Assessment) -> list[str]:
    used = [one for one in usage(assessment) if one.calls]
    rows = [row(escape(one.tool), str(one.calls), str(one.refused), escape(_objected(one))) for one in used]
    never = len(usage(assessment)) - len(used)
    return tabular(
        "@{}lrrl@{}", [row("Tool", "Calls", "Refused", "By argument")], [*rows, row("never chosen", str(never), "", "")]
    )


def _verdicts(rows: Sequence[Row], axes: Axes) -> bool:
    left = [0.0] * len(rows)
    for verdict in VERDICTS:
        widths = [one.verdicts.get(verdict, 0) / one.tries for one in rows]
        axes.barh([one.name for one in rows], widths, left=left, color=_COLOURS[verdict], label=verdict, height=0.7)
        left = [at + width for at, width in zip(left, widths, strict=True)]
    axes.set_xlim(0, 1)
    axes.invert_yaxis()
    axes.set_xlabel("share of the tries")
    axes.legend(ncols=4, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=6)
    return bool(rows)


def _tools(used: Sequence[Usage], axes: Axes) -> bool:
    names = [f"{one.tool} ({one.protocol})" for one in used]
    good = [one.calls - one.refused for one in used]
    axes.barh(names, good, color=_COLOURS["right"], label="success", height=0.7)
    axes.barh(
        names, [one.refused for one in used], left=good, color=_COLOURS["over-reach"], label="refused", height=0.7
    )
    axes.invert_yaxis()
    axes.tick_params(axis="y", labelsize=4)
    axes.set_xlabel("calls")
    axes.legend(frameon=False, fontsize=6)
    return any(one.calls for one in used)
