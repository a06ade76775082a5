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

_COPIED = "first-adapter"
"""The folder of adapters and subject files that beginners copy."""

_LEFT_BEHIND = ("__pycache__", "node_modules", "pki")


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "docs",
        help="print a page of the documentation, or list the pages",
        description="Print a page of the documentation (Markdown), or a file that a page tells to copy, such as "
        "first-adapter/strict_mcp.py; without a name, list the pages.",
    )
    page = parser.add_argument("page", metavar="NAME", nargs="?", help="a page, such as subject-file")
    # argcomplete asks an argument for its words by this attribute.
    page.completer = lambda **_: [*_pages(), *_to_copy()]  # type: ignore[attr-defined]
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
    asked = args.page.removeprefix("docs/")
    if (copied := _to_copy().get(asked)) is not None:
        print(copied.read_text(encoding="utf-8"), end="")
        return 0
    name = asked.removesuffix(".md")
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
    return {page.name.removesuffix(".md"): page for page in _entries(_folder()) if page.name.endswith(".md")}


def _to_copy() -> dict[str, Traversable]:
    """Return the files that a page tells to copy, by their path from the folder of the pages."""
    return dict(_below(_folder() / _COPIED, _COPIED))


def _below(folder: Traversable, path: str) -> Iterator[tuple[str, Traversable]]:
    """Yield the files of a folder and of those in it, without what Python, npm and an adapter leave there."""
    for entry in _entries(folder):
        if entry.is_file():
            yield f"{path}/{entry.name}", entry
        elif entry.name not in _LEFT_BEHIND:
            yield from _below(entry, f"{path}/{entry.name}")


def _folder() -> Traversable:
    from importlib.resources import files

    # In a wheel the folder lies in the kit's package, in a checkout beside it; setup.py says which folders do so.
    package = files(__package__.partition(".")[0])
    for folder in (package / "docs", package.joinpath("..", "docs")):
        if any(page.name.endswith(".md") for page in _entries(folder)):
            return folder
    raise KitError("the installation has no documentation")


def _entries(folder: Traversable) -> list[Traversable]:
    return list(folder.iterdir()) if folder.is_dir() else []
