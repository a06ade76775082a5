"""A master for the DNP3 outstation that sends bytes as they are."""

from __future__ import annotations

import asyncio
import struct

from mock_program import PATIENCE_S
from raw_connection import RawConnection

__all__ = ["RawDnp3", "checksum", "crob", "link_frame"]


def checksum(data: bytes) -> bytes:
    """Return the CRC of a block by division, bit by bit: the polynomial is 3D65, the result inverted, the low byte first."""
    remainder = 0
    for byte in data:
        for bit in range(8):
            feedback = remainder >> 15 ^ byte >> bit & 1
            remainder = (remainder << 1 ^ (0x3D65 if feedback else 0)) & 0xFFFF
    return int(f"{remainder ^ 0xFFFF:016b}"[::-1], 2).to_bytes(2, "little")


def link_frame(data: bytes, *, control: int = 0xC4, destination: int = 10, source: int = 1) -> bytes:
    """Return a link frame."""
    header = struct.pack("<HBBHH", 0x6405, 5 + len(data), control, destination, source)
    blocks = (data[start : start + 16] for start in range(0, len(data), 16))
    return header + checksum(header) + b"".join(block + checksum(block) for block in blocks)


def crob(index: int, code: int, *, count: int = 1, status: int = 0) -> str:
    """Return a control relay output block with its header, in hexadecimal digits."""
    return "0c012801 00".replace(" ", "") + struct.pack("<HBBIIB", index, code, count, 100, 200, status).hex()


class RawDnp3(RawConnection):
    """One connection."""

    def __init__(self) -> None:
        self._transport = 0
        self.sequence = -1

    def send_fragment(self, fragment: bytes, **link: int) -> None:
        """Send an application fragment, in as many segments as it needs."""
        parts = [fragment[start : start + 249] for start in range(0, len(fragment), 249)]
        for number, part in enumerate(parts):
            head = 0x40 * (not number) | 0x80 * (number == len(parts) - 1) | self._transport
            self._transport = (self._transport + 1) & 0x3F
            self.writer.write(link_frame(bytes([head]) + part, **link))

    def send(self, request: str, *, sequence: int | None = None, **link: int) -> None:
        """Send a request, written as function code and objects in hexadecimal digits."""
        self.sequence = (self.sequence + 1) & 0x0F if sequence is None else sequence
        self.send_fragment(bytes([0xC0 | self.sequence]) + bytes.fromhex(request), **link)

    async def frame(self) -> tuple[int, bytes]:
        """Return control octet and data of the next frame; its check sums have to be right."""
        async with asyncio.timeout(PATIENCE_S):
            header = await self.reader.readexactly(10)
            assert header[:2] == b"\x05\x64"
            assert checksum(header[:8]) == header[8:]
            data, left = b"", header[2] - 5
            while left:
                size = min(left, 16)
                block = await self.reader.readexactly(size + 2)
                assert checksum(block[:-2]) == block[-2:]
                data, left = data + block[:-2], left - size
            return header[3], data

    async def fragment(self) -> bytes:
        """Return the next application fragment."""
        found = b""
        while True:
            control, data = await self.frame()
            assert control == 0x44
            found += data[1:]
            if data[0] & 0x80:
                return found

    async def ask(self, request: str, *, sequence: int | None = None) -> str:
        """Send a request; return internal indications and objects of its answer, in hexadecimal digits."""
        self.send(request, sequence=sequence)
        answer = await self.fragment()
        assert (answer[0] & 0x1F, answer[1]) == (self.sequence, 129)
        if answer[0] & 0x20:
            self.confirm(answer[0] & 0x0F)
        return answer[2:4].hex() + " " + answer[4:].hex()

    def confirm(self, sequence: int, *, unsolicited: bool = False) -> None:
        self.send_fragment(bytes([0xC0 | 0x10 * unsolicited | sequence, 0]))

    async def read(self) -> None:
        await self.ask("01 1e0000 0101")
