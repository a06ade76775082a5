"""Remote procedure calls without connection, which carry the acyclic services (The Open Group C706, chapter 12; IEC 61158-6-10, 4.10).

Fields of the header and of the array around the blocks have the byte order that the header says; blocks are big-endian in any case.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

from ..framing import MalformedError

__all__ = [
    "CONNECT",
    "CONTROL",
    "CONTROLLER_INTERFACE",
    "DEVICE_INTERFACE",
    "READ",
    "READ_IMPLICIT",
    "RELEASE",
    "WRITE",
    "Kind",
    "Rpc",
    "swapped",
]

CONNECT, RELEASE, READ, WRITE, CONTROL, READ_IMPLICIT = range(6)
"""Operations of both interfaces."""
DEVICE_INTERFACE = bytes.fromhex("dea000016c9711d1827100a02442df7d")
CONTROLLER_INTERFACE = bytes.fromhex("dea000026c9711d1827100a02442df7d")
_HEADER = 80
_LITTLE = 0x10
_IDEMPOTENT, _LAST = 0x20, 0x0A
_ANSWER_FLAGS = {2: _LAST, 6: _LAST}
_FRAGMENT = 0x04
_REJECTION = bytes.fromhex("1c010003")
"""nca_unk_if: the peer has no such interface."""


class Kind:
    """Types of packets."""

    REQUEST, PING, RESPONSE, FAULT, WORKING, NO_CALL, REJECT, ACK = range(8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rpc:
    """One packet that is a whole request or answer.

    Attributes:
        kind: see :class:`Kind`.
        operation: see above.
        sequence: number of the call within its activity.
        object: identifies the device: its instance, device and vendor identifier.
        interface, activity: identifiers as they are on the wire.
        little: the header is little-endian.
        boot: time of the server's start.
        maximum: bytes that an answer may have.
        status: PNIO status of an answer, 0 for success.
        blocks: arguments or results.
    """

    kind: int
    operation: int
    sequence: int
    object: bytes
    interface: bytes
    activity: bytes
    little: bool = False
    boot: int = 0
    maximum: int = 4100
    status: int = 0
    blocks: bytes = b""

    @classmethod
    def parse(cls, data: bytes) -> Rpc:
        """Read a packet.

        Raises:
            MalformedError: its lengths are wrong, or it is a part of a longer one.
        """
        if len(data) < _HEADER or data[0] != 4:
            raise MalformedError("no packet of a remote procedure call without connection")
        little = data[4] == _LITTLE
        order = "<" if little else ">"
        boot, _, sequence, operation, _, _, length, number = struct.unpack_from(f"{order}IIIHHHHH", data, 56)
        body = data[_HEADER : _HEADER + length]
        if len(body) < length:
            raise MalformedError(f"a call of {length} bytes of which {len(body)} are there")
        if data[2] & _FRAGMENT or number:
            raise MalformedError("a part of a call; calls in parts are not read")
        kind = data[1]
        first, status, blocks = 0, 0, b""
        if kind in (Kind.REQUEST, Kind.RESPONSE):
            if length < 20:
                raise MalformedError("a call without its array")
            first, count, _, _, actual = struct.unpack_from(f"{order}5I", body)
            blocks = body[20 : 20 + actual]
            if len(blocks) < actual or count != actual:
                raise MalformedError(f"an array of {actual} bytes of which {len(blocks)} are there")
        if kind == Kind.RESPONSE:
            first, status = 4100, first
        elif kind in (Kind.FAULT, Kind.REJECT) and length >= 4:
            (status,) = struct.unpack_from(f"{order}I", body)
        return cls(
            kind=kind,
            operation=operation,
            sequence=sequence,
            object=data[8:24],
            interface=data[24:40],
            activity=data[40:56],
            little=little,
            boot=boot,
            maximum=first,
            status=status,
            blocks=blocks,
        )

    def encoded(self) -> bytes:
        """Return the packet."""
        order = "<" if self.little else ">"
        length = len(self.blocks)
        if self.kind in (Kind.REQUEST, Kind.RESPONSE):
            first = self.maximum if self.kind == Kind.REQUEST else self.status
            limit = self.maximum if self.kind == Kind.REQUEST else length
            body = struct.pack(f"{order}5I", first, length, limit, 0, length) + self.blocks
        else:
            body = struct.pack(f"{order}I", self.status) if self.status else b""
        flags = _ANSWER_FLAGS.get(self.kind, _IDEMPOTENT)
        head = bytes([4, self.kind, flags, 0, _LITTLE if self.little else 0, 0, 0, 0])
        head += self.object + self.interface + self.activity
        number = struct.pack(
            f"{order}IIIHHHHH", self.boot, 1, self.sequence, self.operation, 0xFFFF, 0xFFFF, len(body), 0
        )
        return head + number + bytes(2) + body

    @property
    def called(self) -> bytes:
        """The interface in the order of its text, whatever the order of the header."""
        return swapped(self.interface) if self.little else self.interface

    def answered(self, blocks: bytes, status: int = 0, *, boot: int = 0) -> Rpc:
        """Return the response to this request."""
        return replace(self, kind=Kind.RESPONSE, blocks=blocks, status=status, boot=boot)

    def rejected(self) -> Rpc:
        """Return the packet that says that there is no such interface or operation."""
        return replace(self, kind=Kind.REJECT, blocks=b"", status=int.from_bytes(_REJECTION))


def swapped(identifier: bytes) -> bytes:
    """Return an identifier in the other order of bytes; of its five parts the first three have one."""
    return identifier[3::-1] + identifier[5:3:-1] + identifier[7:5:-1] + identifier[8:]
