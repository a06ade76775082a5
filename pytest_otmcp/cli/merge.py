"""``otmcp merge``: one matrix of many runs, and what has changed since the last one.

A row of a fleet was judged a second time where it ran; here its record is held against the digest that was noted then, and some
rows, chosen at random, are judged once more. A run that is given by itself is judged here.
"""

from __future__ import annotations

import argparse
import gzip
import os
import random
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.text import counted, harmless
from ..core.verdict import ExitCode
from . import Refusal, show

if TYPE_CHECKING:
    from ..fleet.lines import Line

__all__ = ["add_parser", "merged", "run"]

_AGAIN = 3


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "merge",
        help="put the runs of many adapters and versions into one matrix",
        description="Put the runs of many adapters and versions into one matrix: index.html, fleet.json, changes.md and junit.xml. "
        "The exit code is 1 where something that was conformant broke, else 3 where the kit or a machine failed or a row was not run, else 0.",
    )
    parser.add_argument(
        "runs",
        metavar="RUN",
        type=Path,
        nargs="+",
        help="the folder of a fleet; or that of one run, with its run.json and report",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder to write to (default: that of the fleet, else the working directory)",
    )
    parser.add_argument(
        "--since", metavar="FLEET", type=Path, help="fleet.json of another time: what has changed, and what broke"
    )
    parser.add_argument(
        "--again",
        metavar="N",
        type=_count,
        default=_AGAIN,
        help="rows of fleets to judge once more, chosen at random (default: %(default)s); 0 for none",
    )
    parser.set_defaults(run=run)


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"expected a number from 0 on, found {text!r}")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Merge; see :func:`merged`."""
    from ..fleet.plan import PLAN

    default = args.runs[0] if (args.runs[0] / PLAN).is_file() else Path()
    return merged(args.runs, args.out or default, args.since, again=args.again)


def merged(runs: Sequence[Path], out: Path, since: Path | None, *, again: int = _AGAIN) -> int:
    """Write the matrix of fleets and runs, and return the exit code.

    Raises:
        UsageError: something is no run, or no fleet of this kit.
        Refusal: a record does not hold, is there twice, or was judged by another kit than the others.
    """
    from ..fleet.changes import changes
    from ..fleet.lines import lines, objection
    from ..fleet.outcome import Outcome
    from ..fleet.page import read_lines, write_pages
    from ..fleet.plan import PLAN, read_plan

    before = None if since is None else read_lines(since)
    found: list[Line] = []
    names = []
    for path in runs:
        shown = os.path.relpath(path, out)
        if (path / PLAN).is_file():
            plan = read_plan(path)
            names.append(plan.name)
            these = list(lines(plan, path, "" if shown == "." else f"{shown}/"))
            judged = [line for line in these if line.record is not None]
            for line in random.sample(judged, min(again, len(judged))):
                _judge_again(line, path)
            found += these
        else:
            found.append(_single(path, shown))
    if (reason := objection(found)) is not None:
        raise Refusal(f"refused: {reason}")
    told = changes(found, before)
    write_pages(" and ".join(names) or "Adapters", found, told, out, compared=before is not None)
    for outcome in Outcome:
        if number := sum(line.outcome is outcome for line in found):
            show(f"{number:>6}  {outcome}")
    for sentence in told.broke.values():
        show(harmless(f"broke: {sentence}"))
    show(f"{out / 'index.html'} has the matrix of {counted(len(found), 'row')}")
    if told.broke:
        return ExitCode.NOT_CONFORMANT
    faults = any(line.outcome in (Outcome.FAULT, Outcome.NOT_RUN) for line in found)
    return ExitCode.INDETERMINATE if faults else ExitCode.CONFORMANT


def _judge_again(line: Line, directory: Path) -> None:
    """Judge the record of a row once more, with its certificate.

    Raises:
        Refusal: it is not what its result says.
    """
    from ..fleet.lines import line as reduced
    from ..fleet.outcome import RECORD, Result, judged
    from ..fleet.plan import RUNS

    folder = directory / RUNS / str(line.key)
    with tempfile.TemporaryDirectory() as plain:
        record = Path(plain, "run.json")
        with gzip.open(folder / RECORD) as source, record.open("wb") as target:
            shutil.copyfileobj(source, target)
        told = _examined(record, folder / "certificate.json" if line.certificate else None)
    result = Result(key="", id=line.id, version=line.version, outcome=judged(told), verdict=told, seconds=0)
    again = reduced(result, "")
    if (again.outcome, again.cells, again.causes, again.kit) != (line.outcome, line.cells, line.causes, line.kit):
        raise Refusal(
            f"refused: {folder}: judged again, the run of {line.id} {line.version} is another than its result says"
        )


def _single(path: Path, shown: str) -> Line:
    """Judge a run that was given by itself."""
    from ..fleet.lines import line
    from ..fleet.outcome import Result, file_digest, judged

    record = path / "run.json" if path.is_dir() else path
    certificate = record.with_name("certificate.json")
    told = _examined(record, certificate if certificate.is_file() else None)
    result = Result(
        key="",
        id=told["subject"]["name"],
        version=told["subject"]["version"],
        outcome=judged(told),
        verdict=told,
        certificate=certificate.is_file(),
        record=file_digest(record),
        seconds=0,
    )
    return line(result, shown if path.is_dir() else os.path.dirname(shown) or ".")


def _examined(record: Path, certificate: Path | None) -> dict[str, Any]:
    """Return the verdict of a record that holds.

    Raises:
        UsageError, Refusal: there is none, or it does not hold.
    """
    from .confined import Bounds, confined
    from .files import LARGEST_CERTIFICATE, LARGEST_RECORD, content, size
    from .verify import examination

    told = None if certificate is None else (certificate, content(certificate, LARGEST_CERTIFICATE))
    bounds = Bounds.of(size(record, LARGEST_RECORD))
    verdict: dict[str, Any] = confined("examination", examination(record, told), bounds, str(record))["run"]
    return verdict
