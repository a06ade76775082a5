"""Journal entries by hand: what every witness writes beside the fields that a test is about."""

from __future__ import annotations

from typing import Any

__all__ = ["Entry", "journal"]

Entry = dict[str, Any]


def journal(*entries: Entry, **common: Any) -> list[Entry]:
    """The entries with the contract's fields; an answer names its request by ``to``, a number from the front."""
    contract = {"connection": 1, "origin": "client", "request": False, "state_changing": False, "answers": None}
    return [{"seq": seq, "t_ns": seq, **contract, **common, **entry} for seq, entry in enumerate(entries)]
