"""A client of the BACnet mock that sends bytes, for tests that other clients' libraries would not let write what they need."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

from mock_program import PATIENCE_S, MockProgram

__all__ = ["BacnetPeer", "bacnet_peer"]

GET_OBJECT_LIST = "0c 0c02003039 194c"


class BacnetPeer(asyncio.DatagramProtocol):
    """A UDP socket that talks to one mock device."""

    def __init__(self) -> None:
        self.received: asyncio.Queue[bytes] = asyncio.Queue()
        self.transport: asyncio.DatagramTransport

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.received.put_nowait(data)

    def send(self, apdu: str, *, npdu: str = "0104", function: int = 0x0A) -> None:
        """Send an APDU, written in hexadecimal digits."""
        body = bytes.fromhex(npdu) + bytes.fromhex(apdu)
        self.transport.sendto(bytes([0x81, function]) + (4 + len(body)).to_bytes(2) + body)

    async def answer(self) -> str:
        """Return the next datagram behind its BVLC header, in hexadecimal digits."""
        datagram = await asyncio.wait_for(self.received.get(), PATIENCE_S)
        assert datagram[0] == 0x81
        assert int.from_bytes(datagram[2:4]) == len(datagram)
        return datagram[4:].hex()

    async def ask(self, apdu: str) -> str:
        """Send an APDU and return the APDU that answers it."""
        self.send(apdu)
        answer = await self.answer()
        assert answer.startswith("0100")
        return answer[4:]


@contextlib.asynccontextmanager
async def bacnet_peer(program: MockProgram) -> AsyncIterator[BacnetPeer]:
    """A peer of this mock."""
    transport, peer = await asyncio.get_running_loop().create_datagram_endpoint(
        BacnetPeer, remote_addr=(program.host, program.port)
    )
    try:
        yield peer
    finally:
        transport.close()
