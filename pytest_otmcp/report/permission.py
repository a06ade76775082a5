"""What a level permits, in a sentence, and what a run permits: nothing without a level. Pure."""

from __future__ import annotations

from ..protocols.registry import protocols
from ..suite.levels import standings
from ..suite.requirements import Level, catalogue
from . import Run

__all__ = ["permission", "permitted"]

_NONE = "No permission to connect follows"


def permitted(level: Level) -> str:
    """Return what a level permits, which is what it and every level below it says, as the end of a sentence about an adapter."""
    *before, last = [each.meaning for each in Level if each.rank <= level.rank]
    return f"{', '.join(before)}{', and ' if before else ''}{last}"


def permission(run: Run, *, certified: bool = False) -> str:
    """Say what may be connected, and what for.

    Args:
        certified: the run has earned a certificate, which alone permits.
    """
    found = standings(catalogue(), run["items"], run["subject"]["adapters"])
    by_level: dict[Level, list[str]] = {}
    for one in found:
        if one.level is not None:
            by_level.setdefault(one.level, []).append(protocols()[one.protocol].name)
    if not by_level:
        return f"{_NONE}."
    told = [f"{', '.join(names)}: {permitted(level)}." for level, names in by_level.items()]
    told += [f"{protocols()[one.protocol].name}: {_NONE.lower()}." for one in found if one.level is None]
    return " ".join([*told, *([] if certified else ["This report is no certificate: ask for one before you connect."])])
