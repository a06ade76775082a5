"""Instants that are told as texts. Pure."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

__all__ = ["same_instant"]


def same_instant(found: object, value: str) -> bool:
    """Tell whether a text is this time, to the millisecond."""
    told, meant = _instant(found), _instant(value)
    return told is not None and meant is not None and abs(told - meant) < timedelta(milliseconds=1)


def _instant(text: object) -> datetime | None:
    if not isinstance(text, str):
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
