"""The limits of a run, in sentences for the engineer who has to decide upon it. Pure."""

from __future__ import annotations

from ..core.matrix import BENCHMARK, REQUIREMENTS
from ..core.statistics import lower_bound
from ..core.text import counted
from ..core.verdict import Verdict
from ..core.walls import missing as missing_walls
from ..protocols.external import used
from ..protocols.registry import protocols
from ..record.tool_calls import never_called
from ..suite.spoken import of_spoken
from . import Run, timing_valid
from .applying import not_applying
from .capabilities import Grade, earned
from .text import at_least, clipped

__all__ = ["narrowed", "partial", "unknown_tools"]

_LESS = (Grade.NOT_CLAIMED, Grade.NOT_ASKED, Grade.UNDECIDED)
_FULL = 30
"""Repetitions of the whole matrix."""
_LETTERS, _MOST_NAMED = 60, 20
"""Letters of a tool's name, and tools that a sentence names: an adapter may list thousands."""


def narrowed(run: Run) -> list[str]:
    """Return every reason why a run says less than a full run of its kind; empty when there is none."""
    settings, footer = run["settings"], run["footer"]
    reasons = []
    if not footer["complete"]:
        reasons.append(f"The run is not complete: {footer.get('reason')}.")
    missing = [suite for suite in BENCHMARK if suite not in settings.get("suites", BENCHMARK)]
    if missing and "devices" not in settings:
        reasons.append(f"These suites were left out: {', '.join(missing)}.")
    # Limits that an option of the kit sets have their own sentences in this function.
    noted = [sentence for sentence in settings.get("narrowed", ()) if "(--otmcp-" not in sentence]
    reasons += [f"{sentence[:1].upper()}{sentence[1:]}." for sentence in noted]
    reasons += [f"{sentence}." for sentence in settings.get("not_measured", {}).values()]
    reps = settings.get("reps", _FULL)
    benchmark = {*BENCHMARK} & {*settings.get("suites", BENCHMARK)}
    if benchmark and reps < _FULL and (bound := lower_bound(reps, reps)) is not None:
        reasons.append(
            f"With N = {reps} instead of {_FULL}, an item that passes every time is shown to pass at least "
            f"{at_least(bound, '')} of the time, not more."
        )
    reasons += [f"{sentence}." for sentence in unknown_tools(run)]
    if told := not_applying(run):
        reasons.append(f"{told}.")
    if settings.get("time_scale", 1.0) != 1.0:
        reasons.append(f"Deadlines and windows were multiplied by {settings['time_scale']}.")
    if settings.get("era", "auto") != "auto":
        reasons.append(f"The session was held in the {settings['era']} era of the Model Context Protocol only.")
    for key, device, url in used(settings):
        witnessed = "the kit recorded what passed between"
        if key in settings.get("devices", {}):
            witnessed += " and read it by a client of its own: a field record, which has no journal of the device, and shows no level"
        reasons.append(f"The {device.noun} was a foreign one, {url}; {witnessed}.")
    if not timing_valid(run):
        reasons.append("Items ran in parallel: latencies would measure the neighbours too, and are withheld.")
    return reasons


def unknown_tools(run: Run) -> list[str]:
    """Return a sentence for each adapter that lists tools which the run never called, but to see whether they write."""
    told = {key: never_called(facts) for key, facts in run["subject"]["adapters"].items()}
    return [
        f"The {protocols()[key].name} adapter lists {counted(len(tools), 'tool')} whose answers this run says nothing about: "
        f"{', '.join(clipped(tool, _LETTERS) for tool in tools[:_MOST_NAMED])}"
        + (f" and {len(tools) - _MOST_NAMED} more" if len(tools) > _MOST_NAMED else "")
        for key, tools in told.items()
        if tools
    ]


def partial(run: Run) -> bool:
    """Tell whether a run passed and says less than it could: no level, a wall was missing, something narrowed it, or a capability is not shown."""
    if run["footer"].get("verdict") != Verdict.CONFORMANT:
        return False
    run = of_spoken(run)
    grades = [one.grade for _, by_family in earned(run) for one in by_family.values()]
    reasons = len(narrowed(run)) > bool(not_applying(run))
    no_level = REQUIREMENTS not in run["settings"].get("suites", BENCHMARK)
    return (
        no_level
        or reasons
        or bool(missing_walls(run["environment"].get("walls", {})))
        or any(grade in _LESS for grade in grades)
    )
