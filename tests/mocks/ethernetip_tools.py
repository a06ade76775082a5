"""A client of the Logix controller that sends bytes as they are."""

from __future__ import annotations

import asyncio
import struct

from mock_program import PATIENCE_S, MockProgram
from raw_connection import RawConnection

__all__ = ["CONNECTION_PATH", "RawEip", "cip", "forward_close", "forward_open", "frame", "multiple", "packet", "symbol"]

CONNECTION_PATH = "0100 2002 2401"
"""Port 1, link 0, then the message router."""


def frame(command: int, data: bytes = b"", *, session: int = 0, context: bytes = b"contexts", status: int = 0) -> bytes:
    """Return an encapsulation message."""
    return struct.pack("<HHII8sI", command, len(data), session, status, context, 0) + data


def packet(*items: tuple[int, bytes]) -> bytes:
    """Return a common packet."""
    return struct.pack("<IHH", 0, 0, len(items)) + b"".join(
        struct.pack("<HH", kind, len(content)) + content for kind, content in items
    )


def symbol(*names: str | int) -> bytes:
    """Return a path of names and indexes."""
    found = b""
    for name in names:
        if isinstance(name, int):
            found += bytes([0x28, name])
        else:
            found += bytes([0x91, len(name)]) + name.encode() + bytes(len(name) % 2)
    return found


def cip(service: int, path: bytes, data: str = "") -> bytes:
    """Return a request to the message router; its data is written in hexadecimal digits."""
    return bytes([service, len(path) // 2]) + path + bytes.fromhex(data)


def multiple(*requests: bytes) -> bytes:
    """Return a multiple service packet."""
    start = 2 + 2 * len(requests)
    offsets = [start + sum(map(len, requests[:number])) for number in range(len(requests))]
    body = struct.pack(f"<{1 + len(requests)}H", len(requests), *offsets) + b"".join(requests)
    return cip(0x0A, bytes.fromhex("20022401"), body.hex())


def forward_open(serial: int = 7, *, size: int = 500, transport: int = 0xA3, path: str = CONNECTION_PATH) -> bytes:
    """Return a forward open of the vendor 0x1234 with the serial number 99; answers come with the connection id 0x55."""
    route = bytes.fromhex(path)
    head = struct.pack("<BBIIHHIB3x", 10, 14, 0, 0x55, serial, 0x1234, 99, 3)
    wide = size > 511
    parameters = 0x42000000 | size if wide else 0x4200 | size
    intervals = struct.pack("<IIII" if wide else "<IHIH", 2_000_000, parameters, 2_000_000, parameters)
    body = head + intervals + bytes([transport, len(route) // 2]) + route
    return cip(0x5B if wide else 0x54, bytes.fromhex("20062401"), body.hex())


def forward_close(serial: int = 7) -> bytes:
    """Return the forward close of such a connection."""
    route = bytes.fromhex(CONNECTION_PATH)
    body = struct.pack("<BBHHIBB", 10, 14, serial, 0x1234, 99, len(route) // 2, 0) + route
    return cip(0x4E, bytes.fromhex("20062401"), body.hex())


class RawEip(RawConnection):
    """One connection."""

    def __init__(self) -> None:
        self.session = 0
        self.connection_id = 0
        self.count = 0

    async def open(self, program: MockProgram) -> None:
        """Connect, and register a session."""
        await self.dial(program)
        answer = await self.ask(frame(0x65, b"\x01\0\0\0"))
        self.session = int.from_bytes(answer[4:8], "little")

    async def join(self, serial: int = 7, *, size: int = 500) -> None:
        """Open a CIP connection."""
        answer = await self.unconnected(forward_open(serial, size=size))
        assert answer[2] == 0
        self.connection_id = int.from_bytes(answer[4:8], "little")

    async def frame(self) -> bytes:
        """Return the next frame."""
        async with asyncio.timeout(PATIENCE_S):
            head = await self.reader.readexactly(24)
            return head + await self.reader.readexactly(int.from_bytes(head[2:4], "little"))

    async def ask(self, message: bytes) -> bytes:
        """Send a frame and return the one that answers it."""
        self.writer.write(message)
        return await self.frame()

    def send(self, message: bytes) -> None:
        """Send a request without a connection."""
        data = packet((0, b""), (0xB2, message))
        self.writer.write(frame(0x6F, data, session=self.session))

    async def message(self) -> bytes:
        """Return the message of the next frame that answers a request without a connection."""
        answer = await self.frame()
        assert answer[:2] == b"\x6f\0"
        assert answer[12:20] == b"contexts"
        return answer[40:]

    async def unconnected(self, message: bytes) -> bytes:
        """Return the answer to a request without a connection."""
        self.send(message)
        return await self.message()

    def send_connected(self, message: bytes) -> None:
        """Send a request on the CIP connection, with the next sequence count."""
        self.count += 1
        content = struct.pack("<H", self.count) + message
        data = packet((0xA1, struct.pack("<I", self.connection_id)), (0xB1, content))
        self.writer.write(frame(0x70, data, session=self.session))

    async def connected(self, message: bytes) -> bytes:
        """Return the answer to a request on the CIP connection."""
        self.send_connected(message)
        answer = await self.frame()
        assert answer[36:40] == bytes.fromhex("55000000")
        assert int.from_bytes(answer[44:46], "little") == self.count
        return answer[46:]
