"""Whose connection is whose, at a mock device and at a tap: decided by the process at its other end, not by time."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import socket
import subprocess
import sys
import weakref
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
import pytest_asyncio

from pytest_otmcp.plant.device import Device
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.plant.owners import TOKEN_VARIABLE, Sessions, new_token
from pytest_otmcp.plant.tapped_device import TappedDevice
from pytest_otmcp.protocols.journal import judged
from pytest_otmcp.protocols.registry import protocols

pytestmark = pytest.mark.asyncio

READ = bytes.fromhex("0001 0000 0006 01 03 0001 0001")
WRITE = bytes.fromhex("0002 0000 0006 01 06 0001 002A")

CLIENT = """
import os, socket, sys
port, path = int(sys.argv[1]), sys.argv[2:]
if path:
    # By way of a program in between, as a launcher is.
    import subprocess
    sys.exit(subprocess.run([sys.executable, *path, str(port)], env={}).returncode)
for line in sys.stdin:
    word, *data = line.split()
    if word == "connect":
        connection = socket.create_connection(("127.0.0.1", port))
    elif word == "send":
        connection.sendall(bytes.fromhex(data[0]))
    elif word == "orphan":
        end, held = os.pipe()
        if os.fork():
            os._exit(0)
        os.setsid()
        # The parent has the other side open as long as it lives.
        os.close(held)
        os.read(end, 1)
    print(os.getpid() if word == "orphan" else word, flush=True)
"""


NESTED = ("unshare", "--user", "--map-root-user", "--pid", "--fork")
"""Starts a program in a namespace of processes of its own, as the one that begins a container does."""

NESTING = f"""
import os, sys
os.execvp("unshare", [*{NESTED!r}, sys.executable, "-c", {CLIENT!r}, sys.argv[-1]])
"""


def cannot_nest() -> str | None:
    """Why this machine lets no program have a namespace of processes of its own; None where it does."""
    if shutil.which("unshare") is None:
        return "there is no unshare(1)"
    tried = subprocess.run([*NESTED, "true"], capture_output=True, text=True, check=False)
    return tried.stderr.strip() or None if tried.returncode else None


@pytest_asyncio.fixture(params=["mock", "tap"])
async def device(request: pytest.FixtureRequest) -> AsyncIterator[Device]:
    """A Modbus device that tells by itself what it saw, and one behind a tap."""
    mock = MockDevice("modbus")
    await mock.launch()
    found: Device = mock
    if request.param == "tap":
        framing = protocols()["modbus"].framing
        assert framing is not None
        found = TappedDevice("device", next(iter(mock.endpoints.values())), framing)
        await found.launch()
    try:
        yield found
    finally:
        await found.close()
        await mock.close()


@asynccontextmanager
async def client(device: Device, *between: str, token: str | None = None) -> AsyncIterator[Process]:
    """A client of the device as a process of its own, which does what it is told in words."""
    environment = {**os.environ} | ({} if token is None else {TOKEN_VARIABLE: token})
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", CLIENT, str(device.port), *between), stdin=PIPE, stdout=PIPE, env=environment
    )
    try:
        yield process
    finally:
        assert process.stdin is not None
        process.stdin.close()
        await process.wait()
        # An orphan holds its parent's output until it has ended, too.
        assert process.stdout is not None
        await process.stdout.read()


async def told(process: Process, word: str, data: bytes = b"") -> str:
    """Tell the client a word; return its answer when it has done it."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{word} {data.hex()}\n".encode())
    return (await process.stdout.readline()).decode().strip()


async def requests(device: Device, count: int) -> list[Any]:
    """So many requests that have reached the device."""
    return await device.wait(0, {"kind": "request"}, count=count, timeout_s=60.0)


async def test_whoever_uses_a_device_without_an_adapter_under_test_is_its_client(device: Device) -> None:
    async with client(device) as someone:
        await told(someone, "connect")
        await told(someone, "send", READ)
        (request,) = await requests(device, 1)
    assert request["origin"] == "client"


