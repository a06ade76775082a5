"""What a level permits, in a sentence, and what a run permits: nothing without a level, nothing that failed, and no tool that was not
judged. Pure."""

from __future__ import annotations

from collections.abc import Collection

from ..core.text import counted
from ..core.verdict import Verdict
from ..protocols.registry import protocols
from ..record.tool_calls import judged, never_called
from ..suite.levels import standings
from ..suite.requirements import Level, catalogue
from . import Run

__all__ = ["covered", "not_covered", "permission", "permitted"]

_NAMED = 20
"""Tools that a sentence names."""
_NONE = "No permission to connect follows"


def permitted(level: Level) -> str:
    """Return what a level permits, which is what it and every level below it says, as the end of a sentence about an adapter."""
    *before, last = [each.meaning for each in Level if each.rank <= level.rank]
    return f"{', '.join(before)}{', and ' if before else ''}{last}"


def not_covered(tools: Collection[str]) -> str:
    """Say that a level is not about tools whose answers were never judged; nothing without any."""
    if not tools:
        return ""
    return f"Not covered: {counted(len(tools), 'tool')} that no item judged; give an assistant none of them"


def covered(tools: Collection[str]) -> str:
    """Name the tools that a level is about."""
    shown = [*tools][:_NAMED]
    more = f" and {len(tools) - len(shown)} more" if len(tools) > len(shown) else ""
    return f"It covers {counted(len(tools), 'tool')}: {', '.join(shown)}{more}" if tools else ""


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
    if run["footer"].get("verdict") != Verdict.CONFORMANT:
        return f"{_NONE} from a run that is not conformant, whichever level's rules were kept."
    told = [f"{', '.join(names)}: {permitted(level)}." for level, names in by_level.items()]
    told += [f"{protocols()[one.protocol].name}: {_NONE.lower()}." for one in found if one.level is None]
    adapters = run["subject"]["adapters"].values()
    about = covered([tool for facts in adapters for tool in judged(facts)])
    without = not_covered([tool for facts in adapters for tool in never_called(facts)])
    told += [f"{sentence}." for sentence in (about, without) if sentence]
    return " ".join([*told, *([] if certified else ["This report is no certificate: ask for one before you connect."])])
