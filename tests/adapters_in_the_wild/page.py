"""The generated sections of ``docs/field-report.md``, and its page for each adapter: functions of the run records. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from pytest_otmcp.certificate.eligibility import objections
from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.core.verdict import Verdict
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.schema import Item, Run
from pytest_otmcp.record.warnings import failing, said, warnings
from pytest_otmcp.report import applies, tally
from pytest_otmcp.report.capabilities import Grade, earned
from pytest_otmcp.report.causes import Cause, causes
from pytest_otmcp.report.markdown import code, escape
from pytest_otmcp.suite import levels
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.suite.requirements import catalogue, requirements
from pytest_otmcp.suite.spoken import spoken

from .wire import wire

__all__ = ["PAPER", "adapter_page", "matrix", "side_by_side", "table"]

PAPER = "industriconnect"
"""The row of the paper's own code."""
_LATER = "industriagents"
"""The row of what the paper's authors have published since."""

_HEAD = (
    "adapter",
    "speaks",
    "items passed",
    "runs passed",
    "verdict",
    "causes",
    "warnings",
    "level",
    "certificate",
)
_NONE = "—"
_FOLDER = re.compile(r"/[\w./-]*/work/[0-9a-f]{32}")

_CLAIMS = {"not_successful", "not_refused", "no_reply", "no_envelope", "json_rpc_error", "session_lost"}
"""Codes of findings about what a reply claims, for which nobody needs the device."""

_PAPER = {
    # From its tables of the normal and the fault suite, its analysis of S11, and the column "Rec." of the former.
    "normal": "480/480",
    "fault": "210/210",
    "S10": "recovers",
    "S11": "0 %",
    "S12": "recovers",
    "recovery": "100 %",
}


def table(runs: Mapping[str, Run], names: Iterable[str]) -> str:
    """Return the table with a row for each adapter that has a record, and the names of the others."""
    missing = [name for name in names if name not in runs]
    note = f"\nNot measured with 30 repetitions yet: {', '.join(missing)}.\n" if missing else ""
    return _table(_HEAD, (_row(name, run) for name, run in runs.items())) + note


def _row(name: str, run: Run) -> tuple[str, ...]:
    subject = run["subject"]
    good, planned = tally(run["items"])
    return (
        _linked(name, run),
        ", ".join(protocols()[key].name for key in subject["adapters"]),
        _counted(run),
        f"{good} of {planned}",
        _verdict(run).lower(),
        str(len(causes(run)) or _NONE),
        str(len(warnings(run["items"])) or _NONE),
        _level(run),
        _certificate(run),
    )


def _linked(name: str, run: Run) -> str:
    subject = run["subject"]
    return f"[{escape(subject['name'])}](field-report/{name}.md) {escape(subject['version'])}"


_MARKS = {Grade.EARNED: "✓ earned", Grade.NOT_EARNED: "✗ not earned"}


def matrix(runs: Mapping[str, Run]) -> str:
    """Return the table of what each adapter has earned, a row for each protocol that it speaks."""
    # A run without the requirement suite has no column for what that alone asks.
    names = max(([heading.name for heading, _ in earned(run)] for run in runs.values()), key=len)
    rows = []
    for name, run in runs.items():
        by_name = {heading.name: by_family for heading, by_family in earned(run)}
        for key in run["subject"]["adapters"]:
            family = protocols()[key].name
            grades = [by_name[one][family].grade if one in by_name else None for one in names]
            rows.append((_linked(name, run), family, *map(_marked, grades)))
    return _table(["adapter", "protocol", *map(str.lower, names)], rows)


def _marked(grade: Grade | None) -> str:
    return "not measured" if grade is None else _MARKS.get(grade, grade.value)


def _counted(run: Run) -> str:
    found = spoken(run).values()
    return f"{sum(one.passed for one in found)} of {sum(one.of for one in found)}"


def _level(run: Run) -> str:
    if REQUIREMENTS not in run["settings"]["suites"]:
        return "not measured"
    found = levels.standings(catalogue(), run["items"], run["subject"]["adapters"])
    return "<br>".join(map(levels.said, found))


def _certificate(run: Run) -> str:
    if _verdict(run) != Verdict.CONFORMANT:
        return _NONE
    reasons = objections(run, tasks_by_id(run["subject"]["adapters"], run["settings"]["suites"]))
    return f"no: {'; '.join(reasons)}" if reasons else "yes"


