"""The command ``otmcp``: one module for each subcommand, and the one place where errors become exit codes.

A subcommand's module has ``add_parser(subparsers)`` and ``run(args) -> int``, and imports heavy modules inside ``run``.
Exit codes are those of :class:`pytest_otmcp.core.verdict.ExitCode`. Every error ends in one sentence, without a traceback.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import NoReturn, TextIO

from .. import __version__
from ..core.errors import ExhaustedError, KitError, UsageError, place_of
from ..core.exhaustion import exhausted
from ..core.text import folded, marked, one_line
from ..core.verdict import ExitCode
from ..session.keeper import hide_memory

__all__ = ["Refusal", "add_json", "cut", "main", "seconds", "show", "show_json", "tell"]

_COMMANDS = (
    "init",
    "doctor",
    "call",
    "console",
    "assess",
    "certify",
    "fleet",
    "merge",
    "verify",
    "judge",
    "explain",
    "report",
    "mock",
    "self-check",
    "docs",
)
_LONGEST = 2000
_COMPLETING = "_ARGCOMPLETE"
"""Variable by which argcomplete's part in the shell asks the program for the words that fit."""


class Refusal(Exception):
    """A command refuses what it was asked for; the message says why, in one sentence.

    Attributes:
        code: the exit code.
        quotes: whether lines after the first are an adapter's, which can be read better as lines.
    """

    def __init__(self, message: str, code: ExitCode = ExitCode.NOT_CONFORMANT, *, quotes: bool = False) -> None:
        super().__init__(message)
        self.code = code
        self.quotes = quotes


def cut(sentence: str) -> str:
    """Return a sentence that repeats a file without what nobody reads: the file may hold a text of any length."""
    return sentence if len(sentence) <= _LONGEST else f"{sentence[:_LONGEST]}…"


def tell(text: str) -> None:
    """Print a text that may repeat somebody else's words."""
    show(marked(text))


def show(text: str, stream: TextIO | None = None) -> None:
    """Print lines of the kit's own, or harmless ones: folded between words on a terminal, and as they are in a pipe or a log.

    Args:
        text: the lines.
        stream: where to; standard output if None.
    """
    stream = sys.stdout if stream is None else stream
    if stream.isatty():
        width = shutil.get_terminal_size().columns
        text = "\n".join(part for line in text.splitlines() for part in folded(line, width))
    print(text, file=stream, flush=True)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declare the option of a command whose result, or refusal, a program can read."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON, also why there is none")


def seconds(text: str) -> float:
    """Return the value of an option that is a duration; an ``argparse`` error for what is none."""
    with suppress(ValueError):
        if math.isfinite(found := float(text)) and found > 0:
            return found
    raise argparse.ArgumentTypeError(f"expected a number of seconds above 0, found {text!r}")


def show_json(document: object) -> None:
    """Print a result for a program: one JSON value in ASCII, in which no word of an adapter can move the cursor."""
    print(json.dumps(document, indent=1, default=str), flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments without the program's name; None for the arguments of the process.

    Returns:
        The exit code.
    """
    # Whatever a command does, an adapter may be running meanwhile, and what is judged or signed is in this process.
    hide_memory()
    try:
        code = _run(argv)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of stdout is gone; the interpreter must not complain about that again when it flushes at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.USAGE
    return code


def _run(argv: Sequence[str] | None) -> int:
    try:
        parser = _parser()
        if _COMPLETING in os.environ:
            # A shell that completes words asks for it; the extra "completion" brings the library. Without it the command must
            # end here: nobody has asked yet that it be carried out.
            import_module("argcomplete").autocomplete(parser)
        arguments = parser.parse_args(argv)
        if arguments.run is None:
            parser.print_help(sys.stderr)
            return ExitCode.USAGE
        return _done(arguments)
    except SystemExit as end:
        # argparse has said what is wrong, or has printed the help.
        return end.code if isinstance(end.code, int) else ExitCode.CONFORMANT
    except KeyboardInterrupt:
        return _say("interrupted", ExitCode.USAGE)
    except Refusal as reason:
        if not reason.quotes:
            return _say(str(reason), reason.code)
        show(marked(f"otmcp: {reason}"), sys.stderr)
        return reason.code
    except UsageError as error:
        return _say(str(error), ExitCode.USAGE)
    except ExhaustedError as error:
        return _say(str(error), ExitCode.INDETERMINATE)
    except KitError as error:
        return _say(f"{error} (a fault of the kit; please file a bug)", ExitCode.INDETERMINATE)
    except BrokenPipeError:
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        if (cure := exhausted(error)) is not None:
            return _say(f"{where}{cure}", ExitCode.INDETERMINATE)
        return _say(f"{where}{error.strerror or error}", ExitCode.USAGE)
    except Exception as error:
        return _say(f"a fault of the kit at {place_of(error)}: {error!r}; please file a bug", ExitCode.INDETERMINATE)


def _done(arguments: argparse.Namespace) -> int:
    """Run the command; a program that asked for JSON gets a refusal as JSON, too."""
    try:
        return int(arguments.run(arguments))
    except (Refusal, UsageError) as refusal:
        if getattr(arguments, "json", False):
            show_json({"refused": str(refusal)})
        raise


class _Parser(argparse.ArgumentParser):
    """A parser whose complaint is one sentence, like every other one of the command."""

    def error(self, message: str) -> NoReturn:
        """Print the usage and the complaint, and end the process."""
        self.print_usage(sys.stderr)
        show(one_line(f"{self.prog}: error: {message}"), sys.stderr)
        raise SystemExit(int(ExitCode.USAGE))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="otmcp", description="Conformance of MCP-to-OT adapters.")
    parser.add_argument("--version", action="version", version=f"pytest-otmcp {__version__}")
    # Whoever says no command gets the list of all of them.
    parser.set_defaults(run=None)
    subparsers = parser.add_subparsers(metavar="COMMAND", title="commands")
    for name in _COMMANDS:
        import_module(f".{name.replace('-', '_')}", __name__).add_parser(subparsers)
    return parser


def _say(sentence: str, code: ExitCode) -> int:
    show(one_line(f"otmcp: {sentence}"), sys.stderr)
    return code
