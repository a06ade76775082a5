"""``otmcp explain``: what an id in a report means, in plain words."""

from __future__ import annotations

import argparse
import re
import shutil
import textwrap
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ..core.errors import UsageError
from . import add_json, show, show_json

if TYPE_CHECKING:
    from ..suite.explanations import Explained

__all__ = ["add_parser", "run"]

_WIDTH = 100
"""Columns of a line at most; a narrower terminal has fewer."""

_INDENT = "  "


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "explain",
        help="say what an item, a requirement, a level or a code means",
        description="Say in plain words what an item (M3), a requirement (WR-003), a level (Bronze), a profile (mb-r), a facet "
        "(guard), an error code (illegal_address) or the code of a finding (wrong_value) means: what is asked, what must be said "
        "and seen, why, and by which source.",
    )
    asked = parser.add_argument(
        "id", metavar="ID", nargs="*", help="an id as reports print it; without one, list them all"
    )
    # argcomplete asks an argument for its words by this attribute.
    asked.completer = _completed  # type: ignore[attr-defined]
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explain every id that is asked for, or list all of them with a sentence each.

    Raises:
        UsageError: an id is unknown.
    """
    from ..suite.explanations import explained, identifiers, near

    found: list[Explained] = []
    for identifier in args.id or identifiers():
        meanings = explained(identifier)
        if not meanings:
            if re.fullmatch(r"MU-\d+[a-z]*", identifier, re.IGNORECASE):
                raise UsageError(f"{identifier} is a defect of the self-check: 'otmcp self-check {identifier}' runs it")
            hint = " or ".join(near(identifier))
            raise UsageError(
                f"there is no item, requirement, level, profile, facet or code {identifier!r}; "
                + (
                    f"did you mean {hint}?"
                    if hint
                    else "'otmcp docs' prints the pages items, checks, requirements and codes, which list them all"
                )
            )
        found += meanings
    if args.json:
        show_json([{**asdict(one), "parts": dict(one.parts)} for one in found])
        return 0
    width = min(_WIDTH, shutil.get_terminal_size((_WIDTH, 0)).columns)
    if not args.id:
        for one in found:
            show(f"{one.id:<24} {one.kind}: {one.about}")
        return 0
    print("\n\n".join("\n".join(_lines(one, width)) for one in found))
    return 0


def _completed(**_: object) -> list[str]:
    """Return every id, for the completion of words in a shell."""
    from ..suite.explanations import identifiers

    return identifiers()


def _lines(one: Explained, width: int) -> list[str]:
    lines = textwrap.wrap(
        f"{one.id} ({one.kind}): {one.about}", width, subsequent_indent=_INDENT, break_on_hyphens=False
    )
    for label, texts in one.parts:
        lines += ["", label]
        for text in texts:
            lines += textwrap.wrap(
                text, width, initial_indent=_INDENT, subsequent_indent=_INDENT, break_on_hyphens=False
            )
    return lines
