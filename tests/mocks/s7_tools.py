"""A client of the S7 controller that sends bytes as they are."""

from __future__ import annotations

import asyncio
import struct
from typing import Any

from mock_program import PATIENCE_S, MockProgram
from raw_connection import RawConnection

__all__ = ["RawS7", "areas", "frame", "item", "job", "user_data"]


def frame(tpdu: bytes) -> bytes:
    return struct.pack(">BBH", 3, 0, 4 + len(tpdu)) + tpdu


def item(area: int, db: int, byte: int, *, bit: int = 0, transport: int = 2, count: int = 1) -> bytes:
    """Return the address of a variable."""
    return struct.pack(">BBBBHHB", 0x12, 0x0A, 0x10, transport, count, db, area) + (8 * byte + bit).to_bytes(3)


def job(parameters: bytes, data: bytes = b"", *, reference: int = 7, rosctr: int = 1) -> bytes:
    """Return a job PDU."""
    return struct.pack(">BBHHHH", 0x32, rosctr, 0, reference, len(parameters), len(data)) + parameters + data


def user_data(group: int, subfunction: int, data: bytes, reference: int = 7) -> bytes:
    """Return a user data PDU."""
    head = bytes([0, 1, 0x12, 4, 0x11, 0x40 | group, subfunction, 0])
    code, kind = (0xFF, 9) if data else (0x0A, 0)
    return job(head, struct.pack(">BBH", code, kind, len(data)) + data, reference=reference, rosctr=7)


class RawS7(RawConnection):
    """One connection."""

    async def connect(self, program: MockProgram, *, tsap: str = "0101") -> bytes:
        """Connect by TCP and COTP; return what the controller answers."""
        await self.dial(program)
        parameters = bytes.fromhex("c0010a c1020100 c202" + tsap)
        self.writer.write(frame(struct.pack(">BBHHB", 6 + len(parameters), 0xE0, 0, 9, 0) + parameters))
        return await self.tpdu()

    async def open(self, program: MockProgram, *, pdu_size: int = 480) -> int:
        """Connect, and agree on a PDU; return its size."""
        await self.connect(program)
        answer = await self.ask(job(struct.pack(">BBHHH", 0xF0, 0, 1, 1, pdu_size)))
        return int.from_bytes(answer[-2:])

    async def tpdu(self) -> bytes:
        """Return the next TPDU."""
        async with asyncio.timeout(PATIENCE_S):
            head = await self.reader.readexactly(4)
            return await self.reader.readexactly(int.from_bytes(head[2:]) - 4)

    def send(self, pdu: bytes) -> None:
        self.writer.write(frame(b"\x02\xf0\x80" + pdu))

    async def pdu(self) -> bytes:
        """Return the next PDU."""
        return (await self.tpdu())[3:]

    async def ask(self, pdu: bytes) -> bytes:
        """Send a PDU and return its answer."""
        self.send(pdu)
        return await self.pdu()

    async def read(self, *items: bytes) -> str:
        """Return the data of a read's answer, or its error, in hexadecimal digits."""
        return self.data(await self.ask(job(bytes([4, len(items)]) + b"".join(items))))

    async def write(self, address: bytes, transport: int, length: int, content: str) -> str:
        data = struct.pack(">BBH", 0, transport, length) + bytes.fromhex(content)
        return self.data(await self.ask(job(b"\x05\x01" + address, data)))

    @staticmethod
    def data(answer: bytes) -> str:
        parameters, error = int.from_bytes(answer[6:8]), answer[10:12]
        return f"error {error.hex()}" if any(error) else answer[12 + parameters :].hex()


async def areas(program: MockProgram) -> dict[str, Any]:
    """Return the areas of the image as bytes."""
    return {name: bytes.fromhex(text) for name, text in (await program.control.image())["areas"].items()}
