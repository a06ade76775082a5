"""Lines for a terminal: wrapped between words, and harmless whatever an adapter wrote. Pure."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator

from ..core.text import MARK, harmless
from . import Item

__all__ = ["Line", "failed", "wrapped"]

Line = tuple[str, str]
"""A line and its style: ``ok``, ``bad``, ``head`` or ``plain``."""

_UNIT = re.compile(r"(?<=\d) (?=(?:%|s|ms)(?!\w))")
_JOINT = "\N{NO-BREAK SPACE}"


def wrapped(text: str, width: int, indent: str) -> Iterator[str]:
    """Yield the lines of a text, none wider than ``width`` unless a word is; lines after the first begin with ``indent``.

    The lines of a text, such as the last lines of an adapter's stderr, stay lines, but are marked, unlike the kit's own.
    A number and its unit stay on one line.
    """
    for index, line in enumerate(text.splitlines() or [""]):
        mark = f"{indent}{MARK}" if index else indent
        first = mark if index else ""
        joined = _UNIT.sub(_JOINT, harmless(line))
        lines = textwrap.wrap(joined, width, initial_indent=first, subsequent_indent=mark, break_on_hyphens=False)
        yield from (part.replace(_JOINT, " ") for part in lines or [""])


def failed(item: Item) -> bool:
    """Tell whether an item applies and did not pass."""
    return item["status"] not in ("PASS", "NOT_APPLICABLE")
