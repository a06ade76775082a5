"""``otmcp fleet``: plan the certification of many adapters and versions, and have Snakemake carry the plan out."""

from __future__ import annotations

import argparse
import fcntl
import importlib.util
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import resources
from pathlib import Path
from typing import Any

import psutil

from ..core.errors import UsageError
from ..core.text import counted
from ..core.verdict import ExitCode
from . import show
from .certify import interruptible

__all__ = ["add_parser", "run"]

_DEFAULT_OUT = Path("fleet")


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "fleet",
        help="certify many adapters and versions, and put the verdicts into one matrix",
        description="Certify many adapters and versions, each apart from the others, on one machine or many.",
    )
    parser.set_defaults(run=lambda _: parser.error("say plan or run"))
    commands = parser.add_subparsers(metavar="COMMAND", title="commands")
    plan = commands.add_parser(
        "plan", help="write the plan: a file for each row, named by a digest of all that it depends on"
    )
    plan.set_defaults(run=_plan)
    whole = commands.add_parser(
        "run",
        help="plan, carry out what has not been carried out yet, and merge",
        description="Write the plan, have Snakemake carry out what has not been carried out yet, and merge.",
    )
    whole.add_argument(
        "--since", metavar="FLEET", type=Path, help="fleet.json of another time: what has changed, and what broke"
    )
    whole.add_argument(
        "--snakemake",
        metavar="OPTIONS",
        default="--cores all",
        help='options of Snakemake, such as --snakemake="--profile DIR" (default: "%(default)s")',
    )
    whole.set_defaults(run=run)
    for one in (plan, whole):
        one.add_argument("file", metavar="FLEET.TOML", type=Path, help="adapters and versions")
        one.add_argument(
            "--out", metavar="DIR", type=Path, default=_DEFAULT_OUT, help="folder of the fleet (default: %(default)s)"
        )
    row = commands.add_parser("row", help="what the engine starts: carry out one row of a plan")
    row.add_argument("row", metavar="ROW", type=Path, help="a file of the folder rows")
    row.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder of its run")
    row.add_argument("--attempt", metavar="N", type=int, default=1, help="the engine's count of tries")
    row.add_argument("--contained", action="store_true", help="this is the container of the row")
    row.set_defaults(run=_row)
    workflow = commands.add_parser("workflow", help="print the path of the Snakefile, beside which the profiles are")
    workflow.set_defaults(run=_tell_workflow)


def run(args: argparse.Namespace) -> int:
    """Plan, carry out, merge; return the exit code of the merge.

    Raises:
        UsageError: the plan or an option is wrong, Snakemake is not installed, or the fleet is being run already.
    """
    from .merge import merged

    if importlib.util.find_spec("snakemake") is None:
        raise UsageError('Snakemake is not installed: pip install "pytest-otmcp[fleet]"')
    try:
        options = shlex.split(args.snakemake)
    except ValueError as reason:
        raise UsageError(f"--snakemake: {args.snakemake!r} cannot be split into words: {reason}") from None
    finished = _planned(args)
    with _alone(args.out):
        # The lock of this command ends with it, that of the engine would outlive a machine that fails.
        command = [
            sys.executable,
            "-m",
            "snakemake",
            f"--snakefile={_workflow()}",
            f"--directory={args.out}",
            "--nolock",
        ]
        if finished and any((args.out / ".snakemake" / "incomplete").glob("*")):
            # The engine was ended before it knew of a row's verdict.
            subprocess.run([*command, "--quiet=all", "--cleanup-metadata", *finished], check=False, capture_output=True)
        command += ["--keep-going", "--rerun-incomplete", "--rerun-triggers=mtime", "--quiet=all"]
        _to_its_end([*command, *options])
    return merged([args.out], args.out, args.since)


def _to_its_end(command: list[str]) -> None:
    """Run the engine; pass an interruption on to it and to its jobs, which end their adapters, and wait for them.

    A second interruption kills all of them.
    """
    with interruptible():
        engine = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
        try:
            engine.wait()
        except KeyboardInterrupt:
            os.killpg(engine.pid, signal.SIGINT)
            engine.wait()
            raise
        finally:
            if engine.poll() is None:
                # Runs of the suite have sessions of their own.
                family = psutil.Process(engine.pid).children(recursive=True)
                os.killpg(engine.pid, signal.SIGKILL)
                for one in family:
                    with suppress(psutil.NoSuchProcess):
                        one.kill()
                engine.wait()


def _plan(args: argparse.Namespace) -> int:
    _planned(args)
    return ExitCode.CONFORMANT


def _planned(args: argparse.Namespace) -> list[str]:
    """Write the plan; return the folders, below the fleet's, of the rows that have a verdict."""
    from ..fleet.outcome import RESULT
    from ..fleet.plan import RUNS, write_plan

    plan = write_plan(args.file, args.out)
    folders = (f"{RUNS}/{row.key}" for row in plan.rows)
    finished = [folder for folder in folders if (args.out / folder / RESULT).is_file()]
    show(f"{args.out}: {counted(len(plan.rows), 'row')} planned, {len(finished)} of them carried out before")
    return finished


def _row(args: argparse.Namespace) -> int:
    from .fleet_row import run

    return run(args)


def _tell_workflow(_: argparse.Namespace) -> int:
    show(str(_workflow()))
    return ExitCode.CONFORMANT


def _workflow() -> Path:
    return Path(str(resources.files("pytest_otmcp.fleet") / "Snakefile"))


@contextmanager
def _alone(directory: Path) -> Iterator[None]:
    with (directory / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(f"{directory}: this fleet is being run already") from None
        yield
