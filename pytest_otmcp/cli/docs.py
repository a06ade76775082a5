"""``otmcp docs``: the documentation, page by page in the terminal, or all of it in a directory."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..core.errors import UsageError
from ..core.names import describe_unknown
from . import show

__all__ = ["add_parser", "run"]

_ANCHOR = re.compile(r'<a id="[^"]*"></a>')


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "docs",
        help="print a page of the documentation, list the pages, or write them all into a directory",
        description="Print a page of the documentation (Markdown), a JSON Schema, or a file that a page tells to copy, such as "
        "first-adapter/strict_mcp.py; with a directory, write all of them into it; without an argument, list the pages.",
    )
    page = parser.add_argument(
        "page",
        metavar="NAME|DIRECTORY",
        nargs="?",
        help="a page, such as subject-file; or a directory, with a slash: ./site or /tmp/site",
    )
    # argcomplete asks an argument for its words by this attribute.
    page.completer = _completed  # type: ignore[attr-defined]
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the page, or one line for each page, or write all pages.

    Raises:
        UsageError: there is no such page, or the directory cannot be used.
        KitError: the installation has no documentation, or a page cannot be built.
    """
    from ..suite.documentation import INDEX, content, copies, titles, write

    named = {name.removesuffix(".md"): title for name, title in titles().items()}
    if args.page is None:
        width = max(map(len, named))
        for name, title in named.items():
            show(f"{name:<{width}}  {title}")
        return 0
    asked = args.page.removeprefix("docs/").removesuffix(".md")
    if asked in copies():
        print(content(asked).decode(), end="")
        return 0
    if asked in named:
        _print(content(f"{asked}.md" if f"{asked}.md" in titles() else asked).decode())
        return 0
    if not args.page.startswith((".", "/")) and not args.page.endswith("/"):
        raise UsageError(describe_unknown("page", asked, named))
    number = write(Path(args.page))
    show(f"{number} files written; begin with {Path(args.page) / INDEX}")
    return 0


def _print(text: str) -> None:
    """Print a page as it is, or for a reader at a terminal."""
    if not sys.stdout.isatty():
        print(text, end="")
        return
    for line, code in _lines(text):
        # What somebody may copy is left as it is.
        (print if code else show)(line)


def _lines(text: str) -> Iterator[tuple[str, bool]]:
    """Yield the lines of a page for a reader, without the anchors of links, each with whether it is code."""
    code = False
    for line in text.splitlines():
        fence = line.startswith("```")
        code ^= fence
        shown = _ANCHOR.sub("", line)
        if shown or not line:
            yield shown, code or fence


def _completed(**_: object) -> list[str]:
    """Return every name, for the completion of words in a shell."""
    from ..suite.documentation import copies, titles

    return [*(name.removesuffix(".md") for name in titles()), *copies()]
