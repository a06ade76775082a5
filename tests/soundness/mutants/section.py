"""``python -m tests.soundness.mutants.section``: writes the section on defects in ``docs/soundness.md`` anew.

The section stands between two markers; the rest of the document is written by hand.
"""

from __future__ import annotations

from pathlib import Path

from .mutant import catalogue_id, number
from .not_yet import GROUPS, NOT_YET, TOTAL
from .table import MUTANTS

__all__ = ["DOCUMENT", "renewed"]

DOCUMENT = Path(__file__).parents[3] / "docs" / "soundness.md"
_BEGIN, _END = "<!-- defects: begin -->\n", "<!-- defects: end -->\n"


def renewed(document: str) -> str:
    """Return the document with the section as the declarations have it now."""
    before, _, rest = document.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    return f"{before}{_BEGIN}{_section()}{_END}{after}"


def _section() -> str:
    noticed = {mutant.catalogue_id for mutant in MUTANTS.values()}
    missing = {catalogue_id(identifier) for group in NOT_YET.values() for identifier in group}
    lines = [
        f"**Noticed: {len(noticed)} of {TOTAL} defects**, by {len(MUTANTS)} adapters; of {len(noticed & missing)} "
        "of them another variant is not noticed yet.",
        "",
        "| defect | what the adapter does | items that fail | requirements cited |",
        "|---|---|---|---|",
        *(f"| {one.id} | {one.sentence} | {one.items} | {one.requirements} |" for one in MUTANTS.values()),
        "",
        "Not noticed yet:",
        "",
        "| defect | what the adapter does | group |",
        "|---|---|---|",
        *(f"| {identifier} | {sentence} | {group} |" for identifier, sentence, group in _not_yet()),
        "",
        "Groups, by what it takes to notice a defect: "
        + "; ".join(f"{key}: {words}" for key, words in GROUPS.items())
        + ".",
    ]
    return "\n".join(lines) + "\n"


def _not_yet() -> list[tuple[str, str, str]]:
    rows = [(identifier, text, group) for group, defects in NOT_YET.items() for identifier, text in defects.items()]
    return sorted(rows, key=lambda row: number(row[0]))


if __name__ == "__main__":
    DOCUMENT.write_text(renewed(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
