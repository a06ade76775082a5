"""``otmcp report``: every report of a run record, written again without measuring; several records are compared."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import KitError, UsageError
from . import Refusal

if TYPE_CHECKING:
    from ..record.schema import Run

__all__ = ["add_parser", "run"]

_SHOWN = 8
"""Items with a change that the terminal names."""


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
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the reports, also those of a run that is not complete.

    Raises:
        UsageError: there is no such file.
        Refusal: the file is no record that can be believed.
        KitError: a report could not be written; the others were.
    """
    runs = [_record(path) for path in args.records]
    if len(runs) > 1:
        return _compare(runs, args.out if args.out is not None else Path())
    from ..report.render import write_all

    (path,) = args.records
    directory: Path = args.out if args.out is not None else path.parent
    if failed := write_all(runs[0], directory):
        raise KitError("; ".join(f"{directory / name} was not written: {reason}" for name, reason in failed.items()))
    print(f"the reports of {path} are in {directory}")
    return 0


def _record(path: Path) -> Run:
    from ..record.condensed import condensed
    from ..record.reader import RecordError, open_record

    if not path.is_file():
        raise UsageError(f"{path}: there is no such file")
    try:
        with open_record(path, allow_incomplete=True) as stored:
            return condensed(stored)
    except RecordError as reason:
        raise Refusal(f"no reports: {reason}") from None


def _compare(runs: list[Run], directory: Path) -> int:
    from ..core.text import counted, printable
    from ..report.comparison_pages import NAMES, write_comparison

    comparison = write_comparison(runs, directory)
    width = max(len(printable(column.name)) for column in comparison.columns)
    for column in comparison.columns:
        print(f"{printable(column.name):<{width}}  {column.verdict.text}, {column.passed} runs passed")
    changes, partial = comparison.changes, comparison.partial
    shown = [*changes[:_SHOWN], *(["..."] if changes[_SHOWN:] else [])]
    print(f"{counted(len(changes), 'item')} went differently{': ' if changes else ''}{'; '.join(shown)}")
    if partial:
        print(f"{counted(partial, 'item')} {'was' if partial == 1 else 'were'} judged in some of the runs only")
    print(f"{' and '.join(str(directory / name) for name in NAMES)} have the matrix")
    return 0
