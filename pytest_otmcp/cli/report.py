"""``otmcp report``: every report of a run record, written again without measuring."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..core.errors import KitError, UsageError
from . import Refusal

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "report",
        help="make every report from a record again",
        description="Make tables, figures and reports from a run record again, without measuring.",
    )
    parser.add_argument("record", metavar="RUN", type=Path, help="a run.json")
    parser.add_argument("--out", metavar="DIR", type=Path, help="directory to write to (default: that of RUN)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the reports, also those of a run that is not complete.

    Raises:
        UsageError: there is no such file.
        Refusal: the file is no record that can be believed.
        KitError: a report could not be written; the others were.
    """
    from ..record.condensed import condensed
    from ..record.reader import RecordError, open_record
    from ..report.render import write_all

    if not args.record.is_file():
        raise UsageError(f"{args.record}: there is no such file")
    try:
        with open_record(args.record, allow_incomplete=True) as stored:
            record = condensed(stored)
    except RecordError as reason:
        raise Refusal(f"no reports: {reason}") from None
    directory: Path = args.out if args.out is not None else args.record.parent
    if failed := write_all(record, directory):
        raise KitError("; ".join(f"{directory / name} was not written: {reason}" for name, reason in failed.items()))
    print(f"the reports of {args.record} are in {directory}")
    return 0
