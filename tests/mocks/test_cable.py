"""A device on a cable, as adapters reach it: by hand, and through the kit's walls."""

from __future__ import annotations

import asyncio
import errno
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import psutil
import pytest
import pytest_asyncio
from mock_program import MockProgram

from pytest_otmcp.core.walls import AUTO, OFF
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.session.cable import cable_refused
from pytest_otmcp.session.isolation import Isolation
from pytest_otmcp.session.process import SubjectProcess

pytestmark = [
    pytest.mark.asyncio,
    pytest.mark.skipif(cable_refused() is not None, reason=f"no cable here: {cable_refused()}"),
]
CLIENT = Path(__file__).parent / "cable_client.py"


async def by_hand(program: MockProgram, *words: str) -> str:
    address = program.ready_event["endpoints"]["echo"]
    join = ["nsenter", "-t", str(address["join"]), "-U", "-n", "--preserve-credentials"]
    client = await asyncio.create_subprocess_exec(
        *join, sys.executable, str(CLIENT), address["path"], *words, stdout=subprocess.PIPE
    )
    return (await client.communicate())[0].decode().strip()


@pytest_asyncio.fixture
async def echo(start_mock: Callable[..., Awaitable[MockProgram]]) -> MockProgram:
    return await start_mock("thirdparty.echo")


async def test_frames_pass_and_the_cable_outlives_the_device(echo: MockProgram) -> None:
    address = echo.ready_event["endpoints"]["echo"]
    assert await by_hand(echo, "ping") == "ping otmcp0 ['lo', 'otmcp0']"
    echo.say("stop")
    await echo.event()
    assert await by_hand(echo, "lost") == "otmcp0 ['lo', 'otmcp0']"
    echo.say("start")
    await echo.ready()
    assert echo.ready_event["endpoints"]["echo"] == address
    assert await by_hand(echo, "more") == "more otmcp0 ['lo', 'otmcp0']"
    assert [entry["said"] for entry in await echo.control.journal(kind="ASK")] == ["more"]


async def test_an_adapter_that_looks_at_its_interface_first_finds_it_running(echo: MockProgram) -> None:
    # One cable in sixteen was not for its first second, and profi-dcp said that there is no interface of this address.
    join = ["nsenter", "-t", str(echo.ready_event["endpoints"]["echo"]["join"]), "-U", "-n", "--preserve-credentials"]
    look = "import psutil; print(psutil.net_if_stats()['otmcp0'].isup)"
    looking = await asyncio.create_subprocess_exec(*join, sys.executable, "-c", look, stdout=subprocess.PIPE)
    assert await looking.communicate() == (b"True\n", None)


async def test_a_cable_can_lose_what_is_sent(echo: MockProgram) -> None:
    await echo.control.poke(network="black_hole")
    assert await by_hand(echo, "lost") == "otmcp0 ['lo', 'otmcp0']"
    assert [entry["count"] for entry in await echo.control.journal(kind="lost")] == [60]


@pytest_asyncio.fixture(params=[AUTO, OFF])
async def walled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[MockDevice]:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    isolation, device = Isolation(request.param), MockDevice("thirdparty.echo")
    device.walls = isolation.walls(cable=True)
    try:
        await device.launch()
        yield device
    finally:
        await device.close()
        isolation.close()


async def test_an_adapter_behind_walls_has_the_cable_and_its_packet_sockets_are_known_as_its_own(
    walled: MockDevice,
) -> None:
    said: list[bytes] = []
    walled.sessions.expect()
    walled.sessions.begin("a-token", lambda: None)
    assert walled.walls is not None
    process: Any = await SubjectProcess.start(
        [sys.executable, str(CLIENT), walled.endpoints["echo"].path, "ping"],
        env={"PATH": os.environ["PATH"], "OTMCP_SESSION": "a-token"},
        cwd=Path.cwd(),
        on_line=lambda _, line: said.append(line),
        on_overflow=lambda _: None,
        walls=walled.walls.open_to(reads=(str(CLIENT),), writes=()),
    )
    await process.exited.wait()
    await process.settle()
    await process.stop(grace_s=1.0)
    assert said == [b"ping otmcp0 ['lo', 'otmcp0']"]
    [asked] = [entry for entry in (await walled.journal(0)).entries if entry["kind"] == "ASK"]
    assert asked["origin"] == "client"


async def test_a_device_on_a_cable_goes_before_other_programs() -> None:
    trying = await asyncio.create_subprocess_exec("nice", "-n", "-20", "true", stderr=subprocess.PIPE)
    may = await trying.communicate() == (None, b"")
    isolation, device = Isolation(AUTO), MockDevice("ethercat")
    device.walls = isolation.walls(cable=True)
    # Mocks of other tests may live in this process as long as their modules.
    others = psutil.Process().children(recursive=True)
    try:
        await device.launch()
        started = [each for each in psutil.Process().children(recursive=True) if each not in others]
        own = [each for each in started if "pytest_otmcp.mocks" in each.cmdline()]
        assert len(own) >= 2, "the launcher and the device"
        assert {each.nice() for each in own} == {-20 if may else 0}
    finally:
        await device.close()
        isolation.close()


REACHING = """
import os, socket, struct
from contextlib import suppress

NEW_LINK, GET_LINK, NAME, PEER_NETWORK, TARGET_NETWORK, LINK_INFO = 16, 18, 3, 37, 46, 18

def attribute(kind, data):
    return struct.pack("=HH", 4 + len(data), kind) + data + bytes(-len(data) % 4)

def ask(kind, flags, body):
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
        netlink.bind((0, 0))
        netlink.send(struct.pack("=IHHII", 16 + len(body), kind, flags | 0x1, 1, 0) + body)
        return netlink.recv(65536)[16:]

def link():
    return struct.pack("=BxHiII", 0, 0, 0, 0, 0)

def attributes(data):
    while data:
        size, kind = struct.unpack_from("=HH", data)
        yield kind, data[4:size]
        data = data[(size + 3) & ~3:]

there = dict(attributes(ask(GET_LINK, 0, link() + attribute(NAME, b"otmcp0" + bytes(1)))[16:]))[PEER_NETWORK]
kind = attribute(LINK_INFO, attribute(1, b"dummy" + bytes(1)))
for network in (b"", attribute(TARGET_NETWORK, there)):
    (code,) = struct.unpack_from("=i", ask(NEW_LINK, 0x604, link() + network + attribute(NAME, b"mine" + bytes(1)) + kind))
    print(os.strerror(-code), flush=True)
"""


async def test_an_adapter_sets_nothing_up_at_the_other_end(walled: MockDevice) -> None:
    said: list[bytes] = []
    assert walled.walls is not None
    process: Any = await SubjectProcess.start(
        [sys.executable, "-c", REACHING],
        env={"PATH": os.environ["PATH"]},
        cwd=Path.cwd(),
        on_line=lambda _, line: said.append(line),
        on_overflow=lambda _: None,
        walls=walled.walls,
    )
    await process.exited.wait()
    await process.settle()
    await process.stop(grace_s=1.0)
    assert said[1:] == [os.strerror(errno.EPERM).encode()]
    # At its own end it may, where the machine has such links.
    assert said[0] in (os.strerror(0).encode(), os.strerror(errno.EOPNOTSUPP).encode())
