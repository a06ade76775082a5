"""``otmcp docs``: the documentation, which the wheel has with it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from importlib.resources.abc import Traversable
from typing import Any

from ..core.errors import KitError, UsageError
from ..core.names import describe_unknown
from . import show

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "docs",
        help="print a page of the documentation, or list the pages",
        description="Print a page of the documentation (Markdown); without a name, list the pages.",
    )
    page = parser.add_argument("page", metavar="NAME", nargs="?", help="a page, such as subject-file")
    # argcomplete asks an argument for its words by this attribute.
    page.completer = lambda **_: list(_pages())  # type: ignore[attr-defined]
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the page, or one line for each page.

    Raises:
        UsageError: there is no such page.
        KitError: the installation has no documentation.
    """
    pages = _pages()
    if args.page is None:
        width = max(map(len, pages))
        for name, page in sorted(pages.items()):
            show(f"{name:<{width}}  {page.read_text(encoding='utf-8').partition(chr(10))[0].lstrip('# ')}")
        return 0
    name = args.page.removesuffix(".md").removeprefix("docs/")
    if name not in pages:
        raise UsageError(describe_unknown("page", name, pages))
    text = pages[name].read_text(encoding="utf-8")
    if not sys.stdout.isatty():
        print(text, end="")
        return 0
    for line, code in _lines(text):
        # What somebody may copy is left as it is.
        (print if code else show)(line)
    return 0


def _lines(text: str) -> Iterator[tuple[str, bool]]:
    """Yield the lines of a page for a reader, without the anchors of links, each with whether it is code."""
    code = False
    for line in text.splitlines():
        fence = line.startswith("```")
        code ^= fence
        if not line.startswith('<a id="'):
            yield line, code or fence


def _pages() -> dict[str, Traversable]:
    """Return the pages by name."""
    from importlib.resources import files

    # In a wheel the folder lies in the kit's package, in a checkout beside it; setup.py says which folders do so.
    package = files(__package__.partition(".")[0])
    for folder in (package / "docs", package.joinpath("..", "docs")):
        if pages := {page.name.removesuffix(".md"): page for page in _entries(folder) if page.name.endswith(".md")}:
            return pages
    raise KitError("the installation has no documentation")


def _entries(folder: Traversable) -> list[Traversable]:
    return list(folder.iterdir()) if folder.is_dir() else []
