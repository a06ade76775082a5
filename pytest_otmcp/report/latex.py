"""The paper's LaTeX tables from a run record, body only, so that ``\\input`` works.

Macros, columns, rules and rounding of the first four files are those of the IndustriConnect paper; the paper's own source
compiles with them. A number that a run does not have is printed as ``---``. Pure but for the writing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from ..core.matrix import BENCHMARK
from ..core.statistics import mean, mean_interval, median_interval, outliers, percentile, standard_deviation
from ..protocols.registry import protocols
from ..record.consistency import count_calls
from . import Item, Run, adapters, applies, command, durations, least, phases, recovered, tally, task_calls
from .families import apart, benchmark, families
from .text import count, interval, number, percent_down

__all__ = ["escape", "row", "tabular", "write_tables"]

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "_": r"\_",
    "%": r"\%",
    "&": r"\&",
    "#": r"\#",
    "$": r"\$",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    # In the paper's encoding, OT1, these are inverted marks, a dash and a closing quote.
    "<": "$<$",
    ">": "$>$",
    "|": r"\textbar{}",
    '"': "''",
}
_NONE = "---"
_DIGITS = "Zero One Two Three Four Five Six Seven Eight Nine".split()


def escape(text: str) -> str:
    """Escape a text so that LaTeX prints it as it is.

    A character that pdfLaTeX cannot print, such as a control character in an error code that an adapter made up, is shown by
    its code point.
    """
    return "".join(_SPECIAL.get(letter, letter if " " <= letter <= "~" else f"U+{ord(letter):04X}") for letter in text)


def write_tables(run: Run, directory: Path) -> None:
    """Write every table of a run below ``directory``.

    The paper's tables are about the families of the paper's matrix; further families have ``tab_protocols`` to themselves.
    """
    directory.mkdir(parents=True, exist_ok=True)
    paper, further = benchmark(run), apart(run)
    tables = {
        "exact_counts": _exact_counts(paper),
        "tab_results": _results(paper, families(paper)),
        "tab_taskbreakdown": _task_breakdown(paper),
        "tab_faultresults": _fault_results(paper),
        "tab_stress": _stress(paper),
        "tab_recovery": _recovery(paper),
        "tab_statistics": _statistics(paper),
        **({"tab_protocols": _results(run, further)} if further else {}),
    }
    for name, lines in tables.items():
        (directory / f"{name}.tex").write_text("\n".join([*_origin(run), *lines]) + "\n", encoding="utf-8")


def _origin(run: Run) -> list[str]:
    kit, footer = run["kit"], run["footer"]
    state = "complete" if footer["complete"] else "INCOMPLETE"
    lines = [
        f"{kit['name']} {kit['version']}, {state} run {footer.get('digest', 'without digest')}",
        f"subject: {run['subject'].get('name')} {run['subject'].get('version')}",
        f"made by: {command(run)}",
        r"needs: \usepackage{booktabs,tabularx,array} \newcolumntype{Y}{>{\raggedright\arraybackslash}X}",
    ]
    # A subject's name may hold any characters; a comment must stay one line.
    return ["% " + " ".join(line.split()) for line in lines]


def _items(run: Run, suite: str, family: str | None = None) -> list[Item]:
    return [item for item in run["items"] if item["suite"] == suite and family in (None, item["family"])]


def _ms(value: float | None) -> str:
    return number(value, _NONE, digits=1)


def _rate(good: int, total: int) -> str:
    return _ms(100 * good / total if total else None)


def _count(good: int, total: int) -> str:
    return count(good, total, _NONE)


def _median_p95(run: Run, items: Iterable[Item]) -> tuple[str, str]:
    times = durations(run, items)
    return _ms(percentile(times, 50)), _ms(percentile(times, 95))


# -- the paper's files ------------------------------------------------------------------------------------


def _exact_counts(run: Run) -> list[str]:
    suites = {suite: _items(run, suite) for suite in BENCHMARK}
    samples = {suite: sum(len(item["samples"]) for item in items) for suite, items in suites.items()}
    calls = {suite: len(task_calls(items)) for suite, items in suites.items()}
    every = count_calls([item for item in run["items"] if item["suite"] in BENCHMARK])
    sessions = adapters(run)
    macros = {
        "totalNormalRuns": samples["normal"],
        "totalFaultRuns": samples["fault"],
        "totalStressRuns": samples["stress"],
        "totalRecoveryTrials": samples["recovery"],
        "totalRuns": sum(samples.values()),
        # The paper counts the calls of three suites; the calls of the recovery suite and around the tasks follow.
        "totalToolCalls": every["task"],
        "normalToolCalls": calls["normal"],
        "faultToolCalls": calls["fault"],
        "stressToolCalls": calls["stress"],
        "recoveryToolCalls": every["recovery"],
        "otherToolCalls": every["control"] + every["setup"] + every["warmup"],
        **{
            f"{_letters(known.key)}ToolCount": sessions[known.key]["tools"] if known.key in sessions else _NONE
            for known in protocols().values()
            if known.always or known.key in sessions
        },
    }
    return [f"\\newcommand{{\\{name}}}{{{value}}}" for name, value in macros.items()]


def _letters(key: str) -> str:
    """Turn a protocol's key into letters, as LaTeX requires for the name of a macro: ``s7`` becomes ``sSeven``."""
    return "".join(_DIGITS[int(sign)] if sign.isdecimal() else sign for sign in key if sign.isalnum())


