"""``otmcp judge``: what the oracles of this kit find in stored records otherwise than the records say.

It is the loop of whoever writes an oracle: no device and no adapter is started, and records of another kit are judged as well. Unlike
``otmcp verify`` it proves nothing, and reads the records, which are trusted, in this process.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import UsageError
from ..core.text import counted, harmless
from . import show

if TYPE_CHECKING:
    from ..record.reader import StoredRun
    from ..record.schema import Finding
    from ..replay.difference import Difference

__all__ = ["add_parser", "run"]

_NEW, _GONE, _CHANGED, _OTHER = "new", "gone", "changed", "other"


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "judge",
        help="judge stored records by this kit's oracles, and print what differs",
        description="Judge the history of run records again by the oracles of this kit, whichever kit has made them, and print what "
        "differs from what they say: findings that are new, gone or changed, and whatever else follows from the history. Nothing is "
        "started. The exit code is 0 when nothing differs, 1 when something does. For oracles that are being written; a record of "
        "somebody else is checked by 'otmcp verify'.",
    )
    parser.add_argument(
        "records", metavar="RUN", type=Path, nargs="+", help="a run.json, or one that was compressed to a run.json.gz"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Judge every record and print what differs.

    Raises:
        UsageError: a file is no record, or not one that this kit can judge.
    """
    records: list[Path] = args.records
    differing = sum([_differs(path) for path in records])
    if records[1:]:
        show(f"{differing} of {len(records)} records differ")
    return int(differing > 0)


def _differs(path: Path) -> bool:
    """Print what differs in a record, and tell whether anything does."""
    from ..record.reader import RecordError, open_record
    from ..replay.rejudge import differences

    number: Counter[str] = Counter()
    try:
        with open_record(path, allow_incomplete=True, compressed=True) as stored:
            _check(path, stored)
            for where, found in groupby(differences(stored), key=lambda one: one.where):
                show(harmless(where))
                for word, line in _lines(list(found)):
                    number[word] += 1
                    show(f"  {harmless(line)}")
            items = counted(stored.footer["items"], "item")
    except RecordError as reason:
        raise UsageError(str(reason)) from None
    findings = [f"{number[word]} {word}" for word in (_NEW, _GONE, _CHANGED) if number[word]]
    told = [f"findings: {', '.join(findings)}"] if findings else []
    told += [f"other differences: {number[_OTHER]}"] if number[_OTHER] else []
    show(harmless(f"{path}: {items}, {'; '.join(told) or 'nothing differs'}"))
    return bool(told)


def _check(path: Path, stored: StoredRun) -> None:
    from ..protocols.registry import protocols

    if "digest" not in stored.footer:
        # A run that was killed has not noted its devices.
        raise UsageError(f"{path}: the run did not end, and its devices are not known")
    if missing := sorted(stored.header["subject"]["adapters"].keys() - protocols().keys()):
        raise UsageError(f"{path}: no package that is installed here judges {' and '.join(missing)}")


def _lines(found: Iterable[Difference]) -> Iterator[tuple[str, str]]:
    """Return a line for each difference of one part of a record, after the word that it counts as."""
    from ..replay.difference import FindingDiffers, MemberDiffers, short

    shown: list[Finding] = []
    stated: list[Finding] = []
    others: list[str] = []
    for one in found:
        if isinstance(one, FindingDiffers):
            (shown if one.is_shown else stated).append(one.finding)
        elif isinstance(one, MemberDiffers):
            others.append(f"{one.name}: {short(one.shown)}, was {short(one.stated)}")
        else:
            others.append(one.reason)
    for finding in shown:
        before = _counterpart(finding, stated)
        if before is None:
            yield _NEW, f"new      {_told(finding)}"
        else:
            stated.remove(before)
            yield _CHANGED, f"changed  {_told(finding)}"
            yield "", f"    was  {_told(before)}"
    for finding in stated:
        yield _GONE, f"gone     {_told(finding)}"
    for other in others:
        yield _OTHER, other


def _counterpart(finding: Finding, stated: Iterable[Finding]) -> Finding | None:
    """Return the finding that this one was before: one with its sentence, else one with its code."""
    for name in ("message", "code"):
        for before in stated:
            if before[name] == finding[name]:
                return before
    return None


def _told(finding: Finding) -> str:
    cited = " ".join(word for word in (finding["requirement"], finding["code"]) if word)
    should = "" if finding["strength"] == "MUST" else f" ({finding['strength']})"
    cause = "" if finding["cause"] is None else f" (follows from {finding['cause']})"
    return f"{cited}{should}: {finding['message']}{cause}"
