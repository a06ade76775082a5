"""The verdict of a run for a program: ``verdict.json``. Pure but for the writing.

The exit code alone does not tell an adapter that lies from one that does not start, or from a run that was narrowed; this does.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..core.matrix import REQUIREMENTS
from ..record.warnings import warnings
from ..suite.levels import standings
from ..suite.requirements import catalogue
from . import Run, applies
from .causes import causes

__all__ = ["levels", "verdict", "write_verdict"]

SCHEMA = "otmcp-verdict/1"


def verdict(run: Run) -> dict[str, Any]:
    """Return what a program reads.

    ``levels`` has the level of each protocol, None for none; it is empty without the requirement suite. ``causes`` are the rules that are
    broken, in the order of the suite, each with the code of its first finding (``cannot_start``, ``wrong_value``, …) and the items that it
    touches. ``narrowed`` says what took something away from the suite.
    """
    applying = [item for item in run["items"] if applies(item)]
    return {
        "schema": SCHEMA,
        "verdict": run["footer"].get("verdict", "INCOMPLETE"),
        "complete": run["footer"]["complete"],
        "reason": run["footer"].get("reason"),
        "subject": {key: run["subject"][key] for key in ("name", "version", "digest")},
        "kit": {key: run["kit"][key] for key in ("name", "version", "digest", "suite_digest")},
        "items": {"passed": sum(item["status"] == "PASS" for item in applying), "applied": len(applying)},
        "levels": levels(run),
        "causes": [
            {
                "rule": cause.rule,
                "protocol": cause.family,
                "code": cause.first["code"],
                "message": cause.first["message"],
                "items": list(cause.items),
            }
            for cause in causes(run)
        ],
        "warnings": len(warnings(run["items"])),
        "narrowed": list(run["settings"].get("narrowed", ())),
    }


def levels(run: Run) -> dict[str, str | None]:
    """Return the level of each protocol; nothing of a run without the requirement suite, which alone awards one."""
    if REQUIREMENTS not in run["settings"].get("suites", ()):
        return {}
    found = standings(catalogue(), run["items"], sorted(run["subject"]["adapters"]))
    return {one.protocol: None if one.level is None else one.level.value for one in found}


def write_verdict(run: Run, path: Path) -> None:
    """Write the verdict of a run to ``path``, in ASCII: no word of an adapter can move the cursor of a terminal."""
    path.write_text(json.dumps(verdict(run), indent=1) + "\n", encoding="ascii", newline="\n")
