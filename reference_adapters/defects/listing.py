"""The declarations of the defects as plain data, for programs that start these adapters and import nothing of them."""

from __future__ import annotations

from typing import Any

from .not_yet import GROUPS, NOT_YET, TOTAL
from .table import DEFECTS, SAMPLE

__all__ = ["listing"]


def listing() -> dict[str, Any]:
    """Return what ``--list`` prints: the defects in the order of the catalogue, and those that nothing notices yet."""
    return {
        "total": TOTAL,
        "defects": [
            {
                "id": one.id,
                "protocol": one.protocol,
                "sentence": one.sentence,
                "items": one.items.split(),
                "requirements": one.requirements.split(),
                "areas": one.areas.split(),
                "recovers": one.recovers,
                "waits": one.waits,
                "cold": one.cold,
                "sample": one.id in SAMPLE,
                "named": one.named,
            }
            for one in DEFECTS.values()
        ],
        "not_yet": [
            {"id": identifier, "sentence": sentence, "reason": GROUPS[group]}
            for group, defects in NOT_YET.items()
            for identifier, sentence in defects.items()
        ],
    }
