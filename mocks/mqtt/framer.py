"""The stream of a client, cut into packets."""

from __future__ import annotations

from pytest_otmcp.wire.mqtt.primitives import PACKET_TOO_LARGE, ProtocolViolation

__all__ = ["Framer"]


class Framer:
    """A framer that cuts a byte stream into packets: fixed header byte and body.

    Attributes:
        frame: bytes of the newest whole packet.
        minimal: True when a remaining length in more bytes than needed is a violation, as in MQTT 5 but not in 3.1.1.
    """

    def __init__(self, maximum_packet_size: int | None = None) -> None:
        self._buffer = bytearray()
        self._maximum = maximum_packet_size
        self.frame = b""
        self.minimal = False

    def feed(self, data: bytes) -> None:
        """Add bytes that have arrived."""
        self._buffer += data

    def next(self) -> tuple[int, bytes] | None:
        """Return the next whole packet, None while it is incomplete.

        Raises:
            ProtocolViolation: the remaining length has five bytes, or the packet is larger than agreed.
        """
        buffer = self._buffer
        remaining = 0
        for index in range(1, 5):
            if index >= len(buffer):
                return None
            byte = buffer[index]
            remaining |= (byte & 0x7F) << 7 * (index - 1)
            if byte & 0x80:
                continue
            if self.minimal and byte == 0 and index > 1:
                raise ProtocolViolation("the remaining length is longer than needed")
            end = index + 1 + remaining
            if self._maximum is not None and end > self._maximum:
                raise ProtocolViolation("the packet is larger than the maximum packet size", PACKET_TOO_LARGE)
            if end > len(buffer):
                return None
            self.frame = bytes(buffer[:end])
            del buffer[:end]
            return self.frame[0], self.frame[index + 1 :]
        raise ProtocolViolation("the remaining length has more than four bytes")

    @property
    def held(self) -> bytes:
        """The first bytes that are not yet a packet, for the journal."""
        return bytes(self._buffer[:64])
