"""A conversation in two columns of a terminal: what host and adapter say, beside what the device sees. Pure."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from itertools import zip_longest

from .exchange import Event
from .text import printable

__all__ = ["lanes"]

_CLOCK = 9
"""Width of the column of times: milliseconds up to 99999.99 and a blank."""

_BETWEEN = " | "
_NARROWEST = 16
"""A column is never narrower, so that a line may be longer than a very narrow terminal."""


def lanes(events: Iterable[Event | int], adapter: str, device: str, width: int) -> list[str]:
    """Return the lines of a conversation, in order of time, with texts from outside made printable.

    Args:
        events: of :func:`~pytest_otmcp.report.exchange.conversation`.
        adapter, device: headings of the two columns.
        width: of a line, in characters.
    """
    column = max((width - _CLOCK - len(_BETWEEN)) // 2, _NARROWEST)
    lines = [*_row("ms", [adapter], [device], column), "-" * (_CLOCK + 2 * column + len(_BETWEEN))]
    for event in events:
        if isinstance(event, int):
            lines += _row("", [f"({event} more)"], [], column)
            continue
        clock = "" if event.at_ms is None else f"{event.at_ms:.2f}"
        shown = _shown(event, column)
        lines += _row(clock, shown, [], column) if event.lane == "adapter" else _row(clock, [], shown, column)
    return lines


def _shown(event: Event, column: int) -> list[str]:
    text = (
        f"{'->' if event.towards else '<-'} {event.what}{' (changes the device)' if event.changes else ''} {event.text}"
    )
    return textwrap.wrap(printable(text), column, subsequent_indent="   ", break_on_hyphens=False)


def _row(clock: str, left: list[str], right: list[str], column: int) -> list[str]:
    rows = zip_longest([clock], left, right, fillvalue="")
    return [f"{at:>{_CLOCK - 1}} {one:<{column}}{_BETWEEN}{other}".rstrip() for at, one, other in rows]
