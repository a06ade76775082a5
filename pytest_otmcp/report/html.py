"""The HTML report of a run: ``report.html.jinja``, filled. Pure but for the writing."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..core.matrix import SUITES
from ..record.warnings import warnings
from ..suite.catalogue import all_tasks
from ..suite.explanations import item as explained_item
from ..suite.levels import NOT_SHOWN, said, shown, standings
from ..suite.requirements import catalogue, requirements
from . import Item, Run, applied, applies, command, deadlines, overview, tally, timing_valid
from .applying import nothing_asked
from .capabilities import earned
from .causes import causes, extent
from .drawings import latencies, recovery, strip, suite_strip
from .evidence import failures
from .families import applying_families
from .identity import identity
from .limits import narrowed
from .page import filled
from .strangers import strangers

__all__ = ["page", "write_html"]

_STATUSES = {
    "PASS": "passed",
    "FAIL": "failed",
    "NOT_APPLICABLE": "not claimed",
    "NOT_TESTABLE": "cannot be tested",
    "KIT_ERROR": "fault of the kit",
    "INTERRUPTED": "interrupted",
}
_QUESTIONS = {
    "normal": "Does it do what it is asked?",
    "fault": "Does it refuse what is wrong, and change nothing?",
    "stress": "Does it keep answers apart, and survive a lost endpoint?",
    "recovery": "How soon does it notice an outage, and how soon is it back?",
}
_SENTENCES = {
    "CONFORMANT": "Every item passed every repetition, and the devices agree with what the adapter said.",
    "NOT CONFORMANT": "The adapter failed. Each failure is below: what was asked, what was said, what the device saw.",
    "INDETERMINATE": "This run says nothing about the adapter: the kit itself failed.",
    "INCOMPLETE": "Not everything ran, so this run proves nothing yet.",
}
_TONES = {"CONFORMANT": "good", "NOT CONFORMANT": "bad"}


def _nothing_asked(run: Run) -> str:
    told = nothing_asked(run)
    return f"This run says nothing about the adapter: {told}." if told else ""


def write_html(run: Run, path: Path) -> None:
    """Write the report of a run to ``path``."""
    path.write_text(page(run), encoding="utf-8", newline="\n")


def page(run: Run, certificate: str | None = None) -> str:
    """Return the report of a run as HTML.

    Args:
        certificate: the name of the file beside the report that is the certificate of this run.
    """
    verdict = run["footer"].get("verdict", "INCOMPLETE")
    good, planned = tally(run["items"])
    anchors = _anchors(run["items"])
    failing = failures(run)
    families = applying_families(run)
    # A rule of which no column says anything is of a protocol without an adapter.
    rules = [row for row in overview.requirements(run) if not set(families).isdisjoint(row[1])]
    return filled(
        "report.html.jinja",
        run=run,
        certificate=certificate,
        verdict=verdict,
        tone=_TONES.get(verdict, "open"),
        sentence=_nothing_asked(run) or _SENTENCES.get(verdict, ""),
        applied=applied(run),
        deadlines=deadlines(run),
        rules=_rules(rules),
        catalogue=requirements(),
        example=next((name for name, _ in rules if name in requirements()), next(iter(requirements()))),
        good=good,
        planned=planned,
        warnings=warnings(run["items"]),
        narrowed=narrowed(run),
        strangers=strangers(run),
        deviations=overview.deviations(run),
        families=families,
        identity=identity(run),
        capabilities=earned(run),
        levels=_levels(run),
        no_level=NOT_SHOWN,
        causes=causes(run),
        extent=extent,
        failures=failing,
        anchors=anchors,
        # The id of a failed item links to its evidence.
        targets={**anchors, **{one.item["id"]: f"failed-{anchors[one.item['id']]}" for one in failing}},
        statuses=_STATUSES,
        suites=[_suite(suite, rows) for suite in SUITES if (rows := overview.tasks(run, suite))],
        explained={item["id"]: _explained(item["id"]) for item in run["items"]},
        requirements=[row for row in rules if not _kept(row)],
        kept_requirements=[row for row in rules if _kept(row)],
        latencies=latencies(run),
        recovery=recovery(run),
        strip=strip,
        recovery_rows=overview.recovery_rows(run),
        statistics=overview.statistics(run),
        timing_valid=timing_valid(run),
        adapters=overview.adapters(run),
        facts=overview.facts(run),
        rerun=command(run),
    )


_OF_A_ROW = ("Asked", "Must be said", "Must be seen at the device", "Once before", "Once afterwards", "Why")


def _levels(run: Run) -> list[tuple[str, list[str]]]:
    """Return a line for each protocol with what is missing for its next level; none without the requirement suite."""
    rows = catalogue()
    return [(said(one), shown(one, rows)) for one in standings(rows, run["items"], run["subject"]["adapters"])]


def _suite(name: str, rows: list[overview.Row]) -> dict[str, Any]:
    """Return a suite as the page shows it: one line, and its rows behind it."""
    items = [row.item for row in rows]
    applying = [item for item in items if applies(item)]
    passed = sum(item["status"] == "PASS" for item in applying)
    good, planned = tally(items)
    return {
        "name": name,
        "question": _QUESTIONS.get(name, ""),
        "rows": rows,
        "red": passed < len(applying),
        "said": f"{passed}/{len(applying)} items, {good}/{planned} repetitions" if applying else "does not apply",
        "strip": suite_strip(items),
    }


def _explained(identifier: str) -> list[tuple[str, tuple[str, ...]]]:
    """Return what is asked and judged in an item; nothing for one that is not in the suite that is installed here."""
    task = all_tasks().get(identifier)
    return [] if task is None else [part for part in explained_item(task).parts if part[0] in _OF_A_ROW]


def _kept(row: tuple[str, dict[str, overview.Cell]]) -> bool:
    return all(cell.state in ("passed", "not claimed") for cell in row[1].values())


def _rules(rows: Iterable[tuple[str, object]]) -> dict[str, str]:
    """Map each requirement that the run says something about to its anchor on the page."""
    return {name: f"rule-{name}" if name in requirements() else f"rule_{index}" for index, (name, _) in enumerate(rows)}


def _anchors(items: Iterable[Item]) -> dict[str, str]:
    """Map the id of each item to its anchor on the page; an id may have any characters, an anchor may not."""
    return {
        item["id"]: f"item-{item['id']}" if re.fullmatch(r"[A-Za-z0-9.-]+", item["id"]) else f"item_{index}"
        for index, item in enumerate(items)
    }
