"""``otmcp explain``: what an id in a report means, in plain words."""

from __future__ import annotations

import argparse
import textwrap
from typing import Any

from ..core.errors import UsageError

__all__ = ["add_parser", "run"]

_WIDTH = 100
_INDENT = "  "


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "explain",
        help="say what an item, a requirement or a code means",
        description="Say in plain words what an item (M3), a requirement (WR-003), an error code (illegal_address) or the code of a "
        "finding (wrong_value) means: what is asked, what must be said and seen, why, and by which source.",
    )
    parser.add_argument("id", metavar="ID", nargs="+", help="an id as reports print it")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explain every id.

    Raises:
        UsageError: an id is unknown.
    """
    from ..suite.explanations import Explained, explained, near

    found: list[Explained] = []
    for identifier in args.id:
        meanings = explained(identifier)
        if not meanings:
            hint = " or ".join(near(identifier))
            raise UsageError(
                f"there is no item, requirement or code {identifier!r}; "
                + (
                    f"did you mean {hint}?"
                    if hint
                    else "docs/items.md, docs/checks.md, docs/requirements.md and docs/codes.md list them all"
                )
            )
        found += meanings
    print("\n\n".join("\n".join(_lines(one)) for one in found))
    return 0


def _lines(one: Any) -> list[str]:
    lines = textwrap.wrap(f"{one.id} ({one.kind}): {one.about}", _WIDTH)
    for label, texts in one.parts:
        lines += ["", label]
        for text in texts:
            lines += textwrap.wrap(text, _WIDTH, initial_indent=_INDENT, subsequent_indent=_INDENT)
    return lines
