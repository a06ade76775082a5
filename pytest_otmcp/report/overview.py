"""The tables of a report about several items: tasks, requirements, recovery, statistics, and facts about the run. Pure.

Cells are text, as a reader sees them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..core.statistics import (
    lower_bound,
    mean,
    mean_interval,
    median_interval,
    outliers,
    percentile,
    standard_deviation,
)
from ..core.walls import missing, stood
from ..record.warnings import failing, findings_of, passed_beside
from . import Item, Run, applies, control_failed, durations, least, phases, recovered, tally
from . import adapters as having_sessions
from .text import at_least, count, interval, number

__all__ = [
    "NONE",
    "Adapter",
    "Cell",
    "Deviation",
    "Row",
    "adapters",
    "deviations",
    "facts",
    "recovery_rows",
    "requirements",
    "statistics",
    "tasks",
]

NONE = "—"
PAPERS_WINDOW_MS = 1000.0
"""How long after a restart the paper lets a call fail; the verdict allows what the subject declares."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """An item in the table of its suite; ``reason`` says why it does not apply, or cannot be tested, or is empty."""

    item: Item
    reason: str
    passed: str
    least: str
    median: str
    p95: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """State of one requirement by the items of one family, and the ids of the items that decided it."""

    state: str
    because: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviation:
    """A failure that the vendor knows of, and its state in this run: ``kind`` is ``used``, ``stale``, ``expired`` or ``not run``."""

    item: str
    reason: str
    expires: str
    kind: str
    state: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Adapter:
    """An adapter as it was started and as it introduced itself, with notes on its answers."""

    protocol: str
    server: str
    revision: str
    tools: str
    deadline: str
    command: str
    notes: tuple[str, ...]


def tasks(run: Run, suite: str) -> list[Row]:
    """Return the rows of a suite's items."""
    rows = []
    for item in run["items"]:
        if item["suite"] == suite:
            times = durations(run, [item])
            rate = least(item)
            rows.append(
                Row(
                    item=item,
                    reason=item.get("reason") or "",
                    passed=_passed(item),
                    least=at_least(rate, NONE),
                    median=_number(percentile(times, 50)),
                    p95=_number(percentile(times, 95)),
                )
            )
    return rows


def requirements(run: Run) -> list[tuple[str, dict[str, Cell]]]:
    """Return each requirement with its state in every family.

    ``violated``: a finding names it. ``not shown``: an item about it failed for another reason, or did not end.
    """
    found: dict[str, dict[str, dict[str, str]]] = {}
    for item in run["items"]:
        broken = {requirement for finding in failing(findings_of(item)) if (requirement := finding["requirement"])}
        for name in [*item.get("requirements", ()), *sorted(broken)]:
            passed = item["status"] == "PASS" or passed_beside(item)
            state = "violated" if name in broken else "kept" if passed else "not shown"
            if item["status"] == "NOT_APPLICABLE":
                state = "not asked"
            found.setdefault(name, {}).setdefault(item["family"], {})[item["id"]] = state
    return [
        (name, {family: _cell(items) for family, items in by_family.items()})
        for name, by_family in sorted(found.items())
    ]


def _cell(items: Mapping[str, str]) -> Cell:
    for state in ("violated", "not shown", "kept"):
        if names := tuple(name for name, own in items.items() if own == state):
            return Cell(state=state, because=names)
    return Cell(state="not asked")


def recovery_rows(run: Run) -> list[tuple[str, ...]]:
    """Return a row for each item with outages that applies: id, family, median detection, rate and median of the same session, how often
    that was within the paper's window, and rate and median of a fresh session."""
    rows: list[tuple[str, ...]] = []
    for item in filter(applies, run["items"]):
        if item["suite"] == "recovery" or any(sample["phases"] for sample in item["samples"]):
            same, fresh = (phases(run, item, way) for way in ("same_session", "fresh_session"))
            rows.append(
                (
                    item["id"],
                    item["family"],
                    _number(percentile(phases(run, item, "detect"), 50)),
                    _rate(item, "same_session"),
                    _number(percentile(same, 50)),
                    _count(sum(time_ms <= PAPERS_WINDOW_MS for time_ms in same), len(same)),
                    # After a restart between calls no fresh session is tried.
                    _rate(item, "fresh_session") if item["suite"] == "recovery" else NONE,
                    _number(percentile(fresh, 50)),
                )
            )
    return rows


def _rate(item: Item, way: str) -> str:
    good, total = recovered([item], way)
    bound = None if failing(item["findings"]) else lower_bound(good, total)
    return _count(good, total) + (f", at least {at_least(bound, NONE)}" if bound is not None else "")


