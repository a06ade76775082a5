"""One sentence about the items that do not apply to a subject, however many they are. Pure."""

from __future__ import annotations

from ..core.verdict import Verdict
from ..protocols.registry import protocols
from ..trial.applicability import NO_ADAPTER
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
    """Say how many items do not apply, and why; empty when all do.

    Items without an adapter are counted, those that the subject does not claim are named with its reason.
    """
    unclaimed = [item for item in run["items"] if not applies(item)]
    missing: dict[str, int] = {}
    others: dict[str, list[str]] = {}
    for item in unclaimed:
        reason = item["reason"] or "not claimed"
        if reason.startswith(NO_ADAPTER):
            name = reason.removeprefix(NO_ADAPTER)
            missing[name] = missing.get(name, 0) + 1
        else:
            others.setdefault(reason, []).append(item["id"])
    whys = [f"no adapter for {', '.join(missing)} ({sum(missing.values())})"] if missing else []
    whys += [f"{' '.join(ids)}: {clipped(reason, _LETTERS)}" for reason, ids in others.items()]
    if not whys:
        return ""
    return f"{len(unclaimed)} {'does' if len(unclaimed) == 1 else 'do'} not apply: {'; '.join(whys)}"
