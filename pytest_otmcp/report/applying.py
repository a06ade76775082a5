"""One sentence about the items that do not apply to a subject, however many they are. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..core.verdict import INEXPRESSIBLE, UNBOUND, Verdict
from ..protocols.registry import protocols
from ..suite.spoken import of_spoken
from ..trial.applicability import NOT_CLAIMED
from . import Run, applies
from .text import clipped

__all__ = ["not_applying", "nothing_asked", "without_values"]

_LETTERS = 120
"""Letters of a vendor's reason."""


def nothing_asked(run: Run) -> str:
    """Say what to bind where the subject file claims nothing that could be asked; empty where an item applies."""
    if run["footer"].get("verdict") != Verdict.INDETERMINATE or any(map(applies, run["items"])):
        return ""
    known = protocols()
    asked = [(key, known[key].exercise) for key in run["subject"]["adapters"] if key in known]
    names = [f"{key}.{name}" for key, does in asked if does is not None for name in (does.reading, does.writing)]
    bind = f"bind operations such as {' and '.join(names)}" if names else "describe an adapter"
    return f"nothing could be asked: {bind} in the subject file; otmcp init proposes bindings"


def not_applying(run: Run, *, named: bool = True) -> str:
    """Say which items about the subject's protocols do not apply, and why; empty when all do.

    Args:
        named: name each item; else the reasons alone are told, those of most items first, with the number of items.
    """
    reasons: dict[str, list[str]] = {}
    for item in of_spoken(run)["items"]:
        if not applies(item):
            reasons.setdefault(without_values(item["reason"] or "not claimed"), []).append(item["id"])
    if not reasons:
        return ""
    count = sum(map(len, reasons.values()))
    told = (
        [f"{' '.join(ids)}: {clipped(reason, _LETTERS)}" for reason, ids in reasons.items()]
        if named
        else _folded(reasons)
    )
    return f"{count} {'does' if count == 1 else 'do'} not apply: {'; '.join(told)}"


def without_values(reason: str) -> str:
    """Return a reason without the values that an item has drawn, which tell nobody anything."""
    if not reason.startswith((*INEXPRESSIBLE, UNBOUND)):
        return reason
    return f"{reason.partition(' with ')[0]} with the values asked for"


def _folded(reasons: Mapping[str, Sequence[str]]) -> list[str]:
    """Tell each reason once, with the facets that are not claimed for it."""
    whys: dict[str, dict[str, int]] = {}
    for reason, ids in reasons.items():
        facet, claimed, why = reason.rpartition(NOT_CLAIMED)
        whys.setdefault(why, {})[facet if claimed else ""] = len(ids)
    ordered = sorted(whys.items(), key=lambda entry: -sum(entry[1].values()))
    return [_told(clipped(why, _LETTERS), facets) for why, facets in ordered]


def _told(why: str, facets: Mapping[str, int]) -> str:
    if "" in facets:
        return f"{why} ({sum(facets.values())})"
    return f"{', '.join(f'{name} ({count})' for name, count in facets.items())}: {why}"
