"""Framing: recorded byte streams, which arrive in segments of any size, are cut into frames. Pure.

Each protocol that runs over streams says how long a frame is (:data:`FrameLength`), from the first bytes of the frame that
have arrived. Where no frame can begin, the stream is malformed: from there on nothing in that direction can be trusted. A
datagram is a frame already.
"""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["FrameLength", "Framer", "MalformedError"]

FrameLength = Callable[[bytes | bytearray], int | None]
"""Returns the length of the frame at the beginning of the buffer; None while too little of it has arrived.

Raises :class:`MalformedError` when no frame begins like that."""


class MalformedError(ValueError):
    """The bytes are not what the protocol allows; the message is one sentence."""


class Framer:
    """The framer of one direction of one connection.

    Attributes:
        malformed: the reason why no further frame can be cut, or None; :attr:`pending` holds the bytes that were not cut.
    """

    def __init__(self, frame_length: FrameLength) -> None:
        self._frame_length = frame_length
        self._buffer = bytearray()
        self.malformed: str | None = None

    @property
    def pending(self) -> bytes:
        """The beginning of a frame whose rest has not arrived yet."""
        return bytes(self._buffer)

    def feed(self, data: bytes) -> list[bytes]:
        """Add bytes; return the frames that they complete, and none once the stream is malformed."""
        self._buffer += data
        frames: list[bytes] = []
        while self._buffer and self.malformed is None:
            try:
                length = self._frame_length(self._buffer)
            except MalformedError as error:
                self.malformed = str(error)
                break
            if length is None or length > len(self._buffer):
                break
            frames.append(bytes(self._buffer[:length]))
            del self._buffer[:length]
        return frames
