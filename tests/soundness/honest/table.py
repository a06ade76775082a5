"""The page of the honest adapters: ``otmcp docs honest-adapters`` prints it in a checkout."""

from __future__ import annotations

from .choice import Choice
from .zoo import ZOO

__all__ = ["page"]


def page() -> str:
    """Return the page of the zoo's declarations, as Markdown."""
    warned = sum(bool(choice.warnings | choice.checked_warnings) for choice in ZOO.values())
    lines = [
        "# Honest adapters",
        "",
        "`otmcp docs honest-adapters` builds this page from the declarations of the tests. Each adapter is a reference adapter that makes "
        "one other choice, which is legal.",
        "",
        f"**Honest adapters accused: 0 of {len(ZOO)}.** {warned} of them get a warning.",
        "",
        "| adapter | what it does otherwise | why it may | warning |",
        "|---|---|---|---|",
        *(_row(name, choice) for name, choice in ZOO.items()),
    ]
    return "\n".join(lines) + "\n"


def _row(name: str, choice: Choice) -> str:
    warnings = ", ".join(
        f"{requirement} `{code}`" for requirement, code in sorted(choice.warnings | choice.checked_warnings)
    )
    return f"| `{name}` | {choice.sentence} | {choice.rule} | {warnings} |"


if __name__ == "__main__":
    print(page(), end="")
