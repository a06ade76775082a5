"""The primitive data of MQTT (5: section 1.5, 3.1.1: section 1.5): integers, strings, lengths, and the framing.

This file handles no packets. Bytes that it cannot read are a :class:`ProtocolViolation` of the peer.
"""

from __future__ import annotations

__all__ = ["Framer", "ProtocolViolation", "Reader", "binary", "string", "uint16", "uint32", "varint"]

MALFORMED_PACKET = 0x81
PACKET_TOO_LARGE = 0x95


class ProtocolViolation(Exception):
    """The peer broke the protocol; the connection must be closed (5: section 4.13, 3.1.1: section 4.8).

    Attributes:
        reason_code: the reason code for it in an MQTT 5 DISCONNECT or CONNACK.
    """

    def __init__(self, reason: str, reason_code: int = MALFORMED_PACKET) -> None:
        super().__init__(reason)
        self.reason_code = reason_code


class Reader:
    """A reader of one packet's bytes from front to back; reading beyond the end is a violation."""

    __slots__ = ("_at", "_data")

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def left(self) -> int:
        """Bytes not yet read."""
        return len(self._data) - self._at

    def take(self, count: int) -> bytes:
        """Read the next ``count`` bytes."""
        end = self._at + count
        if end > len(self._data):
            raise ProtocolViolation("the packet ends too early")
        taken = self._data[self._at : end]
        self._at = end
        return taken

    def rest(self) -> bytes:
        """Read everything that is left."""
        return self.take(self.left)

    def byte(self) -> int:
        """Read one byte."""
        return self.take(1)[0]

    def uint16(self) -> int:
        """Read a Two Byte Integer."""
        return int.from_bytes(self.take(2), "big")

    def uint32(self) -> int:
        """Read a Four Byte Integer."""
        return int.from_bytes(self.take(4), "big")

    def varint(self) -> int:
        """Read a Variable Byte Integer in as few bytes as possible [MQTT-1.5.5-1]."""
        value = shift = 0
        while True:
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            if not byte & 0x80:
                if byte == 0 and shift:
                    raise ProtocolViolation("a variable byte integer is longer than needed")
                return value
            shift += 7
            if shift > 21:
                raise ProtocolViolation("a variable byte integer has more than four bytes")

    def binary(self) -> bytes:
        """Read Binary Data with its length in front."""
        return self.take(self.uint16())

    def string(self) -> str:
        """Read a UTF-8 Encoded String: well-formed, without surrogates and U+0000 [MQTT-1.5.4-1, MQTT-1.5.4-2].

        U+FEFF is an ordinary character [MQTT-1.5.4-3].
        """
        try:
            text = self.binary().decode("utf-8")
        except UnicodeDecodeError:
            raise ProtocolViolation("a string is not well-formed UTF-8") from None
        if "\0" in text:
            raise ProtocolViolation("a string contains U+0000")
        return text

    def finish(self) -> None:
        """Check that nothing is left."""
        if self.left:
            raise ProtocolViolation(f"the packet has {self.left} bytes too many")


def uint16(value: int) -> bytes:
    """Return a Two Byte Integer."""
    return value.to_bytes(2, "big")


def uint32(value: int) -> bytes:
    """Return a Four Byte Integer."""
    return value.to_bytes(4, "big")


def varint(value: int) -> bytes:
    """Return a Variable Byte Integer."""
    if value < 0x80:
        return bytes((value,))
    encoded = bytearray()
    while value >= 0x80:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)


def binary(data: bytes) -> bytes:
    """Return Binary Data with its length in front."""
    return len(data).to_bytes(2, "big") + data


def string(text: str) -> bytes:
    """Return a UTF-8 Encoded String. Lone surrogates stand for bytes that are no UTF-8, which a poke may want to be sent."""
    return binary(text.encode("utf-8", "surrogateescape"))


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
