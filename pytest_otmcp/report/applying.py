"""One sentence about the items that do not apply to a subject, however many they are. Pure."""

from __future__ import annotations

from ..trial.applicability import NO_ADAPTER
from . import Run, applies
from .text import clipped

__all__ = ["not_applying"]

_LETTERS = 120
"""Letters of a vendor's reason."""


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
