"""The sentence for a name that does not exist. Pure."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = ["describe_unknown"]


def describe_unknown(what: str, name: str, known: Iterable[str]) -> str:
    """Write the sentence for a name that does not exist: with the nearest one that does, or with all of them."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, 1)
    return f"there is no {what} {name!r}; " + (
        f"did you mean {near[0]!r}?" if near else f"known are {', '.join(names)}"
    )
