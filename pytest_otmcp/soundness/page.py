"""The page of all defects: ``otmcp docs defects`` prints it."""

from __future__ import annotations

from .defect import Declared, declared

__all__ = ["page"]


def page(known: Declared) -> str:
    """Return the page of the defects that are noticed and of those that are not, as Markdown."""
    noticed = {one.catalogue_id for one in known.defects}
    variants = noticed & {one.catalogue_id for one in known.unnoticed}
    warned = [one.id for one in known.defects if not one.items]
    lines = [
        "# The defects",
        "",
        "`otmcp docs defects` builds this page from the declarations of the defects. `otmcp self-check MU-13` starts the adapter that "
        "has one, and shows what notices it.",
        "",
        f"**Noticed: {len(noticed)} of {known.total} defects**, at {len(known.defects)} adapters. {len(warned)} of these break what the "
        f"catalogue only recommends: they cost a warning and fail no item ({' '.join(warned)}). Of {len(variants)} defects another "
        "variant is not noticed yet.",
        "",
        "| defect | what the adapter does | items that fail | requirements cited |",
        "|---|---|---|---|",
        *(
            f"| {one.id} | {one.sentence} | {' '.join(one.items)} | {' '.join(one.requirements)} |"
            for one in known.defects
        ),
        "",
        "## Not noticed yet",
        "",
        "| defect | what the adapter does | what it takes to notice it |",
        "|---|---|---|",
        *(f"| {one.id} | {one.sentence} | {one.reason} |" for one in known.unnoticed),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(declared()), end="")
