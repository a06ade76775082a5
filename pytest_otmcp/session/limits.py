"""Limits of what is read from an adapter. Pure; knows no MCP library.

An adapter can send more than a machine has memory for. With these limits the kit stays below 400 MB, with all the copies that
checking, judging and recording make of a message.
"""

from __future__ import annotations

__all__ = ["MAX_FRAME_BYTES", "TOO_LARGE", "Allowance", "is_too_large"]

MAX_FRAME_BYTES = 4 * 1024 * 1024
"""Length of the longest message that is read to its end; no OT reply has a reason to be longer."""

_MAX_FRAME_VALUES = 200_000
"""Values that a message may have: an empty list takes two bytes in it, and a hundred in the memory of Python."""

_MAX_TOGETHER_BYTES = 32 * 1024 * 1024
_MAX_TOGETHER_VALUES = 800_000
"""What the large answers of one repetition may have together: they are kept until the repetition has been judged. Measured: fifty
of the largest took 724 MB without this bound."""

_SMALL_BYTES = 16 * 1024
"""Length up to which an answer counts for nothing: a long repetition has thousands of these."""

TOO_LARGE = (
    f"a message of more than {MAX_FRAME_BYTES // 2**20} MiB or {_MAX_FRAME_VALUES} values, or answers with more than "
    f"{_MAX_TOGETHER_BYTES // 2**20} MiB or {_MAX_TOGETHER_VALUES} values together"
)
"""What the kit does not read; it ends the session."""


class Allowance:
    """The room for answers that are kept at the same time: those to the calls of one repetition, or the pages of a list of tools."""

    def __init__(self) -> None:
        self._bytes = 0
        self._values = 0

    def renew(self) -> None:
        """Give all the room back: what took it is no longer kept."""
        self._bytes = self._values = 0

    def has_room_for(self, frame: bytes) -> bool:
        """Take the room that an answer needs; return whether there was so much."""
        if len(frame) > _SMALL_BYTES:
            self._bytes += len(frame)
            self._values += _values(frame)
        return self._bytes <= _MAX_TOGETHER_BYTES and self._values <= _MAX_TOGETHER_VALUES


def is_too_large(frame: bytes) -> bool:
    """Tell, without reading it, whether a message is larger than the kit reads."""
    return len(frame) > MAX_FRAME_BYTES or (len(frame) > _MAX_FRAME_VALUES and _values(frame) > _MAX_FRAME_VALUES)


def _values(frame: bytes) -> int:
    # Each value but the first comes after one of these. They may also stand in a text, of which none is that long.
    return sum(map(frame.count, (b",", b":", b"[", b"{")))
