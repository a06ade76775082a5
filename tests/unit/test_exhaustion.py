"""What the machine has run out of is told apart from what an adapter, or its command, does wrong."""

from __future__ import annotations

import asyncio
import errno
import os
import resource
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from pytest_otmcp.core.errors import ExhaustedError, KitError, MeddledError, SubjectError
from pytest_otmcp.core.exhaustion import exhausted
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.session import keeping
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.session.session import McpSession, SessionOptions

LACKS = [errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EAGAIN]
THREADLESS = RuntimeError("can't start new thread")


@contextmanager
def no_descriptor_left() -> Iterator[None]:
    """Take every file descriptor of this process that is free."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken: list[int] = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) + 20, hard))
    with suppress(OSError):
        while True:
            taken.append(os.open(os.devnull, os.O_RDONLY))
    try:
        yield
    finally:
        for number in taken:
            os.close(number)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


async def ask_until_it_ends(device: MockDevice) -> None:
    """Ask a device that is about to end; what it is asked before that it answers."""
    while True:
        await device.mark()


def session(*command: str, cwd: Path | None = None) -> McpSession:
    return McpSession(command, {}, cwd, SessionOptions(start_timeout_s=20.0))


@pytest.mark.parametrize("number", LACKS)
def test_what_is_lacking_is_said_with_what_helps(number: int) -> None:
    found = exhausted(OSError(number, os.strerror(number)))
    assert found is not None
    assert "; " in found
    assert exhausted(ExceptionGroup("several", [ValueError(), OSError(number, "")])) == found


def test_memory_and_threads_can_be_lacking_too() -> None:
    assert exhausted(MemoryError()) == exhausted(OSError(errno.ENOMEM, ""))
    assert exhausted(THREADLESS) == exhausted(OSError(errno.EAGAIN, ""))


@pytest.mark.parametrize("error", [FileNotFoundError(errno.ENOENT, ""), RuntimeError("a bug"), ValueError(), OSError()])
def test_other_errors_are_not_the_machines(error: Exception) -> None:
    assert exhausted(error) is None


@pytest.mark.asyncio
async def test_a_session_that_finds_no_descriptor_is_no_fault_of_the_adapter() -> None:
    under_test = session(sys.executable, "-c", "pass")
    with no_descriptor_left(), pytest.raises(ExhaustedError, match=r"could not be started: .* `ulimit -n 1024`"):
        await under_test.open()


@pytest.mark.asyncio
async def test_a_mock_that_finds_no_descriptor_is_no_bug() -> None:
    device = MockDevice("modbus")
    with no_descriptor_left(), pytest.raises(ExhaustedError, match="the modbus mock could not be started: "):
        await device.launch()


@pytest.mark.asyncio
@pytest.mark.parametrize("number", [*LACKS, None, errno.EIO, errno.E2BIG])
async def test_a_process_that_the_system_refuses_is_no_fault_of_the_adapter(
    number: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        raise THREADLESS if number is None else OSError(number, os.strerror(number))

    monkeypatch.setattr(keeping.subprocess, "Popen", refuse)
    monkeypatch.setattr(keeping, "_PLAIN", keeping.Keeper())
    with pytest.raises(KitError) as refused:
        await session("adapter").open()
    assert isinstance(refused.value, ExhaustedError) == (number not in (errno.EIO, errno.E2BIG))


@pytest.mark.asyncio
async def test_a_command_that_is_wrong_is_the_adapters(tmp_path: Path) -> None:
    forbidden, unknown = tmp_path / "forbidden", tmp_path / "unknown"
    forbidden.write_text("#!/bin/sh\n")
    unknown.write_text("no program")
    unknown.chmod(0o755)
    for command in (tmp_path / "nowhere", forbidden, unknown, forbidden / "inside"):
        with pytest.raises(SubjectError) as refused:
            await session(str(command)).open()
        assert refused.value.code == "cannot_start"


@pytest.mark.asyncio
async def test_a_device_that_cannot_accept_any_more_ends_and_says_why() -> None:
    device = MockDevice("modbus")
    await device.launch()
    try:
        pid = (await device.ask("ready"))["pid"]
        # Those that it has stay open.
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (3, 3))
        with socket.create_connection((device.host, device.port)), pytest.raises(ExhaustedError) as ended:
            await ask_until_it_ends(device)
        assert "the modbus mock ended because it has no file descriptors or memory left" in str(ended.value)
        with pytest.raises(ExhaustedError):
            await device.mark()
    finally:
        await device.close()


@pytest.mark.asyncio
async def test_a_device_that_was_killed_has_run_out_of_nothing() -> None:
    device = MockDevice("modbus")
    await device.launch()
    try:
        os.kill((await device.ask("ready"))["pid"], 9)
        with pytest.raises(MeddledError, match="the modbus mock was killed by another program, as an adapter can do"):
            await ask_until_it_ends(device)
    finally:
        await device.close()


def test_a_loop_that_cannot_accept_a_connection_tells_when_it_is_asked() -> None:
    thread = LoopThread()

    async def serve() -> tuple[asyncio.Server, int]:
        server = await asyncio.get_running_loop().create_server(asyncio.Protocol, "127.0.0.1", 0)
        return server, server.sockets[0].getsockname()[1]

    async def turns() -> None:
        for _ in range(3):
            await asyncio.sleep(0)

    server, port = thread.run(serve())
    try:
        thread.check()
        with socket.socket() as client, no_descriptor_left():
            client.connect(("127.0.0.1", port))
            thread.run(turns())
            with pytest.raises(ExhaustedError, match="ulimit"):
                thread.check()
        thread.check()
    finally:
        server.get_loop().call_soon_threadsafe(server.close)
        thread.close()
