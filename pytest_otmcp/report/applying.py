"""One sentence about the items that do not apply to a subject, however many they are. Pure."""

from __future__ import annotations

from ..core.verdict import Verdict
from ..protocols.registry import protocols
from ..suite.spoken import of_spoken
from . import Run, applies
from .text import clipped

__all__ = ["not_applying", "nothing_asked"]

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


def not_applying(run: Run) -> str:
    """Say which items about the subject's protocols do not apply, and why; empty when all do."""
    reasons: dict[str, list[str]] = {}
    for item in of_spoken(run)["items"]:
        if not applies(item):
            reasons.setdefault(item["reason"] or "not claimed", []).append(item["id"])
    if not reasons:
        return ""
    count = sum(map(len, reasons.values()))
    whys = "; ".join(f"{' '.join(ids)}: {clipped(reason, _LETTERS)}" for reason, ids in reasons.items())
    return f"{count} {'does' if count == 1 else 'do'} not apply: {whys}"
