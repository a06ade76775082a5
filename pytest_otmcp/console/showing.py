"""What a page is told of a journal's row and of a call. Pure.

Texts of the adapter and of the device go to the page as they are, cut off where they are long; the page shows them as text.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

from ..core.strict_json import parse_strict, same_json
from ..report.exchange import conversation
from ..report.text import clipped
from ..session.exchange import Exchange
from .reading import Claim
from .witness import Row

__all__ = ["shown_call", "shown_row"]

_LONGEST = 16_384
"""Characters that are shown of a frame or of a reply."""


def shown_row(protocol: str, row: Row) -> dict[str, object]:
    """Return one entry of a journal for the page."""
    [event] = conversation([], [{"protocol": protocol, **row.entry}])
    assert not isinstance(event, int)
    return {
        "name": row.name,
        "generation": row.generation,
        "at_ms": row.entry["t_ns"] / 1e6,
        "origin": row.entry["origin"],
        "towards": event.towards,
        "what": event.what,
        "text": event.text,
        "changes": event.changes,
        "bad": event.bad,
    }


def shown_call(exchange: Exchange, claimed: Claim, own: Sequence[Row]) -> dict[str, object]:
    """Return one call for the page: reply, frames with their times, and the names of its own rows."""
    return {
        "tool": exchange.tool,
        "arguments": json.dumps(exchange.arguments, ensure_ascii=False),
        "claim": claimed.words,
        "success": claimed.success,
        "reply": clipped(_pretty(claimed.document), _LONGEST),
        "text": "" if _repeats(claimed) else clipped(claimed.text, _LONGEST),
        "request": _frame(exchange.request),
        "response": _frame(exchange.response),
        "at_ms": exchange.sent_ns / 1e6,
        "latency_ms": exchange.latency_ms,
        "own": [row.name for row in own],
    }


def _repeats(claimed: Claim) -> bool:
    """Tell whether the text says nothing but the document, as MCP advises."""
    try:
        return same_json(parse_strict(claimed.text), claimed.document)
    except ValueError:
        return False


def _frame(frame: bytes | None) -> str:
    if not frame:
        return ""
    try:
        text = _pretty(json.loads(frame))
    except (ValueError, RecursionError):
        text = frame.decode("utf-8", "backslashreplace")
    return clipped(text, _LONGEST)


def _pretty(document: object) -> str:
    return "" if document is None else json.dumps(document, ensure_ascii=False, indent=2)
