"""What the kit learns of a mock device: everything that reached it, or that something is missing."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from pytest_otmcp.errors import KitError
from pytest_otmcp.plant.mock_device import MockDevice

pytestmark = pytest.mark.asyncio

WRITE = bytes.fromhex("0001 0000 0006 01 06 0001 002A")
CONNECT = b"\x10\x0d\x00\x04MQTT\x04\x02\x00\x3c\x00\x01x"
PUBLISH = b"\x30\x0e\x00\x0ccontrol/pump"


@asynccontextmanager
async def running(protocol: str) -> AsyncIterator[MockDevice]:
    device = MockDevice(protocol)
    await device.launch()
    try:
        yield device
    finally:
        await device.close()


@pytest.mark.parametrize(
    ("protocol", "sent", "expected"),
    [("modbus", WRITE, {"kind": "request", "function": 6}), ("mqtt", CONNECT + PUBLISH, {"kind": "PUBLISH"})],
    ids=["modbus", "mqtt"],
)
async def test_what_arrived_before_the_question_is_in_the_answer(
    protocol: str, sent: bytes, expected: dict[str, object]
) -> None:
    async with running(protocol) as device:
        mark = await device.mark()
        pid = (await device.ask("ready"))["pid"]
        # As if the machine had no time for the device: what a client sent, and the question, wait for it together.
        os.kill(pid, signal.SIGSTOP)
        try:
            with socket.create_connection((device.host, device.port)) as client:
                client.sendall(sent)
            asking = asyncio.create_task(device.journal(mark))
            for _ in range(3):
                await asyncio.sleep(0)
        finally:
            os.kill(pid, signal.SIGCONT)
        entries = (await asking).entries
    assert [entry for entry in entries if expected.items() <= entry.items()], entries


async def test_a_journal_that_has_forgotten_what_is_asked_for_says_so() -> None:
    async with running("modbus") as device:
        with socket.create_connection((device.host, device.port)) as client:
            client.sendall(WRITE)
            assert await device.wait(0, {"kind": "response"}, timeout_s=60.0)
        await device.wait(0, {"kind": "DISCONNECTED"}, timeout_s=60.0)
        assert (await device.journal(0)).entries
        mark = await device.mark()
        await device.forget(mark - 1)
        with pytest.raises(KitError, match=f"no longer goes back to entry 0: the oldest that it holds is {mark - 1}"):
            await device.journal(0)
        assert len((await device.journal(mark - 1)).entries) == 1
        await device.forget(mark)
        assert (await device.journal(mark)).entries == []