@pytest.mark.parametrize("known_by", ["number", "token", "parents"])
async def test_the_process_of_a_session_is_known_by_its_number_its_token_and_its_parents(
    device: Device, known_by: str
) -> None:
    device.sessions.expect()
    token = new_token()
    between = ("-c", CLIENT) if known_by == "parents" else ()
    async with client(device, *between, token=token if known_by == "token" else None) as adapter:
        device.sessions.begin(token, lambda: None if known_by == "token" else adapter.pid)
        await told(adapter, "connect")
        await told(adapter, "send", READ)
        (request,) = await requests(device, 1)
        (connected,) = await device.wait(0, {"kind": "CONNECTED"}, timeout_s=60.0)
    assert (connected["origin"], request["origin"]) == ("client", "client")
    assert ("process" in connected, "process" in request) == (True, False)
    assert (connected["process"]["pid"] == adapter.pid) == (known_by != "parents")


async def test_a_descendant_in_a_namespace_of_its_own_is_known_by_its_parents(device: Device) -> None:
    if (reason := cannot_nest()) is not None:
        pytest.skip(reason)
    device.sessions.expect()
    async with client(device, "-c", NESTING) as adapter:
        device.sessions.begin(new_token(), lambda: adapter.pid)
        await told(adapter, "connect")
        await told(adapter, "send", READ)
        (request,) = await requests(device, 1)
        (connected,) = await device.wait(0, {"kind": "CONNECTED"}, timeout_s=60.0)
    assert (connected["origin"], request["origin"]) == ("client", "client")
    assert connected["process"]["name"].startswith("python")


async def test_who_is_in_a_namespace_and_descends_from_nobody_that_is_known_counts_as_unknown(device: Device) -> None:
    if (reason := cannot_nest()) is not None:
        pytest.skip(reason)
    device.sessions.expect()
    async with client(device, "-c", NESTING) as someone:
        await told(someone, "connect")
        await told(someone, "send", READ)
        (request,) = await requests(device, 1)
        (connected,) = await device.wait(0, {"kind": "CONNECTED"}, timeout_s=60.0)
    assert (connected["origin"], request["origin"]) == ("unknown", "client")
    assert "process" not in connected


async def test_who_is_in_a_namespace_as_an_adapter_of_another_device_is_a_stranger(device: Device) -> None:
    if (reason := cannot_nest()) is not None:
        pytest.skip(reason)
    device.sessions.expect()
    named = f"import os\nos.environ[{TOKEN_VARIABLE!r}] = {new_token()!r}\n{NESTING}"
    async with client(device, "-c", named) as someone:
        await told(someone, "connect")
        await told(someone, "send", READ)
        (request,) = await requests(device, 1)
    assert request["origin"] == "stranger"


async def test_a_descendant_that_has_lost_its_parents_is_known_by_the_token(device: Device) -> None:
    device.sessions.expect()
    token = new_token()
    async with client(device, token=token) as adapter:
        device.sessions.begin(token, lambda: adapter.pid)
        orphan = int(await told(adapter, "orphan"))
        assert orphan != adapter.pid
        await told(adapter, "connect")
        await told(adapter, "send", READ)
        (request,) = await requests(device, 1)
        (connected,) = await device.wait(0, {"kind": "CONNECTED"}, timeout_s=60.0)
    assert (request["origin"], connected["process"]["pid"]) == ("client", orphan)


async def test_another_program_is_a_stranger_and_named(device: Device) -> None:
    device.sessions.expect()
    async with client(device) as stranger:
        await told(stranger, "connect")
        await told(stranger, "send", b"GET / HTTP/1.1\r\n\r\n")
        (malformed,) = await device.wait(0, {"kind": "malformed"}, timeout_s=60.0)
    assert malformed["origin"] == "stranger"
    assert malformed["process"]["pid"] == stranger.pid
    assert malformed["process"]["name"].startswith("python")
    assert judged((await device.journal(0)).entries) == []


