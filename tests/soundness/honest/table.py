"""The section "Honest adapters" of docs/soundness.md: ``python -m tests.soundness.honest.table`` writes it anew."""

from __future__ import annotations

from tests.soundness.document import DOCUMENT, with_section

from .choice import Choice
from .zoo import ZOO

__all__ = ["section"]


def section() -> str:
    """Return the table of the zoo's declarations."""
    warned = sum(bool(choice.warnings | choice.checked_warnings) for choice in ZOO.values())
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
    warnings = ", ".join(
        f"{requirement} `{code}`" for requirement, code in sorted(choice.warnings | choice.checked_warnings)
    )
    return f"| `{name}` | {choice.sentence} | {choice.rule} | {warnings} |"


if __name__ == "__main__":
    DOCUMENT.write_text(with_section("honest", section()), encoding="utf-8")
