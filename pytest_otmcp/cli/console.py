"""``otmcp console``: a page in the browser that shows an adapter's reply, the frames and the device beside each other."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import UsageError
from ..core.site import site
from ..protocols.registry import protocols
from . import Refusal, show
from .certify import interruptible
from .isolated import add_option, isolated
from .mock import port
from .report import rendered

if TYPE_CHECKING:
    from ..subject import Subject

__all__ = ["add_parser", "run"]

_SUBJECT, _RECORD = "otmcp.toml", "run.json"
_HERE = (Path(_SUBJECT), Path("reports", "latest", _RECORD))
"""Files that are taken where none is named."""
_KEY = "OTMCP_CHAT_KEY"
"""Variable with the key of the chat interface: a command line can be read by every user of the machine."""

_PASSED_BY = frozenset({"node_modules", "__pycache__", "site-packages"})
_MOST = 200
"""Files that are taken from a directory."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "console",
        help="try adapters in the browser: reply, frames and device side by side",
        description=(
            "Serve a page on 127.0.0.1 that starts the adapters of subject files, each at a mock device of its own, calls their tools, and "
            "shows the reply, the frames and the device's journal beside each other. It opens run records as well. Ctrl-C ends it "
            "and everything that it has started."
        ),
    )
    parser.add_argument(
        "sources",
        metavar="FILE|DIRECTORY",
        type=Path,
        nargs="*",
        help=f"subject files and run records, or directories that hold {_SUBJECT} and {_RECORD} (default: {_HERE[0]} and "
        f"{_HERE[1]}, without a subject file the reference adapters)",
    )
    parser.add_argument("--port", metavar="N", type=port, default=0, help="port to serve on (default: a free one)")
    parser.add_argument(
        "--chat",
        metavar="URL",
        help=f"base of an OpenAI-compatible chat interface that prompts are put to, such as http://127.0.0.1:8080/v1; its key is taken from {_KEY}",
    )
    parser.add_argument("--chat-model", metavar="NAME", help="name of the model there")
    add_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve the console until it is interrupted; return 0 then.

    Raises:
        UsageError: there is no such file, a subject file is wrong, the port cannot be had, or an option lacks another.
    """
    from ..console.prompt import Endpoint
    from ..console.server import listening, serve
    from ..session.loop import LoopThread

    site()
    if (args.chat is None) != (args.chat_model is None):
        raise UsageError("--chat and --chat-model belong together")
    if args.chat is not None and not args.chat.startswith(("http://", "https://")):
        raise UsageError(f"--chat: expected an http or https URL, found {args.chat!r}")
    endpoint = args.chat and Endpoint(url=args.chat, model=args.chat_model, key=os.environ.get(_KEY, ""))
    files = list(_found(args.sources))
    subjects = _subjects(files, asked=bool(args.sources))
    records = [path for path in files if path.suffix != ".toml"]
    at = listening(args.port)
    loop = LoopThread()
    try:
        with interruptible(), isolated(args) as isolation, suppress(KeyboardInterrupt):
            loop.run(
                serve(
                    subjects,
                    records,
                    isolation,
                    at,
                    walls=args.isolation,
                    render=_render,
                    endpoint=endpoint,
                    ready=_say,
                )
            )
        show("the console has ended, and everything that it had started", sys.stderr)
    finally:
        loop.close()
        at.close()
    return 0


def _say(address: str) -> None:
    show(f"The console is at {address}\nThe address holds the key to it: keep it to yourself. Ctrl-C ends the console.")


def _subjects(files: Sequence[Path], *, asked: bool) -> list[Subject]:
    """Return the subjects of the files; the reference adapters that can be started here, where no file was asked for and none is here."""
    from dataclasses import replace

    from ..subject import load_subject, reference_subject
    from ..subject.selection import missing_library

    subjects = [load_subject(path) for path in files if path.suffix == ".toml"]
    if subjects or asked:
        return subjects
    show(f"no subject file {_SUBJECT} here: these are the reference adapters", sys.stderr)
    every = reference_subject()
    return [
        replace(every, adapters={k: one for k, one in every.adapters.items() if not missing_library(protocols()[k])})
    ]


def _found(sources: Sequence[Path]) -> Iterator[Path]:
    """Yield the subject files and the run records that are named, or are below a directory that is named.

    Raises:
        UsageError: a file is not there, or a directory has neither.
    """
    if not sources:
        yield from (path for path in _HERE if path.is_file())
    for source in sources:
        if not source.is_dir():
            if not source.is_file():
                raise UsageError(
                    f"{source}: {'this is no regular file' if source.exists() else 'there is no such file'}"
                )
            yield source
            continue
        below = list(_below(source))
        if not below:
            raise UsageError(f"{source}: there is no {_SUBJECT} and no {_RECORD} in this directory")
        if len(below) > _MOST:
            raise UsageError(
                f"{source}: more than {_MOST} files named {_SUBJECT} or {_RECORD}; name the ones that you want"
            )
        yield from below


def _below(directory: Path) -> Iterator[Path]:
    for folder, folders, names in os.walk(directory):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name not in _PASSED_BY)
        yield from (Path(folder, name) for name in (_SUBJECT, _RECORD) if name in names)


def _render(records: Sequence[Path], directory: Path) -> list[str]:
    """Write the report of a record, or the comparison of several.

    Raises:
        UsageError: a file is no record that can be believed, or is not there.
    """
    try:
        said: list[str] = rendered(records, directory)["said"]
    except Refusal as reason:
        raise UsageError(str(reason)) from None
    return said
