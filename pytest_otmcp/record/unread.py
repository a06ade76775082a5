"""Replies whose bytes a record does not have, so that nobody can read them again. Pure."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

from .schema import Item

__all__ = ["is_unread", "unread_replies"]


def is_unread(call: Mapping[str, Any]) -> bool:
    """Tell whether the frames of a call are recorded with less than their bytes: cut off, without a secret, or with bytes that are no text."""
    frames = call.get("frames")
    if frames is None or frames["response"] is None:
        return False
    content: bytes = frames["request"].encode() + b"\n" + frames["response"].encode()
    stated: str | None = call.get("frames_sha256")
    return hashlib.sha256(content).hexdigest() != stated


def unread_replies(items: Iterable[Item]) -> int:
    """Count the replies of these items that nobody can read again."""
    return sum(
        is_unread(call) for item in items for part in (*item["around"], *item["samples"]) for call in part["calls"]
    )
