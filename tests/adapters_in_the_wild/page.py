"""The generated sections of ``docs/field-report.md``: functions of the run records. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pytest_otmcp.certificate.eligibility import objections
from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.core.verdict import Verdict
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.schema import Item, Run
from pytest_otmcp.record.warnings import failing, said, warnings
from pytest_otmcp.report import applied, applies, tally
from pytest_otmcp.report.causes import Cause, causes
from pytest_otmcp.report.markdown import code, escape
from pytest_otmcp.suite import levels
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.suite.requirements import catalogue, requirements

from .wire import wire

__all__ = ["PAPER", "details", "side_by_side", "table"]

PAPER = "industriconnect"
"""The row of the paper's own code."""
_LATER = "industriagents"
"""The row of what the paper's authors have published since."""

_HEAD = (
    "adapter",
    "speaks",
    "items applied",
    "runs passed",
    "verdict",
    "causes",
    "warnings",
    "level",
    "certificate",
)
_NONE = "—"

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
    found = causes(run)
    listed = "<br>".join(f"{_cited(cause)}: {' '.join(cause.items)}" for cause in found)
    subject = run["subject"]
    good, planned = tally(run["items"])
    return (
        f"[{escape(subject['name'])}](#{name}) {escape(subject['version'])}",
        ", ".join(protocols()[key].name for key in subject["adapters"]),
        applied(run).removesuffix(" items applied"),
        f"{good} of {planned}",
        _verdict(run).lower(),
        listed or _NONE,
        str(len(warnings(run["items"])) or _NONE),
        _level(run),
        _certificate(run),
    )


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


def details(runs: Mapping[str, Run]) -> str:
    """Return a section for each adapter: the causes, with the wire beside them, and what the replies alone would have said."""
    lines = []
    for name, run in runs.items():
        lines += [f'<a id="{name}"></a>', "", f"### {escape(run['subject']['name'])}", "", _summary(name, run), ""]
        for number, cause in enumerate(causes(run), 1):
            lines += _cause(number, cause)
        for warning in warnings(run["items"]):
            lines += [f"Warning: {code(said(warning))}", ""]
    return "\n".join(lines)


def _summary(name: str, run: Run) -> str:
    items = [item for item in run["items"] if item["suite"] in ("normal", "fault")]
    (good, planned), replies = tally(items), _claimed(items)
    return (
        f"[Subject file](examples/{name}/otmcp.toml), [record](field-report/{name}.json.xz), of {run['environment']['started_at'][:10]}; "
        f"again: `python -m tests.adapters_in_the_wild.field_report run {name}`. Of {planned} repetitions of the normal and the fault suite "
        f"{replies} are as expected by what the replies claim, {good} when the device is asked, too."
    )


def _cause(number: int, cause: Cause) -> list[str]:
    rule = requirements().get(cause.rule)
    lines = [f"**{number}. {_cited(cause)}** ({cause.family}), in {', '.join(cause.items)}:", ""]
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
    head = ["", "the paper"]
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
