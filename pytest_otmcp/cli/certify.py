"""``otmcp certify``: the whole suite, isolated from the vendor's configuration, and a certificate or the reason for none.

A vendor's repository can change a pytest run without anybody noticing: a conftest that shadows a fixture, an ini that
deselects, a plugin that reorders. So the suite runs in a process of its own, with the kit's ini in an empty root
directory, without conftest files, and without any plugin but pytest's and the kit's.
"""

from __future__ import annotations

import argparse
import os
import secrets
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO, Any

from ..core.challenge import NONCE, is_nonce
from ..core.errors import UsageError
from ..core.matrix import SUITES
from ..core.site import site
from ..core.verdict import ExitCode
from . import Refusal, tell
from .isolated import add_option

__all__ = ["add_parser", "interruptible", "run", "run_suite"]

_DEFAULT_OUT = Path("reports", "certificate")
_OURS = (
    *("run.json", "certificate.json", "certificate.json.sig", "certificate.html", "badge.json", "badge.svg"),
    *("report.html", "summary.md", "verdict.json"),
)
"""Files of an earlier certification, which must not be there when this one fails."""

_BENDING = ("PYTHONOPTIMIZE", "PYTHONWARNINGS", "PYTHONSTARTUP", "PYTHONINSPECT")
"""Environment variables that change how Python runs the kit: they are left out, as are all that begin with ``PYTEST``."""

_GRACE_S = 60.0
"""Seconds that an interrupted pytest gets: it closes sessions and devices, each with its own deadlines, and writes its record."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "certify",
        help="run benchmark and requirement suite in isolation and write a certificate",
        description="Run the benchmark and the requirement suite, isolated from pytest configuration and plugins, and write certificate.json, "
        "badge.json and badge.svg if the subject is conformant.",
    )
    parser.add_argument(
        "--subject",
        metavar="FILE",
        type=Path,
        help="subject file (default: otmcp.toml here if there is one, else the reference adapters)",
    )
    parser.add_argument("--reps", metavar="N", type=int, default=30, help="repetitions, at least 30 (default: 30)")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=_DEFAULT_OUT, help="directory to write to (default: %(default)s)"
    )
    add_option(parser)
    parser.add_argument(
        "--challenge",
        metavar="NONCE",
        help=f"a buyer's question, from which the values of the run follow: {NONCE} (default: values are drawn anew)",
    )
    parser.add_argument(
        "--sign",
        metavar="KEY",
        type=Path,
        help="SSH key that signs the certificate, by ssh-keygen of OpenSSH (a public key, if an agent has the private one)",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the suite, judge the record, write the certificate.

    Raises:
        UsageError: an option or the subject file is wrong.
        KitError: the suite did not run.
        Refusal: there is no certificate.
    """
    from ..certificate.eligibility import MINIMUM_REPS, unguarded, unhurried
    from ..subject import load_subject, reference_subject
    from ..subject.claims import Claims
    from .issuing import concluded, write, write_pages
    from .signature import check_key, sign

    site()
    if args.sign is not None:
        check_key(args.sign)
    if args.challenge is not None and not is_nonce(args.challenge):
        raise UsageError(f"--challenge: expected {NONCE}, found {args.challenge[:40]!a}")
    if args.reps < MINIMUM_REPS:
        raise UsageError(f"--reps: a certificate needs at least {MINIMUM_REPS} repetitions, found {args.reps}")
    out: Path = args.out.absolute()
    for name in _OURS:
        (out / name).unlink(missing_ok=True)
    file = _subject_file(args.subject)
    subject = reference_subject() if file is None else load_subject(file)
    if subject.deviations:
        known = ", ".join(deviation.item for deviation in subject.deviations)
        raise Refusal(
            f"no certificate: {subject.source} declares known deviations ({known}), and a certificate excuses nothing; "
            f"pytest --otmcp-reps={args.reps} accepts them until they expire"
        )
    deadlines = {protocol: adapter.deadline_s for protocol, adapter in subject.adapters.items()}
    if without := [*unguarded(Claims.of_subject(subject.adapters), subject.adapters), *unhurried(deadlines)]:
        raise Refusal(f"no certificate: {'; '.join(without)}")
    out.mkdir(parents=True, exist_ok=True)
    tell(f"certifying {subject.name} {subject.version} ({file or 'shipped with the kit'})")
    # Nobody can know beforehand which values will be written and read: the seed is random, or follows from a buyer's question.
    chosen = f"seed={secrets.randbelow(2**32)}" if args.challenge is None else f"challenge={args.challenge}"
    ended = run_suite(
        file, out, f"--otmcp-reps={args.reps}", f"--otmcp-{chosen}", f"--otmcp-isolation={args.isolation}"
    )
    record, statement = concluded(out, ended)
    write(out, statement)
    if args.sign is not None:
        tell(f"{sign(out / 'certificate.json', args.sign).name} is the signature of {args.sign}")
    write_pages(out, record, statement, signed=args.sign is not None)
    return ExitCode.CONFORMANT


def _subject_file(given: Path | None) -> Path | None:
    if given is not None:
        return given.absolute()
    default = Path("otmcp.toml").absolute()
    return default if default.is_file() else None


def run_suite(
    subject: Path | None, out: Path, *options: str, log: IO[bytes] | None = None, limit_s: float | None = None
) -> int:
    """Run the suite in a process of its own; return the exit code of pytest.

    Args:
        subject: the subject file, an absolute path; None for the reference adapters.
        out: folder of the record, an absolute path.
        options: of the run.
        log: gets what pytest prints; None for this process's own streams.
        limit_s: seconds after which it is interrupted.

    Raises:
        subprocess.TimeoutExpired: it was.
    """
    with tempfile.TemporaryDirectory(prefix="otmcp-certify-") as root:
        ini = Path(root, "pytest.ini")
        ini.write_text("[pytest]\n", encoding="utf-8")
        # Files of the suite are shown by their names alone below the directory in which this was called.
        command = [sys.executable, "-P", "-m", "pytest", "-c", str(ini), f"--rootdir={Path.cwd()}", "--noconftest"]
        command += [
            "-rN",
            "-p",
            "no:cacheprovider",
            "-p",
            "pytest_otmcp.plugin",
            "--pyargs",
            "pytest_otmcp.conformance",
        ]
        command += [f"--otmcp-suite={','.join(SUITES)}", f"--otmcp-report-dir={out}", *options]
        if subject is not None:
            command.append(f"--otmcp-subject={subject}")
        return _supervised(command, _environment(), log, limit_s)


def _environment() -> dict[str, str]:
    """Return the caller's environment without the variables that would change the run."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST") and name not in _BENDING}
    return {**kept, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}


def _supervised(
    command: list[str], environment: dict[str, str], log: IO[bytes] | None = None, limit_s: float | None = None
) -> int:
    """Run a command to its end; pass an interruption on to it once, from whatever signal, and wait for its end."""
    with interruptible():
        # The process has a session of its own: otherwise Ctrl-C in a terminal would reach it a second time, while it closes.
        process = subprocess.Popen(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
        try:
            return process.wait(limit_s)
        except (KeyboardInterrupt, subprocess.TimeoutExpired):
            process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                # Whoever wants it to end gets that, whatever keeps it: it is killed, and its keeper ends the rest.
                process.wait(_GRACE_S)
            raise
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt for every signal that asks this process to end, so that nothing is left running."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    # SIGINT is included: a shell may have set it to be ignored. A child process inherits that, but it inherits no handler.
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
