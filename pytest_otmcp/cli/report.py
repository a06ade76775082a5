"""``otmcp report``: every report of a run record, written again without measuring; several records are compared.

The records may be an enemy's: they are read, and the reports are made, in a process with bounded memory and time.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..core.text import harmless
from . import add_json, show, show_json

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "report",
        help="make every report from a record again, or compare several",
        description="Make tables, figures and reports from a run record again, without measuring. "
        "Of several records, of adapters or of versions of one, make one matrix with what differs.",
    )
    parser.add_argument("records", metavar="RUN", type=Path, nargs="+", help="a run.json; several are compared")
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="directory to write to (default: that of RUN; for several, the working directory)",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Have the reports written, and say where they are.

    Raises:
        UsageError: there is no such file, or no such directory can be.
        Refusal: a file is no record that can be believed, or a report could not be made of it; the others were.
    """
    from .confined import Bounds, confined
    from .files import LARGEST_RECORD, size

    records: list[Path] = args.records
    bounds = Bounds.of(sum(size(path, LARGEST_RECORD) for path in records))
    given: Path | None = args.out
    directory = given if given is not None else Path() if records[1:] else records[0].parent
    asked = {"records": list(map(str, records)), "directory": str(directory)}
    found = confined("rendering", asked, bounds, " or ".join(asked["records"]) if records[1:] else str(records[0]))
    if args.json:
        show_json(found)
        return 0
    for sentence in found["said"]:
        show(harmless(sentence))
    return 0
