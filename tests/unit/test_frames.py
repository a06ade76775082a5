"""Whose a frame on a cable is, where several packet sockets are open."""

from __future__ import annotations

import asyncio
import io
import socket

import pytest
from pytest_otmcp.mocks.cable import CableEnd
from pytest_otmcp.mocks.frames import Frames
from pytest_otmcp.mocks.journal import Journal

PROFINET = 0x8892
FRAME = bytes(12) + PROFINET.to_bytes(2) + bytes(46)


class Listed(io.BytesIO):
    """The kernel's list of packet sockets: inodes in the order in which they were opened, and the bytes that they hold."""

    def show(self, *inodes: int, held: int = 0) -> None:
        rows = [f"sk 3 3 {PROFINET:04x} 2 1 {held} 0 {inode}\n" for inode in inodes]
        self.seek(0)
        self.truncate()
        self.write(("head\n" + "".join(rows)).encode())


@pytest.mark.asyncio
async def test_a_frame_is_of_the_socket_that_was_opened_last_whichever_inode_it_has() -> None:
    told: asyncio.Queue[int] = asyncio.Queue()
    frames, sockets = Frames(Journal(), PROFINET, lambda number, frame: told.put_nowait(number)), Listed()
    client, device = socket.socketpair(type=socket.SOCK_DGRAM)
    device.setblocking(False)
    with client:
        frames.open(CableEnd(socket=device, mac=bytes(6), sockets=sockets))
        numbers = []
        for inodes, held in (
            ((500,), 0),
            ((500, 40), 0),
            ((500, 40), 768),
            ((500,), 0),
            ((500, 30, 600), 0),
            ((500, 30), 0),
        ):
            sockets.show(*inodes, held=held)
            client.send(FRAME)
            numbers.append(await asyncio.wait_for(told.get(), 60))
        frames.close()
    assert numbers == [1, 2, 2, 1, 4, 3]
