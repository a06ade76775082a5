"""A client that floods a device waits; the device goes on serving others, and its control channel answers."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import sys
from asyncio.subprocess import PIPE

import pytest

from mocks import network, peer
from pytest_otmcp.plant.mock_device import MockDevice

FLOOD = """
import socket, sys, threading
read = bytes.fromhex("0001 0000 0006 01 03 0001 0001")

def send(connection):
    while True:
        connection.sendall(read * 2000)

def receive(connection):
    while connection.recv(1 << 16):
        pass

for _ in range(4):
    connection = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
    for work in (send, receive):
        threading.Thread(target=work, args=(connection,), daemon=True).start()
sys.stdin.read()
"""
"""Sends requests by four connections as fast as possible, and reads all answers."""


@pytest.mark.long
@pytest.mark.asyncio
async def test_a_flooded_device_answers_its_control_channel_and_loses_nothing() -> None:
    device = MockDevice("modbus")
    await device.launch()
    try:
        flood = await asyncio.create_subprocess_exec(sys.executable, "-c", FLOOD, str(device.port), stdin=PIPE)
        try:
            since = 0
            # Beyond the burst that it takes at once. Nothing is dropped: else the journal would not go back to where it was read last.
            while since < 2 * network._BURST:
                journal = await device.journal(since)
                since = journal.next
                await device.forget(since)
        finally:
            flood.kill()
            await flood.wait()
    finally:
        await device.close()


def test_a_process_with_many_connections_is_found_without_a_look_at_all_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks = 0
    readlink = peer._link

    def counted(path: str) -> str | None:
        nonlocal looks
        looks += 1
        return readlink(path)

    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=400))
        ends = []
        for _ in range(300):
            mine = stack.enter_context(socket.create_connection(listener.getsockname()))
            ends.append((mine, stack.enter_context(listener.accept()[0])))

        def found(mine: socket.socket, theirs: socket.socket) -> int | None:
            process = peer.holder(peer._inode(socket.IPPROTO_TCP, mine.getsockname(), theirs.getsockname()))
            return None if process is None else process.pid

        assert found(*ends[0]) == os.getpid()
        monkeypatch.setattr(peer, "_link", counted)
        assert {found(*pair) for pair in ends} == {os.getpid()}
    assert looks < 10 * len(ends)
