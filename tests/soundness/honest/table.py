"""The section "Honest adapters" of docs/soundness.md: ``python -m tests.soundness.honest.table`` writes it anew."""

from __future__ import annotations

from pathlib import Path

from .choice import Choice
from .zoo import ZOO

__all__ = ["DOCUMENT", "section", "written"]

DOCUMENT = Path(__file__).parents[3] / "docs" / "soundness.md"
_BEGIN, _END = "<!-- honest: begin -->\n", "<!-- honest: end -->"


def section() -> str:
    """Return the table of the zoo's declarations."""
    warned = sum(bool(choice.warnings) for choice in ZOO.values())
    lines = [
        f"**Honest adapters accused: 0 of {len(ZOO)}.** {warned} of them get a warning.",
        "",
        "| adapter | what it does otherwise | why it may | warning |",
        "|---|---|---|---|",
        *(_row(name, choice) for name, choice in ZOO.items()),
        "",
    ]
    return "\n".join(lines)


def _row(name: str, choice: Choice) -> str:
    warnings = ", ".join(f"{requirement} `{code}`" for requirement, code in sorted(choice.warnings))
    return f"| `{name}` | {choice.sentence} | {choice.rule} | {warnings} |"


def written(document: str) -> str:
    """Return the document with the table in its place."""
    before, begin, rest = document.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    assert begin, "the document has no place for the table"
    assert end, "the table's place has no end"
    return before + begin + section() + end + after


if __name__ == "__main__":
    DOCUMENT.write_text(written(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
