"""The primitive data of MQTT (5: section 1.5, 3.1.1: section 1.5): integers, strings, and lengths.

This file handles no packets. Bytes that it cannot read are a :class:`ProtocolViolation` of the peer.
"""

from __future__ import annotations

from ..framing import MalformedError

__all__ = [
    "PACKET_TOO_LARGE",
    "ProtocolViolation",
    "Reader",
    "binary",
    "packet_length",
    "string",
    "uint16",
    "uint32",
    "varint",
]

MALFORMED_PACKET = 0x81
PACKET_TOO_LARGE = 0x95


class ProtocolViolation(MalformedError):
    """The peer broke the protocol; the connection must be closed (5: section 4.13, 3.1.1: section 4.8).

    Attributes:
        reason_code: the reason code for it in an MQTT 5 DISCONNECT or CONNACK.
    """

    def __init__(self, reason: str, reason_code: int = MALFORMED_PACKET) -> None:
        super().__init__(reason)
        self.reason_code = reason_code


def packet_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the control packet at the beginning of the buffer (section 2.2.3: Remaining Length).

    Raises:
        MalformedError: packet type 0, or a Remaining Length of more than four bytes.
    """
    length = 0
    for index, byte in enumerate(buffer[1:5]):
        length |= (byte & 0x7F) << (7 * index)
        if not byte & 0x80:
            if buffer[0] >> 4 == 0:
                raise MalformedError("packet type 0 is reserved")
            return 2 + index + length
    if len(buffer) >= 5:
        raise MalformedError("the Remaining Length has more than four bytes")
    return None


class Reader:
    """A reader of one packet's bytes from front to back; reading beyond the end is a violation.

    Attributes:
        lenient: show what is wrong in a string, with its bytes escaped, instead of refusing it.
    """

    __slots__ = ("_at", "_data", "lenient")

    def __init__(self, data: bytes, *, lenient: bool = False) -> None:
        self._data = data
        self._at = 0
        self.lenient = lenient

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
        if self.lenient:
            return self.binary().decode("utf-8", "backslashreplace")
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
