"""``otmcp report``: every report of a run record, written again without measuring; several records are compared.

The records may be hostile: they are read, and the reports are made, in a process with bounded memory and time.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..core.site import site
from ..core.text import harmless
from . import add_json, show, show_json

__all__ = ["add_parser", "rendered", "run"]


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
        UsageError: there is no such file, no such directory can be, or the address of the documentation is none.
        Refusal: a file is no record that can be believed, or a report could not be made of it; the others were.
    """
    # A wrong address of the documentation is told before the work.
    site()
    records: list[Path] = args.records
    given: Path | None = args.out
    directory = given if given is not None else Path() if records[1:] else records[0].parent
    found = rendered(records, directory)
    if args.json:
        show_json(found)
        return 0
    for sentence in found["said"]:
        show(harmless(sentence))
    return 0


def rendered(records: Sequence[Path], directory: Path) -> dict[str, Any]:
    """Have the reports of a record, or the comparison of several, written below a directory; return what there is to say as ``said``.

    Raises:
        UsageError, Refusal: those of :func:`run`.
    """
    from .confined import Bounds, confined
    from .files import LARGEST_RECORD, size

    bounds = Bounds.of(sum(size(path, LARGEST_RECORD) for path in records))
    asked = {"records": list(map(str, records)), "directory": str(directory)}
    return confined("rendering", asked, bounds, " or ".join(asked["records"]))