def statistics(run: Run) -> list[tuple[str, ...]]:
    """Return, by item: id, n, mean, its deviation and interval, median and its interval, 95th percentile, outliers."""
    rows: list[tuple[str, ...]] = []
    for item in run["items"]:
        if times := durations(run, [item]):
            outside = outliers(times)
            rows.append(
                (
                    item["id"],
                    str(len(times)),
                    _number(mean(times)),
                    _number(standard_deviation(times)),
                    _interval(mean_interval(times)),
                    _number(percentile(times, 50)),
                    _interval(median_interval(times)),
                    _number(percentile(times, 95)),
                    NONE if outside is None else str(outside),
                )
            )
    return rows


_STATES = {
    "used": "it fails, and is excused from the exit code",
    "stale": "its item passes, and the exit code is 1 until this entry is removed",
    "expired": "its day is over, and the exit code is 1 until it is mended or the day is moved",
    "not run": "its item did not run to its end",
}


def deviations(run: Run) -> list[Deviation]:
    """Return the known deviations."""
    found = run["footer"].get("deviations", {})
    kinds = {item: kind for kind in _STATES for item in found.get(kind, ())}
    return [
        Deviation(
            item=entry["item"],
            reason=entry["reason"],
            expires=entry["expires"],
            kind=(kind := kinds.get(entry["item"], "not run")),
            state=_STATES[kind],
        )
        for entry in run["subject"].get("deviations", ())
    ]


def adapters(run: Run) -> list[Adapter]:
    """Return the subject's adapters."""
    return [_adapter(protocol, facts) for protocol, facts in having_sessions(run).items()]


def _adapter(protocol: str, facts: Mapping[str, Any]) -> Adapter:
    notes = []
    if facts.get("envelope", "native") != "native":
        notes.append("Its answers are not the envelope; the subject file says how they were read.")
    if unmet := facts.get("unmet"):
        notes.append(f"Not claimed, and not met by its own answers: {', '.join(unmet)}.")
    if unjudged := facts.get("unjudged"):
        notes.append(f"Not found in its answers, so not judged: {', '.join(unjudged)}.")
    notes += [f"Does not claim {facet}: {reason}." for facet, reason in facts.get("unclaimed", {}).items()]
    if "recovery_s" in facts:
        notes.append(f"Has {facts['recovery_s']:g} s to work again after an outage.")
    if limit := facts.get("call_limit"):
        notes.append(f"Declares that it takes {limit['calls']} calls in {limit['per_s']:g} s; the kit kept to it.")
    for operation, seconds in facts.get("cached", {}).items():
        notes.append(f"Declares that {operation} may be known from up to {seconds:g} s ago.")
    return Adapter(
        protocol=protocol,
        server=" ".join(filter(None, (facts.get("server_name") or NONE, facts.get("server_version")))),
        revision=str(facts.get("protocol_version") or NONE),
        tools=str(facts.get("tools", NONE)),
        deadline=f"{facts['deadline_s']:g}",
        command=" ".join(facts.get("command", ())) or NONE,
        notes=tuple(notes),
    )


def facts(run: Run) -> list[tuple[str, str]]:
    """Return what the record says about kit, machine and settings."""
    kit, environment, settings, footer = run["kit"], run["environment"], run["settings"], run["footer"]
    spent = footer.get("breakdown_s", {})
    walls = environment.get("walls", {})
    packages = environment.get("packages", {})
    known = {
        "Kit": f"{kit.get('name')} {kit.get('version')}",
        "Suite": kit.get("suite_digest"),
        "Started": environment.get("started_at"),
        "Took": f"{footer['elapsed_s']:.1f} s" if "elapsed_s" in footer else None,
        "Of that": ", ".join(f"{what} {seconds:.1f} s" for what, seconds in spent.items()),
        "Machine": environment.get("platform"),
        "Processors": environment.get("cpu_count"),
        "Walls": " ".join((*stood(walls), *missing(walls))),
        "Python": environment.get("python"),
        "Packages": ", ".join(f"{name} {version}" for name, version in packages.items() if version),
        "Settings": ", ".join(
            f"{name}: {_flat(value)}"
            for name, value in settings.items()
            if name != "narrowed" and value not in (None, [], {})
        ),
        "Tool calls": ", ".join(f"{role} {calls}" for role, calls in footer.get("tool_calls", {}).items()),
    }
    return [(name, str(value)) for name, value in known.items() if value]


def _flat(value: object) -> str:
    if isinstance(value, Mapping):
        return " ".join(f"{name} {inner}" for name, inner in value.items())
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _passed(item: Item) -> str:
    good, planned = tally([item])
    return _count(good, planned) + (", failed beside the repetitions" if control_failed(item, good) else "")


def _count(good: int, total: int) -> str:
    return count(good, total, NONE)


def _number(value: float | None) -> str:
    return number(value, NONE)


def _interval(bounds: tuple[float, float] | None) -> str:
    return interval(bounds, NONE, " to ")