def tabular(columns: str, head: Sequence[str], rows: Sequence[str], width: str | None = None) -> list[str]:
    """Return the lines of a table with the paper's rules."""
    kind = "tabular" if width is None else "tabularx"
    opening = f"\\begin{{{kind}}}" + ("" if width is None else f"{{{width}}}") + f"{{{columns}}}"
    inner = ["\\toprule", *head, "\\midrule", *rows, "\\bottomrule"]
    return [f"    {opening}", *(f"        {line}" for line in inner), f"    \\end{{{kind}}}"]


def row(*cells: str) -> str:
    """Return a row of a table."""
    return " & ".join(cells) + r" \\"


def _results(run: Run, names: Iterable[str]) -> list[str]:
    rows = []
    for family in names:
        items = _items(run, "normal", family)
        if not items:
            continue
        calls = task_calls(items)
        tool = _rate(sum(call["ok"] for call in calls), len(calls))
        same_session = _rate(*recovered(_items(run, "recovery", family), "same_session"))
        applying = str(sum(map(applies, items)))
        rows.append(row(escape(family), applying, _rate(*tally(items)), tool, *_median_p95(run, items), same_session))
    head = [
        row("Family", "Tasks", "Task", "Tool", "Med.", "p95", "Rec."),
        r"& & (\%) & (\%) & (ms) & (ms) & (\%) \\",
    ]
    return tabular("@{}lrrrrrr@{}", head, rows)


def _task_breakdown(run: Run) -> list[str]:
    rows: list[str] = []
    for family in families(run):
        items = _items(run, "normal", family)
        if rows and items:
            rows.append("\\midrule")
        rows += [row(item["id"], escape(family), escape(item["title"]), *_median_p95(run, [item])) for item in items]
    head = [row("ID", "Family", "Operation", "Med. (ms)", "p95 (ms)")]
    return tabular("@{}llYrr@{}", head, rows, r"\textwidth")


def _fault_results(run: Run) -> list[str]:
    rows = []
    for item in _items(run, "fault"):
        codes = sorted({call["error_code"] for call in task_calls([item]) if call["error_code"]})
        label = ", ".join(escape(code.replace("_", " ")) for code in codes) or _NONE
        median, _ = _median_p95(run, [item])
        rows.append(
            row(item["id"], escape(item["family"]), escape(item["title"]), _rate(*tally([item])), median, label)
        )
    head = [row("ID", "Family", "Fault scenario", r"EH (\%)", "Med. (ms)", "Error class")]
    return tabular("@{}llYrrl@{}", head, rows, r"\columnwidth")


# -- the kit's own ----------------------------------------------------------------------------------------


def _stress(run: Run) -> list[str]:
    rows = []
    for item in _items(run, "stress"):
        passed = _count(*tally([item]))
        rows.append(row(item["id"], escape(item["family"]), escape(item["title"]), passed, *_median_p95(run, [item])))
    head = [row("ID", "Family", "Stress scenario", "Passed", "Med. (ms)", "p95 (ms)")]
    return tabular("@{}llYrrr@{}", head, rows, r"\columnwidth")


def _recovery(run: Run) -> list[str]:
    rows = []
    for item in _items(run, "recovery"):
        medians = {
            name: _ms(percentile(phases(run, item, name), 50))
            for name in ("detect", "restart", "same_session", "fresh_session")
        }
        same, fresh = (_count(*recovered([item], way)) for way in ("same_session", "fresh_session"))
        cells = (medians["detect"], medians["restart"], same, medians["same_session"], fresh, medians["fresh_session"])
        rows.append(row(escape(item["family"]), *cells))
    head = [
        r"& Detect & Restart & \multicolumn{2}{c}{Same session} & \multicolumn{2}{c}{Fresh session} \\",
        row("Family", "(ms)", "(ms)", "ok", "Med. (ms)", "ok", "Med. (ms)"),
    ]
    return tabular("@{}lrrrrrr@{}", head, rows)


def _statistics(run: Run) -> list[str]:
    rows: list[str] = []
    for suite in BENCHMARK:
        items = _items(run, suite)
        if rows and items:
            rows.append("\\midrule")
        rows += [_statistics_row(run, item) for item in items]
    interval = r"95\,\% CI"
    head = [
        r"& & At least & \multicolumn{3}{c}{Mean (ms)} & \multicolumn{2}{c}{Median (ms)} & p95 & Out- \\",
        row("ID", "Passed", r"(\%)", "", "SD", interval, "", interval, "(ms)", "liers"),
    ]
    return tabular("@{}lrrrrrrrrr@{}", head, rows)


def _statistics_row(run: Run, item: Item) -> str:
    times = durations(run, [item])
    rate = least(item)
    outside = outliers(times)
    return row(
        item["id"],
        _count(*tally([item])),
        _ms(None if rate is None else percent_down(rate)),
        _figure(mean(times)),
        _figure(standard_deviation(times)),
        _interval(mean_interval(times)),
        _figure(percentile(times, 50)),
        _interval(median_interval(times)),
        _figure(percentile(times, 95)),
        _NONE if outside is None else str(outside),
    )


def _figure(value: float | None) -> str:
    return number(value, _NONE)


def _interval(bounds: tuple[float, float] | None) -> str:
    return interval(bounds, _NONE, "--")