def adapter_page(name: str, run: Run) -> str:
    """Return the page of an adapter: the causes, with the wire beside them, and what the replies alone would have said."""
    head, row = _HEAD[1:], _row(name, run)[1:]
    subject = run["subject"]
    lines = [f"# {escape(subject['name'])} {escape(subject['version'])}", ""]
    lines += [_table(head, [row]), _summary(name, run), ""]
    found = causes(run)
    if found:
        lines += ["## Causes", ""]
    for number, cause in enumerate(found, 1):
        lines += _cause(number, cause)
    if warned := warnings(run["items"]):
        lines += ["## Warnings", "", *(f"- {code(said(warning))}" for warning in warned)]
    # Where the fleet had its folders says nothing about the adapter.
    return _FOLDER.sub("{dir}", "\n".join(lines).rstrip()) + "\n"


def _summary(name: str, run: Run) -> str:
    items = [item for item in run["items"] if item["suite"] in ("normal", "fault")]
    (good, planned), replies = tally(items), _claimed(items)
    return (
        f"Measured on {run['environment']['started_at'][:10]} with {run['settings']['reps']} repetitions. "
        f"Of {planned} repetitions of the normal and the fault suite {replies} are as expected by what the replies claim, {good} when the "
        f"device is asked, too.\n\n[Field report](../field-report.md) · [subject file](../examples/{name}/otmcp.toml) · "
        f"[run record]({name}.json.xz)"
    )


def _cause(number: int, cause: Cause) -> list[str]:
    rule = requirements().get(cause.rule)
    lines = [f"### {number}. {_cited(cause)} ({cause.family})", "", f"In {', '.join(cause.items)}:", ""]
    lines += [code(_sentence(cause.first["message"])), ""]
    if rule is not None:
        lines += [f"> {rule.statement} ({rule.source})", ""]
    if cause.further:
        lines += ["Further findings about the same rule:", ""]
        lines += [*(f"- {code(_sentence(message))}" for message in cause.further), ""]
    if shown := wire(cause):
        lines += ["```text", *shown, "```", ""]
    return lines


def _cited(cause: Cause) -> str:
    code = f"`{cause.first['code']}`"
    return f"{cause.rule} {code}" if cause.rule != cause.first["code"] else code


def _sentence(message: str) -> str:
    """Return a message in one line; of a process's last lines only the very last, which says what went wrong."""
    first, *rest = message.splitlines()
    return f"{first} … {rest[-1].strip()}" if rest else first


def side_by_side(runs: Mapping[str, Run]) -> str:
    """Return the paper's table and what its public code, and its authors' later releases, do."""
    ours = [runs[name] for name in (PAPER, _LATER) if name in runs]
    head = ["items", "the paper"]
    for run in ours:
        name = f"{run['subject']['name']} {run['subject']['version']}"
        head += [f"{name}: by the replies", "by the device"]
    rows = []
    for suite, words in (("normal", "normal suite"), ("fault", "fault suite")):
        rows.append((words, _PAPER[suite], *(cell for run in ours for cell in _suite(run, suite))))
    for identifier in ("S10", "S11", "S12"):
        rows.append((identifier, _PAPER[identifier], *(cell for run in ours for cell in _item(run, identifier))))
    for identifier in ("R-modbus", "R-mqtt", "R-opcua"):
        rows.append((identifier, _PAPER["recovery"], *(cell for run in ours for cell in _item(run, identifier))))
    return _table(head, rows)


def _suite(run: Run, suite: str) -> tuple[str, str]:
    return _counts([item for item in run["items"] if item["suite"] == suite])


def _item(run: Run, identifier: str) -> tuple[str, str]:
    return _counts([item for item in run["items"] if item["id"] == identifier])


def _counts(items: list[Item]) -> tuple[str, str]:
    good, planned = tally(items)
    if not planned:
        return _NONE, _NONE
    failed = " ".join(item["id"] for item in items if item["status"] == "FAIL") if len(items) > 1 else ""
    return f"{_claimed(items)}/{planned}", f"{good}/{planned}" + (f"; failed: {failed}" if failed else "")


def _claimed(items: Iterable[Item]) -> int:
    """Count the repetitions that pass if nobody looks at the device: what every reply claims is as expected."""
    samples = (sample for item in items if applies(item) for sample in item["samples"])
    return sum(_CLAIMS.isdisjoint(finding["code"] for finding in failing(sample["findings"])) for sample in samples)


def _verdict(run: Run) -> str:
    return run["footer"]["verdict"]


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    cells = [list(head), *map(list, rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    return "\n".join([lines[0], "|" + "---|" * len(cells[0]), *lines[1:]]) + "\n"
