"""Limits of what is read from an adapter. Pure; knows no MCP library.

An adapter can send more than a machine has memory for. With these limits the kit stays below 400 MB, with all the copies that
checking, judging and recording make of a message.
"""

from __future__ import annotations

__all__ = ["MAX_FRAME_BYTES", "TOO_LARGE", "is_too_large"]

MAX_FRAME_BYTES = 4 * 1024 * 1024
"""Length of the longest message that is read to its end; no OT reply has a reason to be longer."""

_MAX_FRAME_VALUES = 200_000
"""Values that a message may have: an empty list takes two bytes in it, and a hundred in the memory of Python."""

TOO_LARGE = f"more than {MAX_FRAME_BYTES // 2**20} MiB or {_MAX_FRAME_VALUES} values"
"""The size of a message that the kit does not read; such a message ends the session."""


def is_too_large(frame: bytes) -> bool:
    """Tell, without reading it, whether a message is larger than the kit reads."""
    # Each value but the first comes after one of these. They may also stand in a text, of which none is that long.
    return len(frame) > MAX_FRAME_BYTES or (
        len(frame) > _MAX_FRAME_VALUES and sum(map(frame.count, (b",", b":", b"[", b"{"))) > _MAX_FRAME_VALUES
    )
