"""Comparison of a journal entry with what its recorded bytes say, whatever the protocol. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..core.strict_json import same_json

__all__ = ["difference"]


def difference(entry: Mapping[str, Any], shown: Mapping[str, object], source: str) -> str | None:
    """Say in which member an entry differs from its bytes; None where it does not.

    Args:
        entry: of a journal, or a message within one.
        shown: the members that the bytes show. A member with an empty value may be absent from the entry, or the other way round.
        source: name of the member that holds the bytes.
    """
    for name, value in shown.items():
        stated = entry.get(name)
        if not same_json(stated, value) and not (stated in (None, []) and value in (None, [])):
            return f"says {name} {stated!r}, its {source} says {value!r}"
    return None
