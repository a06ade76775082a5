"""The paper's LaTeX tables from a run record, body only, so that ``\\input`` works.

Macros, columns, rules and rounding of the first four files are those of the IndustriConnect paper; its own source
compiles with them. A figure that a run does not have is printed as ``---``. Pure but for the writing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..statistics import lower_bound, mean, mean_interval, percentile, standard_deviation

__all__ = ["escape", "write_tables"]

Run = Mapping[str, Any]
Item = Mapping[str, Any]

_FAMILIES = ("Modbus", "MQTT", "OPC UA", "Cross-protocol")
_SUITE_MACROS = {"normal": "totalNormalRuns", "fault": "totalFaultRuns", "stress": "totalStressRuns"}
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
}
NONE = "---"


def escape(text: str) -> str:
    """Text as LaTeX prints it; ``<`` and ``>`` stay, as in the paper's own tables."""
    return "".join(_SPECIAL.get(character, character) for character in text)


def write_tables(run: Run, directory: Path) -> None:
    """Write every table of a run below ``directory``."""
    directory.mkdir(parents=True, exist_ok=True)
    tables = {
        "exact_counts": _exact_counts(run),
        "tab_results": _results(run),
        "tab_taskbreakdown": _task_breakdown(run),
        "tab_faultresults": _fault_results(run),
        "tab_stress": _stress(run),
        "tab_recovery": _recovery(run),
        "tab_statistics": _statistics(run),
    }
    for name, lines in tables.items():
        text = "\n".join([_origin(run), *lines]) + "\n"
        (directory / f"{name}.tex").write_text(text, encoding="utf-8")


def _origin(run: Run) -> str:
    kit, footer = run["kit"], run["footer"]
    state = "complete" if footer.get("complete") else "INCOMPLETE"
    command = f"pytest --otmcp-reps={run['settings']['reps']}"
    return f"% {kit['name']} {kit['version']}, {state} run {footer.get('digest', 'without digest')}, made by: {command}"


def _items(run: Run, suite: str, family: str | None = None) -> list[Item]:
    return [item for item in run["items"] if item["suite"] == suite and family in (None, item["family"])]


def _times(run: Run, items: Iterable[Item]) -> list[float]:
    # Latencies of a parallel run measure the neighbours too and are not printed.
    if not run["footer"].get("timing_valid", True):
        return []
    return [sample["duration_ms"] for item in items for sample in item["samples"]]


def _ms(value: float | None) -> str:
    return NONE if value is None else f"{value:.1f}"


def _rate(good: int, total: int) -> str:
    return NONE if total == 0 else f"{100 * good / total:.1f}"


def _task_calls(items: Iterable[Item]) -> list[Mapping[str, Any]]:
    return [call for item in items for sample in item["samples"] for call in sample["calls"] if call["role"] == "task"]


def _passed(items: Iterable[Item]) -> tuple[int, int]:
    """Samples that passed, of those that were planned: what did not run did not pass."""
    items = list(items)
    good = sum(sample["ok"] for item in items for sample in item["samples"])
    return good, sum(item["planned"] for item in items)


# -- the paper's files ------------------------------------------------------------------------------------


def _exact_counts(run: Run) -> list[str]:
    samples = {
        suite: sum(len(item["samples"]) for item in _items(run, suite)) for suite in (*_SUITE_MACROS, "recovery")
    }
    calls = {suite: len(_task_calls(_items(run, suite))) for suite in (*_SUITE_MACROS, "recovery")}
    tools = {name: adapter.get("tools", 0) for name, adapter in run["subject"]["adapters"].items()}
    macros: list[tuple[str, Any]] = [(macro, samples[suite]) for suite, macro in _SUITE_MACROS.items()]
    macros += [
        ("totalRecoveryTrials", samples["recovery"]),
        ("totalRuns", sum(samples.values())),
        ("totalToolCalls", calls["normal"] + calls["fault"] + calls["stress"]),
        ("normalToolCalls", calls["normal"]),
        ("faultToolCalls", calls["fault"]),
        ("stressToolCalls", calls["stress"]),
        ("recoveryToolCalls", run["footer"].get("tool_calls", {}).get("recovery", calls["recovery"])),
        ("modbusToolCount", tools.get("modbus", NONE)),
        ("mqttToolCount", tools.get("mqtt", NONE)),
        ("opcuaToolCount", tools.get("opcua", NONE)),
    ]
    return [f"\\newcommand{{\\{name}}}{{{value}}}" for name, value in macros]


def _tabular(columns: str, head: Sequence[str], rows: Sequence[str], width: str | None = None) -> list[str]:
    kind = "tabular" if width is None else "tabularx"
    opening = f"\\begin{{{kind}}}" + ("" if width is None else f"{{{width}}}") + f"{{{columns}}}"
    inner = ["\\toprule", *head, "\\midrule", *rows, "\\bottomrule"]
    return [f"    {opening}", *(f"        {line}" for line in inner), f"    \\end{{{kind}}}"]


