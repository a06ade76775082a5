"""The HTML report of a run: ``report.html.jinja``, filled. Pure but for the writing, and the address of the documentation."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from ..core.finding_registry import finding_codes
from ..core.matrix import KNOWN_SUITES
from ..core.text import counted
from ..core.verdict import Verdict
from ..core.walls import missing
from ..record.warnings import warnings
from ..suite.catalogue import known_tasks
from ..suite.explanations import HOW_A_LEVEL_IS_EARNED
from ..suite.explanations import item as explained_item
from ..suite.levels import in_words, not_shown, said, shown, standings
from ..suite.places import address
from ..suite.requirements import Level, catalogue, requirements
from ..suite.spoken import of_spoken, spoken, tell
from . import Item, Run, applies, command, deadlines, overview, tally, timing_valid
from .applying import nothing_asked
from .capabilities import earned
from .causes import Cause, causes, extent, remedy, without_cause
from .causes import rows as told_of
from .drawings import latencies, recovery, strip, suite_strip
from .evidence import failures
from .families import spoken_families
from .findings import subject_keys
from .identity import identity
from .limits import narrowed, partial
from .page import filled
from .permission import permission
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
    "CONFORMANT": "Every item that applies passed every repetition, and the devices agree with what the adapter said.",
    "NOT CONFORMANT": "Each cause is below: what was asked, what was said, what the device saw, what to change.",
    "INDETERMINATE": "This run says nothing about the adapter: the kit itself failed.",
    "INCOMPLETE": "Not everything ran, so this run proves nothing yet.",
}
_RULES = 3
"""Rules that a sentence names at most."""
_TONES = {"CONFORMANT": "good", "NOT CONFORMANT": "bad"}


def _nothing_asked(run: Run) -> str:
    told = nothing_asked(run)
    return f"This run says nothing about the adapter: {told}." if told else ""


def _failed(verdict: str, found: Sequence[Cause]) -> str:
    """Say whether an adapter that failed only fell short, or said what was not so."""
    if verdict != Verdict.NOT_CONFORMANT:
        return ""
    known = finding_codes()
    false = [cause.rule for cause in found if (code := cause.first["code"]) in known and known[code].contradicts]
    if not false:
        return "The adapter failed."
    rules = list(dict.fromkeys(false))
    more = f" and {len(rules) - _RULES} more" if len(rules) > _RULES else ""
    of = f"{len(false)} of {counted(len(found), 'cause')}: {', '.join(rules[:_RULES])}{more}"
    return f"The adapter failed, and its device contradicts what it said ({of})."


def write_html(run: Run, path: Path) -> None:
    """Write the report of a run to ``path``."""
    path.write_text(page(run), encoding="utf-8", newline="\n")


def page(run: Run, certificate: str | None = None) -> str:
    """Return the report of a run as HTML.

    Args:
        certificate: the name of the file beside the report that is the certificate of this run.
    """
    counts = spoken(run)
    # What needs an adapter that the subject does not have says nothing about it.
    run = of_spoken(run)
    verdict = run["footer"].get("verdict", "INCOMPLETE")
    walls = missing(run["environment"].get("walls", {}))
    reasons = narrowed(run)
    good, planned = tally(run["items"])
    anchors = _anchors(run["items"])
    failing = {failure.item["id"]: failure for failure in failures(run)}
    found = causes(run)
    families = spoken_families(run)
    # A rule of which no column says anything is of a protocol without an adapter.
    rules = [row for row in overview.requirements(run) if not set(families).isdisjoint(row[1])]
    return filled(
        "report.html.jinja",
        run=run,
        address=address,
        certificate=certificate,
        verdict=verdict,
        tone=_TONES.get(verdict, "open"),
        sentence=_nothing_asked(run) or " ".join(filter(None, (_failed(verdict, found), _SENTENCES.get(verdict)))),
        partial=partial(run),
        permission=permission(run, certified=certificate is not None),
        counts=counts,
        counted=tell(counts),
        level=in_words(standings(catalogue(), run["items"], run["subject"]["adapters"])),
        version=catalogue().version,
        how=HOW_A_LEVEL_IS_EARNED,
        meanings=[(level.capitalize(), level.meaning) for level in Level],
        walls=walls,
        deadlines=deadlines(run),
        rules=_rules(rules),
        catalogue=requirements(),
        example=next((name for name, _ in rules if name in requirements()), next(iter(requirements()))),
        good=good,
        planned=planned,
        warnings=[(one, remedy(one["requirement"], one["code"])) for one in warnings(run["items"])],
        narrowed=reasons,
        strangers=strangers(run),
        deviations=overview.deviations(run),
        families=families,
        identity=identity(run),
        capabilities=earned(run),
        levels=_levels(run),
        no_level=not_shown(run["items"]),
        causes=[(cause, told_of(cause), [failing[name] for name in below]) for cause, below in _cards(found)],
        extent=extent,
        keys=subject_keys,
        further=[failing[item["id"]] for item in without_cause(run)],
        failures=failing,
        anchors=anchors,
        # The id of a failed item links to its evidence.
        targets={**anchors, **{name: f"failed-{anchors[name]}" for name in failing}},
        statuses=_STATUSES,
        suites=[_suite(suite, rows) for suite in KNOWN_SUITES if (rows := overview.tasks(run, suite))],
        explained={item["id"]: _explained(item["id"]) for item in run["items"]},
        requirements=[row for row in rules if not _kept(row)],
        kept_requirements=[row for row in rules if _kept(row) and not _unasked(row)],
        unasked_requirements=[row for row in rules if _unasked(row)],
        latencies=latencies(run),
        recovery=recovery(run),
        strip=strip,
        recovery_rows=overview.recovery_rows(run),
        statistics=overview.statistics(run),
        timing_valid=timing_valid(run),
        adapters=overview.adapters(run),
        facts=overview.facts(run),
        again=lambda cause: command(run, cause.where, cause.repetition or 0),
        rerun=command(run),
    )


_OF_A_ROW = ("Asked", "Must be said", "Must be seen at the device", "Once before", "Once afterwards", "Why")


def _levels(run: Run) -> list[tuple[str, list[str]]]:
    """Return a line for each protocol with what is missing for its next level; none without the requirement suite."""
    rows = catalogue()
    return [(said(one), shown(one, rows)) for one in standings(rows, run["items"], run["subject"]["adapters"])]


def _cards(found: Iterable[Cause]) -> Iterator[tuple[Cause, list[str]]]:
    """Yield each cause with the items whose evidence stands below it: those that no cause before it touches."""
    told = set[str]()
    for cause in found:
        yield cause, [name for name in cause.items if name not in told]
        told.update(cause.items)


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
    task = known_tasks().get(identifier)
    return [] if task is None else [part for part in explained_item(task).parts if part[0] in _OF_A_ROW]


def _kept(row: tuple[str, dict[str, overview.Cell]]) -> bool:
    return all(cell.state in ("kept", "not asked") for cell in row[1].values())


def _unasked(row: tuple[str, dict[str, overview.Cell]]) -> bool:
    return all(cell.state == "not asked" for cell in row[1].values())


def _rules(rows: Iterable[tuple[str, object]]) -> dict[str, str]:
    """Map each requirement that the run says something about to its anchor on the page."""
    return {name: f"rule-{name}" if name in requirements() else f"rule_{index}" for index, (name, _) in enumerate(rows)}


def _anchors(items: Iterable[Item]) -> dict[str, str]:
    """Map the id of each item to its anchor on the page; an id may have any characters, an anchor may not."""
    return {
        item["id"]: f"item-{item['id']}" if re.fullmatch(r"[A-Za-z0-9.-]+", item["id"]) else f"item_{index}"
        for index, item in enumerate(items)
    }
