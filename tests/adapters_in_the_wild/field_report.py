"""``python -m tests.adapters_in_the_wild.field_report``: writes the generated sections of ``docs/field-report.md`` anew, and the page of
each adapter in ``docs/field-report/``.

``… field_report from FLEET`` takes the records of a fleet of ``docs/examples/fleet.toml`` before that; ``… field_report judge [NAME…]``
judges the records' evidence by this kit.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tests.soundness.document import with_section

from .examples import NAMES
from .page import adapter_page, matrix, side_by_side, table
from .records import judge_again, recorded, stored, take

__all__ = ["DOCS", "pages"]

DOCS = Path(__file__).parents[2] / "docs"
_DOCUMENT = "field-report.md"


def pages() -> dict[str, str]:
    """Return the document with its sections, and the pages of the adapters, made from the records; by their path in ``docs/``."""
    runs = {name: stored(name) for name in recorded()}
    text = (DOCS / _DOCUMENT).read_text(encoding="utf-8")
    for name, section in (("table", table(runs, NAMES)), ("matrix", matrix(runs)), ("paper", side_by_side(runs))):
        text = with_section(name, section, text)
    return {_DOCUMENT: text, **{f"field-report/{name}.md": adapter_page(name, run) for name, run in runs.items()}}


def main() -> None:
    """Read the command line and do what it says."""
    parser = argparse.ArgumentParser(prog="python -m tests.adapters_in_the_wild.field_report", description=__doc__)
    commands = parser.add_subparsers(dest="command")
    commands.add_parser("from", help="take the records of a fleet, then write the pages").add_argument(
        "fleet", type=Path
    )
    again = commands.add_parser("judge", help="judge the evidence of the records by this kit, then write the pages")
    again.add_argument("name", nargs="*", default=recorded())
    args = parser.parse_args()
    said = {"from": lambda: take(args.fleet), "judge": lambda: judge_again(args.name)}.get(args.command, tuple)
    for sentence in said():
        print(sentence, flush=True)
    for name, text in pages().items():
        (DOCS / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
