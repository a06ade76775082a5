"""``otmcp self-check``: the kit judges adapters with known defects, and shows which item notices which defect."""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from ..core.errors import UsageError
from ..core.text import counted
from . import show as note
from . import tell
from .isolated import add_option as add_isolation
from .isolated import isolated

if TYPE_CHECKING:
    from ..soundness.defect import Declared, Defect
    from ..soundness.kill_matrix import KillMatrix, Outcome

__all__ = ["add_parser", "run"]

_REDRAW_S = 0.5
_INDENT = 11


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "self-check",
        help="show that the suites notice adapters with known defects",
        description="Start reference adapters with one known defect each at mock devices, run the items that must notice it and "
        "those beside them, and print which item noticed which defect. The exit code is 0 when each was noticed by "
        "exactly the items that must notice it, for exactly the requirements that it breaks. Without names a sample of "
        "the defects is run, one at least for each area of the requirement suite; the head of the output says how many.",
    )
    parser.add_argument(
        "names", metavar="NAME", nargs="*", help="ids such as MU-13, areas such as wr, or benchmark (default: a sample)"
    )
    parser.add_argument("--all", action="store_true", help="run every defect")
    parser.add_argument(
        "-n",
        metavar="N",
        dest="workers",
        type=_number,
        default=None,
        help="defects at a time (default: one a processor)",
    )
    add_isolation(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the defects and print the kill matrix.

    Raises:
        UsageError: there is no such defect or area, or walls are required and the machine refuses one.
        KitError: a defect could not be judged.
        KeyboardInterrupt: a signal has ended it.
    """
    if args.all and args.names:
        raise UsageError("--all runs every defect: name none beside it")
    workers = args.workers or len(os.sched_getaffinity(0))
    show = _Display(rows=not args.json)
    show.say("reference adapters with one known defect each are judged at mock devices")

    from ..soundness.defect import chosen, declared

    known = declared()
    if args.names:
        defects = chosen(known.defects, args.names)
    else:
        defects = [one for one in known.defects if args.all or one.sample]
    defects = _startable(defects)
    show.begin(defects, known, workers)
    with isolated(args) as isolation:
        # Each worker builds its own. This one shows beforehand what the machine refuses.
        isolation.walls()
        matrix = asyncio.run(_judged(known, defects, workers, args.isolation, show))
    if args.json:
        print(json.dumps(matrix.as_document(), indent=1, ensure_ascii=False))
    else:
        for line in _totals(matrix):
            tell(line)
    return matrix.exit_code


def _startable(defects: list[Defect]) -> list[Defect]:
    """Return the defects whose adapters can be started, and say which protocols are left out because a library is missing.

    Raises:
        UsageError: there is none.
    """
    from ..protocols.registry import protocols
    from ..subject.selection import missing_library

    missing = {
        key: f"{protocols()[key].name}: {sentence}"
        for key in dict.fromkeys(one.protocol for one in defects)
        if (sentence := missing_library(protocols()[key]))
    }
    startable = [one for one in defects if one.protocol not in missing]
    if not startable:
        raise UsageError("; ".join(missing.values()))
    for key, sentence in missing.items():
        note(f"{counted(sum(one.protocol == key for one in defects), 'defect')} left out, {sentence}", sys.stderr)
    return startable


def _number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= 64):
        raise argparse.ArgumentTypeError(f"expected 1 to 64, found {text!r}")
    return int(text)


async def _judged(known: Declared, defects: list[Defect], workers: int, isolation: str, show: _Display) -> KillMatrix:
    from ..core.matrix import REQUIREMENTS
    from ..soundness.kill_matrix import KillMatrix
    from ..soundness.pool import run as run_pool
    from ..suite.catalogue import all_tasks
    from ..suite.requirements import requirements

    outcomes: dict[str, Outcome] = {}

    def done(outcome: Outcome) -> None:
        outcomes[outcome.defect.id] = outcome
        show.done(outcome)

    drawing = asyncio.create_task(show.redraw())
    try:
        await run_pool(defects, workers, isolation, begun=show.begun, done=done)
    finally:
        drawing.cancel()
        with suppress(asyncio.CancelledError):
            await drawing
        show.clear()
    return KillMatrix(
        declared=known,
        outcomes=[outcomes[one.id] for one in defects],
        checks={task.id: task.requirements[0] for task in all_tasks().values() if task.suite == REQUIREMENTS},
        rows=requirements(),
    )


class _Display:
    """A row for each defect when it was judged, and on a terminal a moving line for what is under way.

    Args:
        rows: print the rows; otherwise there is the moving line alone, on stderr as always.
    """

    def __init__(self, *, rows: bool) -> None:
        self._rows = rows
        self._moving = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._under_way: dict[str, float] = {}
        self._done = self._total = 0
        self._began = time.monotonic()

    def say(self, text: str) -> None:
        if self._rows:
            self.clear()
            tell(text)

    def begin(self, defects: list[Defect], known: Declared, workers: int) -> None:
        self._total = len(defects)
        whole = "" if len(defects) == len(known.defects) else "; --all runs every one"
        self.say(f"{len(defects)} of {counted(len(known.defects), 'defect')}, {workers} at a time{whole}\n")

    def begun(self, defect: Defect) -> None:
        self._under_way[defect.id] = time.monotonic()

    def done(self, outcome: Outcome) -> None:
        del self._under_way[outcome.defect.id]
        self._done += 1
        for line in _row(outcome):
            self.say(line)

    async def redraw(self) -> None:
        """Draw the moving line until cancelled."""
        while self._moving:
            self._draw()
            await asyncio.sleep(_REDRAW_S)

    def _draw(self) -> None:
        now = time.monotonic()
        names = ", ".join(f"{name} {now - since:.0f} s" for name, since in self._under_way.items())
        text = f"  {self._done} of {self._total} judged in {now - self._began:.0f} s; under way: {names}"
        print(f"\r{text[: shutil.get_terminal_size().columns - 1]}\x1b[K", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Take the moving line away."""
        if self._moving:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _row(one: Outcome) -> Iterator[str]:
    defect, seen = one.defect, one.seen
    yield f"{defect.id:<{_INDENT}}{one.word:<12}{defect.protocol}: {defect.sentence} ({one.seconds:.0f} s)"
    yield _below(f"by {_list(seen.items)} for {_list(seen.requirements)}")
    if one.is_expected:
        return
    yield _below(f"must be by {_list(defect.items)} for {_list(defect.requirements)}")
    for sign, names in (
        ("unexpected", seen.items - set(defect.items) | seen.requirements - set(defect.requirements)),
        ("missing", set(defect.items) - seen.items | set(defect.requirements) - seen.requirements),
    ):
        if names:
            yield _below(f"{sign}: {_list(names)}")
    for text in (*seen.faults, *seen.words):
        yield _below(text)


def _totals(matrix: KillMatrix) -> Iterator[str]:
    known = matrix.declared
    yield ""
    yield (
        f"defects noticed by exactly what must notice them: {len(matrix.noticed)} of {len(matrix.outcomes)}"
        + (f", {len(matrix.warned)} of them by a warning that fails no item" if matrix.warned else "")
    )
    yield f"defects of the catalogue: {len(matrix.shown)} of {known.total} noticed in this run; adapters have {len(matrix.covered)}"
    yield f"MUSTs with a check that fails for a defect: {len(matrix.killed)} of {len(matrix.musts)} in this run"
    if matrix.is_whole:
        yield f"MUSTs with a check that failed for none: {_list(matrix.musts - matrix.killed)}"
        yield ""
        yield "MUSTs without a check:"
        for row, reason in matrix.unjudged.items():
            yield f"{row:<{_INDENT}}{reason}"
        yield ""
        yield "defects of the catalogue, or ways to have them, that no adapter has yet, and what it takes to notice them:"
        for one in known.unnoticed:
            yield f"{one.id:<{_INDENT}}{one.sentence} ({one.reason})"
    yield ""
    if matrix.unexpected:
        yield f"not as expected: {' '.join(one.defect.id for one in matrix.unexpected)}"
    else:
        yield "all as expected"


def _list(names: Any) -> str:
    return " ".join(sorted(names)) or "nothing"


def _below(text: str) -> str:
    return " " * _INDENT + text
