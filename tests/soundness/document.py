"""``docs/soundness.md``, whose tables are made from declarations: each stands between two markers, the rest is written by hand."""

from __future__ import annotations

from pathlib import Path

__all__ = ["DOCUMENT", "with_section"]

DOCUMENT = Path(__file__).parents[2] / "docs" / "soundness.md"


def with_section(name: str, section: str) -> str:
    """Return the document with this text between the markers of this name.

    Raises:
        ValueError: the document has no such markers.
    """
    document = DOCUMENT.read_text(encoding="utf-8")
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
    at = document.index(begin) + len(begin)
    return document[:at] + section + document[document.index(end, at) :]
