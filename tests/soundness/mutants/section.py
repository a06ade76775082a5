"""``python -m tests.soundness.mutants.section``: writes the section on defects in ``docs/soundness.md`` anew.

A test compares it with the declarations.
"""

from __future__ import annotations

from pytest_otmcp.reference_adapters.defects.defect import catalogue_id, number
from pytest_otmcp.reference_adapters.defects.not_yet import GROUPS, NOT_YET, TOTAL
from pytest_otmcp.reference_adapters.defects.table import DEFECTS

from tests.soundness.document import DOCUMENT, with_section

__all__ = ["section"]


def section() -> str:
    """Return the tables of the defects that are noticed and of those that are not."""
    noticed = {defect.catalogue_id for defect in DEFECTS.values()}
    missing = {catalogue_id(identifier) for group in NOT_YET.values() for identifier in group}
    warned = [one.id for one in DEFECTS.values() if not one.items]
    lines = [
        f"**Noticed: {len(noticed)} of {TOTAL} defects**, at {len(DEFECTS)} adapters; {len(warned)} of these break what the catalogue only "
        f"recommends: they cost a warning and fail no item ({' '.join(warned)}). Of {len(noticed & missing)} defects another variant is "
        "not noticed yet.",
        "",
        "| defect | what the adapter does | items that fail | requirements cited |",
        "|---|---|---|---|",
        *(f"| {one.id} | {one.sentence} | {one.items} | {one.requirements} |" for one in DEFECTS.values()),
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
    DOCUMENT.write_text(with_section("defects", section()), encoding="utf-8")
