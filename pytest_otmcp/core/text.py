"""Escaping of text from outside, which makes it harmless to show, and the grammar of counts. Pure.

Whatever the kit writes to a terminal or a log goes through :func:`marked` or :func:`one_line`, if an adapter, a device or a file
may have had a hand in it. The first line then begins with the kit's own words, and every other one with a mark: no foreign line can
be taken for one of the kit's, nor for a command to the service that runs the tests and reads its log.
"""

from __future__ import annotations

import re
import textwrap

__all__ = ["LONGEST_NAME", "MARK", "counted", "folded", "harmless", "marked", "one_line", "printable", "recorded_name"]

MARK = "| "
"""Begins every line that the kit has not written itself."""

LONGEST_NAME = 1000
"""Characters of a name in a record."""

_COMMAND = re.compile(r"(?<!\S)::|##(?=\w*\[)")
"""Beginning of a command in a log: ``::NAME::`` at the beginning of a line (GitHub), ``##[NAME`` and ``##vso[NAME`` anywhere
(Azure), ``##teamcity[NAME``. A long line may be broken anywhere."""


def counted(number: int, noun: str) -> str:
    """Write a number with its noun: ``1 run``, ``3 runs``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def printable(text: str, keep: str = "") -> str:
    """Replace every character that is not printable by its escape, except those in ``keep``.

    Control characters could colour a terminal or forge a line; characters that change the reading direction could make
    a browser show another text than the one that is there.
    """
    return "".join(letter if letter.isprintable() or letter in keep else repr(letter)[1:-1] for letter in text)


def recorded_name(text: str) -> str:
    """Return a name that somebody else has chosen as a record has it: printable, and cut off after :data:`LONGEST_NAME`."""
    return printable(text[:LONGEST_NAME])[:LONGEST_NAME]


def harmless(line: str) -> str:
    """Return a line for a terminal or a log: printable, and without the beginning of a command of a service."""
    return _COMMAND.sub(lambda found: f"\\x{ord(found[0][0]):02x}{found[0][1:]}", printable(line))


def marked(text: str, indent: str = "    ") -> str:
    """Return a text for a terminal or a log: its lines harmless, and each but the first behind ``indent`` and a mark.

    A line that is marked already gets no second mark: a text may pass here twice on its way.
    """
    first, *others = text.splitlines() or [""]
    rest = textwrap.dedent("\n".join(others)).splitlines()
    return "\n".join([harmless(first), *(f"{indent}{MARK}{harmless(line.removeprefix(MARK))}" for line in rest)])


def folded(line: str, width: int) -> list[str]:
    """Break a line between words where it is wider than a terminal of ``width`` columns, which would break it within one.

    What follows is indented by two columns more than the line itself, and marked where the line is: no part of it begins as the
    kit's own lines do.
    """
    if len(line) <= width:
        return [line]
    indent = line[: len(line) - len(line.lstrip())]
    rest = f"{indent}{MARK if line.startswith(MARK, len(indent)) else '  '}"
    return textwrap.wrap(line, width, subsequent_indent=rest, break_on_hyphens=False)


def one_line(text: str) -> str:
    """Return a text as a harmless line."""
    return harmless(" ".join(text.split()))
