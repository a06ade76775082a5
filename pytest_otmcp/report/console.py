"""The summary of a run as lines of text. Pure: a run record in, lines with a style out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..statistics import lower_bound, mean, mean_interval, percentile

__all__ = ["summary"]

Line = tuple[str, str]
Run = Mapping[str, Any]

_SUITES = ("normal", "fault", "stress", "recovery")


def summary(run: Run, width: int = 100) -> list[Line]:
    """The closing tables, the time breakdown and the verdict.

    Args:
        run: a run record.
        width: columns of the terminal.

    Returns:
        Lines with a style: ``ok``, ``bad``, ``head`` or ``plain``.
    """
    lines: list[Line] = []
    for suite in _SUITES:
        items = [item for item in run["items"] if item["suite"] == suite]
        if items:
            lines += [("", "plain"), *_suite(suite, items, run["footer"].get("timing_valid", True), width)]
    lines += [("", "plain"), *_findings(run, width), *_counts(run), *_verdict(run)]
    return lines


def _suite(suite: str, items: list[Mapping[str, Any]], timing: bool, width: int) -> Iterator[Line]:
    if suite == "recovery":
        yield f"{'recovery':<10}{'same session':>16}{'median ms':>11}{'fresh session':>16}{'median ms':>11}", "head"
        for item in items:
            phases = [sample["phases"] for sample in item["samples"] if sample["phases"]]
            row = f"  {item['id']:<10}"
            for way in ("same_session", "fresh_session"):
                good = sum(bool(phase[f"{way}_ok"]) for phase in phases)
                times = [phase[way] for phase in phases if phase[way] is not None]
                row += f"{good}/{len(phases)}".rjust(14) + _number(percentile(times, 50) if timing else None, 13)
            yield row, _style(item)
        return
    # Mean and its interval are in the LaTeX tables too; a narrow terminal rather shows what the task is.
    wide = width >= 120
    more = f"{'mean ms':>9}{'95 % CI':>17}" if wide else ""
    yield f"{suite:<10}{'passed':>9}{'at least':>10}{'median ms':>11}{'p95 ms':>9}{more}   task", "head"
    for item in items:
        times = [sample["duration_ms"] for sample in item["samples"]] if timing else []
        good = sum(sample["ok"] for sample in item["samples"])
        bound = lower_bound(good, len(item["samples"]))
        row = (
            f"  {item['id']:<8}{good:>5}/{item['planned']:<3}"
            + (f"{100 * bound:>8.1f} %" if bound is not None else f"{'---':>10}")
            + _number(percentile(times, 50), 11)
            + _number(percentile(times, 95), 9)
        )
        if wide:
            interval = mean_interval(times)
            row += _number(mean(times), 9)
            row += f"{f'{interval[0]:.2f}..{interval[1]:.2f}' if interval else '---':>17}"
        yield f"{row}   {item['title']}"[:width], _style(item)


def _number(value: float | None, columns: int) -> str:
    return ("---" if value is None else f"{value:.2f}").rjust(columns)


def _style(item: Mapping[str, Any]) -> str:
    return {"PASS": "plain", "NOT_APPLICABLE": "plain"}.get(item["status"], "bad")


def _findings(run: Run, width: int) -> Iterator[Line]:
    failing = [item for item in run["items"] if item["status"] not in ("PASS", "NOT_APPLICABLE")]
    if not failing:
        return
    yield "findings", "head"
    for item in failing:
        yield f"  {item['id']} {item['status']}: {item['title']}"[:width], "bad"
        shown = [("", finding) for finding in item["findings"]]
        for sample in item["samples"]:
            where = f"rep {sample['repetition'] + 1}/{item['planned']}: "
            shown += [(where, finding) for finding in sample["findings"]]
        for where, finding in shown[:3]:
            yield f"      {where}{finding['message']}", "plain"
        if len(shown) > 3:
            yield f"      and {len(shown) - 3} more in run.json", "plain"
    yield "", "plain"


def _counts(run: Run) -> Iterator[Line]:
    footer = run["footer"]
    calls = footer["tool_calls"]
    others = ", ".join(f"{calls[role]} {role}" for role in ("recovery", "control", "setup", "warmup"))
    yield f"{footer['samples']} runs, {calls['task']} tool calls ({others} calls counted apart)", "plain"
    spent = footer["breakdown_s"]
    total = sum(spent.values()) or 1.0
    parts = ", ".join(
        f"{what} {seconds:.1f} s ({100 * seconds / total:.0f} %)"
        for what, seconds in sorted(spent.items(), key=lambda entry: -entry[1])
    )
    yield f"{footer['elapsed_s']:.1f} s: {parts}", "plain"
    if not footer["timing_valid"]:
        yield "latencies withheld: the run was parallel, so they measure the neighbours too", "plain"


def _verdict(run: Run) -> Iterator[Line]:
    footer = run["footer"]
    items = run["items"]
    passed = sum(sample["ok"] for item in items for sample in item["samples"])
    planned = sum(item["planned"] for item in items if item["status"] != "NOT_APPLICABLE")
    note = f"{passed}/{planned} runs passed in {len(items)} items"
    if footer.get("reason"):
        note += f"; {footer['reason']}"
    yield f"VERDICT: {footer['verdict']} ({note})", "ok" if footer["verdict"] == "CONFORMANT" else "bad"
