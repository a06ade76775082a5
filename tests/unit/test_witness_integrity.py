"""The witness is out of the adapter's reach: the control channel of a mock device, and what a mock says on standard error."""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from pytest_otmcp.errors import KitError, SubjectError
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.plant.owners import TOKEN_VARIABLE, new_token

pytestmark = pytest.mark.asyncio

INTRUDER = """
import socket, sys
while True:
    client = socket.socket(socket.AF_UNIX)
    try:
        client.connect(sys.argv[1])
        break
    except OSError:
        client.close()
client.sendall(b'{"id": 1, "op": "poke", "params": {"table": "coils", "address": 9, "values": [true]}}\\n')
client.makefile().readline()
if "goes" in sys.argv:
    client.close()
print("was there", flush=True)
sys.stdin.read()
"""
"""It tries until it is let in, which it is only while the kit has not asked for the channel; it changes the device."""


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The directory for temporary files of what a test starts; its path is short enough for a socket."""
    with tempfile.TemporaryDirectory(prefix="otmcp-t", dir="/tmp") as directory:
        monkeypatch.setenv("TMPDIR", directory)
        yield Path(directory)


def control_path(temporary: Path) -> str:
    """Find the control channel as an adapter could, which may list what its user may."""
    (directory,) = temporary.iterdir()
    return str(directory / "control")


@pytest.mark.parametrize("whose", ["adapter", "another"])
@pytest.mark.parametrize("then", ["stays", "goes"])
async def test_who_gets_hold_of_the_control_channel_is_told(temporary: Path, whose: str, then: str) -> None:
    device, token = MockDevice("modbus"), new_token()
    await device.launch()
    try:
        if whose == "adapter":
            device.sessions.begin(token, lambda: None)
        path = control_path(temporary)
        await device.stop()
        intruder = await asyncio.create_subprocess_exec(
            *(sys.executable, "-I", "-S", "-c", INTRUDER, path, then),
            env={**os.environ, TOKEN_VARIABLE: token},
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )
        assert intruder.stdout is not None
        try:
            await device._command("start")
            assert await intruder.stdout.readline() == b"was there\n"
            expected = SubjectError if whose == "adapter" else KitError
            with pytest.raises(expected, match=r"connected to the control channel of the modbus mock") as told:
                await device._ready()
            assert "python" in str(told.value)
        finally:
            intruder.kill()
            await intruder.wait()
    finally:
        await device.close()


async def test_nobody_reaches_the_control_channel_once_the_kit_has_it(temporary: Path) -> None:
    device = MockDevice("modbus")
    await device.launch()
    try:
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_unix_connection(control_path(temporary))
        assert await device.image()
    finally:
        await device.close()


def resident_kib() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") // 1024


@pytest.mark.long
async def test_what_a_mock_says_on_standard_error_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1] / "mocks"))
    device = MockDevice("thirdparty.talkative", "spindle")
    before = resident_kib()
    try:
        with pytest.raises(KitError, match="the spindle has stopped"):
            await device.launch()
        assert resident_kib() - before < 20_000
    finally:
        await device.close()
