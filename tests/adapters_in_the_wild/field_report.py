"""``python -m tests.adapters_in_the_wild.field_report``: writes the generated sections of ``docs/field-report.md`` anew.

``… field_report run NAME`` measures a row again before that: it installs the adapter, runs the suite and keeps the record;
``run --all`` does so for every row.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from tests.soundness.document import with_section

from .examples import NAMES, NotInstalled
from .page import details, side_by_side, table
from .records import REPS, Unusable, measure, recorded, stored

__all__ = ["DOCUMENT", "page"]

DOCUMENT = Path(__file__).parents[2] / "docs" / "field-report.md"


def page() -> str:
    """Return the document with its sections made from the records."""
    runs = {name: stored(name) for name in recorded()}
    text = DOCUMENT.read_text(encoding="utf-8")
    for name, section in (("table", table(runs, NAMES)), ("details", details(runs)), ("paper", side_by_side(runs))):
        text = with_section(name, section, text)
    return text


def main() -> int:
    """Read the command line and do what it says."""
    parser = argparse.ArgumentParser(prog="python -m tests.adapters_in_the_wild.field_report", description=__doc__)
    commands = parser.add_subparsers(dest="command")
    run = commands.add_parser("run", help="measure rows again, then write the page")
    run.add_argument("names", nargs="*", metavar="NAME", choices=[[], *NAMES], help="; ".join(NAMES))
    run.add_argument("--all", action="store_true", help="every row")
    run.add_argument("--reps", type=int, default=REPS, help=f"repetitions (default {REPS})")
    args = parser.parse_args()
    failed = False
    for name in (NAMES if args.all else args.names) if args.command else []:
        began = time.monotonic()
        try:
            measure(name, args.reps)
            print(f"{name}: {time.monotonic() - began:.0f} s", flush=True)
        except (NotInstalled, Unusable) as reason:
            failed = True
            print(f"{reason}; its row stays as it is", file=sys.stderr, flush=True)
    DOCUMENT.write_text(page(), encoding="utf-8")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
