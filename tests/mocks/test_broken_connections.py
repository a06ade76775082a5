"""Clients that are gone before they have been answered."""

from __future__ import annotations

import os
import signal
import socket
import struct

import pytest
from mock_program import MockProgram
from mqtt_tools import connect_bytes, frame

REQUESTS = {
    "modbus": b"\0\1\0\0\0\6\1\3\0\0\0\1" * 50,
    "mqtt": connect_bytes("gone") + frame(0xC0) * 50,
}
"""Requests that a client sends at once, by the mock that answers each of them."""


@pytest.mark.asyncio
@pytest.mark.parametrize("mock", REQUESTS)
async def test_a_client_that_resets_its_connection_leaves_no_word_on_stderr(mock: str) -> None:
    program = await MockProgram.start(mock)
    await program.ready()
    device = int(program.ready_event["pid"])
    with socket.create_connection((program.host, program.port)) as client:
        await program.control.wait(kind="CONNECTED")
        # The device finds the requests and the end at once when it goes on.
        os.kill(device, signal.SIGSTOP)
        client.sendall(REQUESTS[mock])
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    os.kill(device, signal.SIGCONT)
    await program.control.wait(kind="DISCONNECTED")
    assert await program.end() == (0, "")
