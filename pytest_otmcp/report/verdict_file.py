"""The verdict of a run for a program: ``verdict.json``. Pure but for the writing.

The exit code alone does not tell an adapter that lies from one that does not start, or from a run that was narrowed; this does.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..core.walls import missing
from ..record.tool_calls import never_called
from ..record.warnings import warnings
from ..suite.levels import standings
from ..suite.requirements import catalogue
from ..suite.spoken import spoken, tell
from . import Run
from .baseline import Baseline, changes
from .causes import causes
from .limits import partial
from .overview import deviations

__all__ = ["properties", "verdict", "write_verdict"]

SCHEMA = "otmcp-verdict/1"


def verdict(run: Run, baseline: Baseline | None = None) -> dict[str, Any]:
    """Return what a program reads.

    ``partial`` tells whether a pass says less than it could; ``suites``, ``reps`` (N) and ``walls_missing`` may say why. ``items`` counts those about each protocol that the subject speaks. ``levels`` has the level of each protocol, None for none; it is empty without the requirement suite. ``causes`` are the rules that are
    broken, in the order of the suite, each with the code of its first finding (``cannot_start``, ``wrong_value``, …) and the items that it
    touches. ``narrowed`` says what took something away from the suite, ``never_called`` which tools each adapter lists that the run never called. ``since`` says what has changed since the baseline, None without one.
    """
    return {
        "schema": SCHEMA,
        "verdict": run["footer"].get("verdict", "INCOMPLETE"),
        "partial": partial(run),
        "started_at": run["environment"].get("started_at"),
        "suites": list(run["settings"].get("suites", ())),
        "reps": run["settings"].get("reps"),
        "challenge": run["settings"].get("challenge"),
        "walls_missing": missing(run["environment"].get("walls", {})),
        "complete": run["footer"]["complete"],
        "reason": run["footer"].get("reason"),
        "subject": {key: run["subject"][key] for key in ("name", "version", "digest")},
        "kit": {key: run["kit"][key] for key in ("name", "version", "digest", "suite_digest")},
        "catalogue": catalogue().version,
        "items": {family: asdict(count) for family, count in spoken(run).items()},
        "levels": _levels(run),
        "causes": [
            {
                "rule": cause.rule,
                "protocol": cause.family,
                "code": cause.first["code"],
                "message": cause.first["message"],
                "due": cause.due,
                "items": list(cause.items),
            }
            for cause in causes(run)
        ],
        "warnings": len(warnings(run["items"])),
        "narrowed": list(run["settings"].get("narrowed", ())),
        "never_called": {
            key: tools for key, facts in run["subject"]["adapters"].items() if (tools := never_called(facts))
        },
        "deviations": [asdict(one) for one in deviations(run)],
        "since": None if baseline is None else _since(baseline, run),
    }


def _since(baseline: Baseline, run: Run) -> dict[str, Any]:
    found = {
        what.replace(" ", "_"): [{"rule": rule, "protocol": family} for rule, family in names]
        for what, names in changes(baseline, run).items()
    }
    return {"subject": baseline.subject, "suite_digest": baseline.suite, **found}


def properties(run: Run) -> dict[str, str]:
    """Return what a JUnit file says about a run as a whole."""
    told = {
        "otmcp_verdict": run["footer"].get("verdict", "INCOMPLETE"),
        "otmcp_items": tell(spoken(run)),
        "otmcp_catalogue": catalogue().version,
    }
    known = {f"otmcp_deviation_{one.item}": f"until {one.expires}: {one.state}" for one in deviations(run)}
    return told | known | {f"otmcp_level_{protocol}": level or "none" for protocol, level in _levels(run).items()}


def _levels(run: Run) -> dict[str, str | None]:
    """Return the level of each protocol; nothing of a run without the requirement suite, which alone awards one."""
    found = standings(catalogue(), run["items"], dict(sorted(run["subject"]["adapters"].items())))
    return {one.protocol: None if one.level is None else one.level.value for one in found}


def write_verdict(run: Run, path: Path, baseline: Baseline | None = None) -> None:
    """Write the verdict of a run to ``path``, in ASCII: no word of an adapter can move the cursor of a terminal."""
    path.write_text(json.dumps(verdict(run, baseline), indent=1) + "\n", encoding="ascii", newline="\n")
