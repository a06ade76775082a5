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
        description="Print a page of the documentation (Markdown) or a part of one, a JSON Schema, or a file that a page tells to copy, "
        "such as first-adapter/strict_mcp.py; with a directory, write all of them into it; without an argument, list the pages.",
    )
    page = parser.add_argument(
        "page",
        metavar="NAME|DIRECTORY",
        nargs="?",
        help="a page, such as subject-file; a part, such as by-library#mcp; or a directory, with a slash: ./site or /tmp/site",
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
    name, _, place = args.page.removeprefix("docs/").partition("#")
    asked = name.removesuffix(".md")
    if asked in copies():
        print(content(asked).decode(), end="")
        return 0
    if asked in named:
        text = content(f"{asked}.md" if f"{asked}.md" in titles() else asked).decode()
        _print(_part(text, asked, place) if place else text)
        return 0
    if not args.page.startswith((".", "/")) and not args.page.endswith("/"):
        raise UsageError(describe_unknown("page", asked, named))
    number = write(Path(args.page))
    show(f"{number} files written; begin with {Path(args.page) / INDEX}")
    return 0


def _part(text: str, page: str, place: str) -> str:
    """Return what a page says from an anchor to the next.

    Raises:
        UsageError: the page does not have the anchor.
    """
    parts = re.split(r'^<a id="([^"]*)"></a>$\n', text, flags=re.MULTILINE)
    by_place = dict(zip(parts[1::2], parts[2::2], strict=True))
    if not by_place:
        raise UsageError(f"the page {page} has no parts that can be asked for: 'otmcp docs {page}' prints it")
    if place not in by_place:
        raise UsageError(describe_unknown(f"part of {page}", place, by_place))
    return by_place[place]


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
