"""Cyclic data: frames of RT class 1, which are the same in both directions."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ..framing import MalformedError

__all__ = ["FRAME_IDS", "GOOD", "RUNNING", "RtFrame"]

FRAME_IDS = range(0x8000, 0xFC00)
"""Frame identifiers of unicast frames of RT class 1 and 2."""
RUNNING = 0x35
"""Data status of a provider in order: primary, valid, running, no problem."""
_VALID = 0x04
GOOD = 0x80
"""Provider and consumer status of data that can be used."""
_TAIL = struct.Struct(">HBB")
_LEAST = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class RtFrame:
    """One cyclic frame.

    Attributes:
        frame_id: as agreed when the relation was made.
        data: of the subslots, with their status bytes, in the places that the relation says.
        counter: in steps of 31.25 µs.
        status: data status, see :data:`RUNNING`.
    """

    frame_id: int
    data: bytes
    counter: int
    status: int = RUNNING

    @classmethod
    def parse(cls, payload: bytes) -> RtFrame:
        """Read a frame from its identifier on.

        Raises:
            MalformedError: it is too short.
        """
        if len(payload) < 2 + _LEAST + _TAIL.size:
            raise MalformedError(f"a cyclic frame of {len(payload)} bytes")
        counter, status, _ = _TAIL.unpack(payload[-_TAIL.size :])
        return cls(frame_id=int.from_bytes(payload[:2]), data=payload[2 : -_TAIL.size], counter=counter, status=status)

    def encoded(self) -> bytes:
        """Return the frame, from its identifier on."""
        tail = _TAIL.pack(self.counter & 0xFFFF, self.status, 0)
        return self.frame_id.to_bytes(2) + self.data.ljust(_LEAST, b"\0") + tail

    @property
    def is_valid(self) -> bool:
        """Tell whether the provider vouches for the data."""
        return bool(self.status & _VALID)