async def test_what_a_connection_brings_after_the_end_of_its_session_is_of_a_former_one(device: Device) -> None:
    device.sessions.expect()
    first, second = new_token(), new_token()
    async with client(device, token=first) as old, client(device, token=second) as new:
        device.sessions.begin(first, lambda: old.pid)
        await told(old, "connect")
        await told(old, "send", READ)
        await requests(device, 1)
        device.sessions.end(first)
        device.sessions.begin(second, lambda: new.pid)
        await told(old, "send", READ)
        await requests(device, 2)
        await told(new, "connect")
        await told(new, "send", READ)
        found = await requests(device, 3)
    assert [request["origin"] for request in found] == ["client", "former", "client"]
    assert found[1]["process"]["pid"] == old.pid
    assert [entry["seq"] for entry in judged(found)] == [found[0]["seq"], found[2]["seq"]]


async def test_a_descendant_with_the_token_of_a_session_that_is_over_is_of_the_one_that_runs(device: Device) -> None:
    device.sessions.expect()
    over, running = new_token(), new_token()
    async with client(device, token=over) as adapter:
        device.sessions.begin(over, lambda: None)
        device.sessions.end(over)
        device.sessions.begin(running, lambda: adapter.pid)
        await told(adapter, "connect")
        await told(adapter, "send", WRITE)
        (request,) = await requests(device, 1)
    assert request["origin"] == "client"


async def test_entries_of_strangers_are_not_what_is_waited_for(device: Device) -> None:
    device.sessions.expect()
    token = new_token()
    async with client(device) as stranger, client(device, token=token) as adapter:
        device.sessions.begin(token, lambda: adapter.pid)
        await told(stranger, "connect")
        for _ in range(3):
            await told(stranger, "send", READ)
        await requests(device, 3)
        waiting = asyncio.create_task(device.wait(0, {"origin": "client", "kind": "request"}, count=2, timeout_s=60.0))
        await told(adapter, "connect")
        await told(adapter, "send", READ)
        await told(stranger, "send", READ)
        await told(adapter, "send", WRITE)
        found = await waiting
        none = await device.wait(0, {"origin": "former"}, timeout_s=0.0)
    assert [(entry["origin"], entry["state_changing"]) for entry in found] == [("client", False), ("client", True)]
    assert none == []


@pytest.mark.parametrize(
    ("sent", "kind", "origin"), [(READ, "request", "client"), (b"GET / HTTP/1.1\r\n\r\n", "malformed", "unknown")]
)
async def test_one_that_is_gone_before_it_was_accepted_counts_as_far_as_it_speaks_the_protocol(
    sent: bytes, kind: str, origin: str
) -> None:
    device = MockDevice("modbus")
    await device.launch()
    try:
        device.sessions.expect()
        pid = (await device.ask("ready"))["pid"]
        os.kill(pid, signal.SIGSTOP)
        try:
            with socket.create_connection((device.host, device.port)) as connection:
                connection.sendall(sent)
        finally:
            os.kill(pid, signal.SIGCONT)
        (entry,) = await device.wait(0, {"kind": kind}, timeout_s=60.0)
        (connected,) = await device.wait(0, {"kind": "CONNECTED"}, timeout_s=60.0)
    finally:
        await device.close()
    assert (entry["origin"], "process" in entry) == (origin, False)
    assert connected["origin"] == "unknown"
    assert (entry in judged([entry])) == (origin == "client")


async def test_a_session_that_has_ended_is_not_kept() -> None:
    class Process:
        pid = 4711

    process = Process()
    ended = weakref.ref(process)
    sessions = Sessions()
    sessions.begin("token", lambda process=process: process.pid)
    sessions.end("token")
    del process
    assert ended() is None
