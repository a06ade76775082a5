"""Cuts recorded byte streams into frames, whatever segments they arrived in. Pure.

Each protocol says how long a frame is (:data:`FrameLength`), from as many of its first bytes as are there. A stream in
which no frame can begin is :class:`MalformedError`: from then on nothing in that direction can be trusted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

__all__ = ["Conversation", "FrameLength", "Framer", "MalformedError"]

FrameLength = Callable[[bytes | bytearray], int | None]
"""Length of the frame that the buffer begins with, None while too little of it is there.

Raises :class:`MalformedError` when no frame begins like that."""


class MalformedError(ValueError):
    """The stream cannot be cut any further.

    Attributes:
        reason: one sentence.
        data: what could not be cut.
    """

    def __init__(self, reason: str, data: bytes = b"") -> None:
        super().__init__(reason)
        self.reason = reason
        self.data = data


class Framer:
    """One direction of one connection."""

    def __init__(self, frame_length: FrameLength) -> None:
        self._frame_length = frame_length
        self._buffer = bytearray()

    @property
    def pending(self) -> bytes:
        """The beginning of a frame whose rest has not come yet."""
        return bytes(self._buffer)

    def feed(self, data: bytes) -> list[bytes]:
        """Add bytes, get the frames they complete.

        Raises:
            MalformedError: after frames that were whole have been returned by an earlier call, or when the very next
                bytes are no frame; :attr:`MalformedError.data` holds everything that was not cut.
        """
        self._buffer += data
        frames: list[bytes] = []
        begin = 0
        try:
            while begin < len(self._buffer):
                length = self._frame_length(self._buffer[begin:] if begin else self._buffer)
                if length is None or begin + length > len(self._buffer):
                    break
                frames.append(bytes(self._buffer[begin : begin + length]))
                begin += length
        except MalformedError as error:
            if not frames:
                raise MalformedError(error.reason, bytes(self._buffer)) from None
        finally:
            del self._buffer[:begin]
        return frames


class Conversation(Protocol):
    """Both directions of one connection, decoded frame by frame into journal entries."""

    def decode(self, direction: str, frame: bytes) -> list[dict[str, Any]]:
        """The entries of one frame: ``direction``, ``kind`` and the protocol's fields.

        Args:
            direction: ``in`` for what the device received, ``out`` for what it sent.

        A frame that cannot be decoded becomes an entry of kind ``malformed`` with ``bytes`` (hex) and ``reason``.
        """
        ...