def _row(*cells: str) -> str:
    return " & ".join(cells) + r" \\"


def _results(run: Run) -> list[str]:
    rows = []
    for family in _FAMILIES:
        items = _items(run, "normal", family)
        if not items:
            continue
        times, calls = _times(run, items), _task_calls(items)
        tool = _rate(sum(call["ok"] for call in calls), len(calls))
        median, p95 = _ms(percentile(times, 50)), _ms(percentile(times, 95))
        phases = [sample["phases"] for item in _items(run, "recovery", family) for sample in item["samples"]]
        recovered = _rate(sum(bool(phase and phase["same_session_ok"]) for phase in phases), len(phases))
        rows.append(_row(family, str(len(items)), _rate(*_passed(items)), tool, median, p95, recovered))
    head = [
        _row("Family", "Tasks", "Task", "Tool", "Med.", "p95", "Rec."),
        r"& & (\%) & (\%) & (ms) & (ms) & (\%) \\",
    ]
    return _tabular("@{}lcccccc@{}", head, rows)


def _task_breakdown(run: Run) -> list[str]:
    rows: list[str] = []
    for family in _FAMILIES:
        items = _items(run, "normal", family)
        if rows and items:
            rows.append("\\midrule")
        for item in items:
            times = _times(run, [item])
            p95 = _ms(percentile(times, 95))
            rows.append(_row(item["id"], family, escape(item["title"]), _ms(percentile(times, 50)), p95))
    head = [_row("ID", "Family", "Operation", "Median (ms)", "p95 (ms)")]
    return _tabular("@{}llYcc@{}", head, rows, r"\textwidth")


def _fault_results(run: Run) -> list[str]:
    rows = []
    for item in _items(run, "fault"):
        codes = sorted({call["error_code"] for call in _task_calls([item]) if call["error_code"]})
        label = ", ".join(code.replace("_", " ") for code in codes) or NONE
        median = _ms(percentile(_times(run, [item]), 50))
        cells = (item["id"], item["family"], escape(item["title"]), _rate(*_passed([item])), median, escape(label))
        rows.append(_row(*cells))
    head = [_row("ID", "Family", "Fault scenario", r"EH\%", "Med. (ms)", "Error class")]
    return _tabular("@{}llYccc@{}", head, rows, r"\columnwidth")


# -- the kit's own ----------------------------------------------------------------------------------------


def _count(item: Item) -> str:
    good = sum(sample["ok"] for sample in item["samples"])
    return f"{good}/{item['planned']}"


def _stress(run: Run) -> list[str]:
    rows = []
    for item in _items(run, "stress"):
        times = _times(run, [item])
        cells = (item["id"], item["family"], escape(item["title"]), _count(item), _ms(percentile(times, 50)))
        rows.append(_row(*cells, _ms(percentile(times, 95))))
    head = [_row("ID", "Family", "Stress scenario", "Passed", "Med. (ms)", "p95 (ms)")]
    return _tabular("@{}llYccc@{}", head, rows, r"\columnwidth")


def _recovery(run: Run) -> list[str]:
    rows = []
    for item in _items(run, "recovery"):
        phases = [sample["phases"] for sample in item["samples"] if sample["phases"]]
        cells = [item["family"]]
        for way in ("same_session", "fresh_session"):
            good = sum(bool(phase[f"{way}_ok"]) for phase in phases)
            cells += [f"{good}/{item['planned']}", _phase(run, phases, way)]
        rows.append(_row(*cells, _phase(run, phases, "detect")))
    head = [
        r"& \multicolumn{2}{c}{Same session} & \multicolumn{2}{c}{Fresh session} & Detect \\",
        _row("Family", "ok", "Med. (ms)", "ok", "Med. (ms)", "Med. (ms)"),
    ]
    return _tabular("@{}lccccc@{}", head, rows)


def _phase(run: Run, phases: Iterable[Mapping[str, Any]], name: str) -> str:
    if not run["footer"].get("timing_valid", True):
        return NONE
    return _ms(percentile([phase[name] for phase in phases if phase[name] is not None], 50))


def _statistics(run: Run) -> list[str]:
    rows = []
    for item in run["items"]:
        times = _times(run, [item])
        interval = mean_interval(times)
        good = sum(sample["ok"] for sample in item["samples"])
        bound = lower_bound(good, item["planned"])
        spread = f"{interval[0]:.2f}--{interval[1]:.2f}" if interval else NONE
        numbers = (mean(times), standard_deviation(times))
        shown = [NONE if number is None else f"{number:.2f}" for number in numbers]
        rest = [NONE if value is None else f"{value:.2f}" for value in (percentile(times, 50), percentile(times, 95))]
        least = NONE if bound is None else f"{100 * bound:.1f}"
        rows.append(_row(item["id"], _count(item), least, *shown, spread, *rest))
    head = [_row("ID", "Passed", r"$\geq$ (\%)", "Mean", "SD", r"95\,\% CI", "Med.", "p95")]
    return _tabular("@{}lccccccc@{}", head, rows)
