"""Documents with tables that are made from declarations or records: each stands between two markers, the rest is written by
hand. ``docs/soundness.md`` is one of them.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["DOCUMENT", "with_section"]

DOCUMENT = Path(__file__).parents[2] / "docs" / "soundness.md"


def with_section(name: str, section: str, document: str | None = None) -> str:
    """Return a document with this text between the markers of this name.

    Args:
        document: its text as it was; without it that of ``docs/soundness.md``.

    Raises:
        ValueError: the document has no such markers.
    """
    document = DOCUMENT.read_text(encoding="utf-8") if document is None else document
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
    at = document.index(begin) + len(begin)
    return document[:at] + section + document[document.index(end, at) :]
