"""Frames of EtherNet/IP: the encapsulation header and the common packet format. It handles bytes only.

The layout is that of ODVA's volume 2, chapter 2, as the public developer guide of EtherNet/IP has it. All numbers are little-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ..framing import MalformedError

__all__ = [
    "CONNECTED_ADDRESS",
    "CONNECTED_DATA",
    "LIST_IDENTITY",
    "LIST_INTERFACES",
    "LIST_SERVICES",
    "NOP",
    "NULL_ADDRESS",
    "REGISTER",
    "SEND_RR_DATA",
    "SEND_UNIT_DATA",
    "UNCONNECTED_DATA",
    "UNREGISTER",
    "Frame",
    "frame_length",
    "packet",
    "packet_items",
]

NOP, LIST_SERVICES, LIST_IDENTITY, LIST_INTERFACES = 0x00, 0x04, 0x63, 0x64
REGISTER, UNREGISTER, SEND_RR_DATA, SEND_UNIT_DATA = 0x65, 0x66, 0x6F, 0x70

NULL_ADDRESS, CONNECTED_ADDRESS, CONNECTED_DATA, UNCONNECTED_DATA = 0x0000, 0x00A1, 0x00B1, 0x00B2

_HEADER = struct.Struct("<HHII8sI")
_LONGEST = 0x1FFF
"""More than the largest connection of a Logix controller, 4002 bytes, so that nothing that a client may send is refused."""


def frame_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the frame at the beginning of the buffer; None while too little of it has arrived.

    Raises:
        MalformedError: no frame begins like that.
    """
    if len(buffer) < 4:
        return None
    length = int.from_bytes(buffer[2:4], "little")
    if length > _LONGEST:
        raise MalformedError(f"encapsulation: {length} bytes of data")
    return _HEADER.size + length


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """An encapsulation message.

    Attributes:
        session: handle of the session, 0 for none.
        context: eight bytes that the answer repeats.
        status: of an answer; 0 for success.
    """

    command: int
    session: int = 0
    context: bytes = bytes(8)
    data: bytes = b""
    status: int = 0

    @classmethod
    def parse(cls, raw: bytes, *, answer: bool = False) -> Frame:
        """Read a message.

        Args:
            answer: it is a controller's, which may have a status.

        Raises:
            MalformedError: status or options of the header are not 0.
        """
        command, length, session, status, context, options = _HEADER.unpack_from(raw)
        if options or (status and not answer):
            raise MalformedError(f"encapsulation: status {status:X} and options {options:X} in its header")
        data = raw[_HEADER.size : _HEADER.size + length]
        return cls(command=command, session=session, context=context, data=data, status=status)

    def encoded(self) -> bytes:
        """Return the message as it is on the wire."""
        header = _HEADER.pack(self.command, len(self.data), self.session, self.status, self.context, 0)
        return header + self.data


def packet_items(data: bytes) -> list[tuple[int, bytes]] | None:
    """Return type and bytes of the items of a common packet, behind interface handle and timeout; None where it is none."""
    if len(data) < 8 or data[:4] != bytes(4):
        return None
    (count,) = struct.unpack_from("<H", data, 6)
    rest = data[8:]
    found = []
    for _ in range(count):
        if len(rest) < 4:
            return None
        kind, length = struct.unpack_from("<HH", rest)
        if len(rest) < 4 + length:
            return None
        found.append((kind, rest[4 : 4 + length]))
        rest = rest[4 + length :]
    return None if rest else found


def packet(*items: tuple[int, bytes]) -> bytes:
    """Return the common packet of these items, with interface handle and timeout 0."""
    parts = [struct.pack("<HH", kind, len(content)) + content for kind, content in items]
    return bytes(6) + struct.pack("<H", len(items)) + b"".join(parts)
