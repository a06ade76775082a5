"""A process that the machine does not let run is not held to have ignored the end of its stdin, or to start too late.

What the kernel counts is replaced by a count of the test's: which share of a processor a process gets is the kernel's affair, and
differs from machine to machine.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pytest_otmcp.core.errors import KitError, SubjectError
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.session import starvation
from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.session.process import StopReport, SubjectProcess, subject_environment
from pytest_otmcp.session.session import McpSession, SessionOptions
from pytest_otmcp.session.starvation import Patience

GRACE_S = 0.3
START_S = 1.0
PATIENCE_S = 60.0
"""Seconds for what comes sooner on any machine."""

LATE_S = 2 * START_S
"""Seconds: later than each of these times allows."""

ENDS_LATE = """
import sys, time
print(flush=True)
sys.stdin.read()
time.sleep(float(sys.argv[1]))
"""

SERVES_LATE = """
import json, sys, time
late = float(sys.argv[1])
if not sys.argv[2:]:
    time.sleep(late)
about = {"protocolVersion": "2025-06-18", "capabilities": {"tools": {}}, "serverInfo": {"name": "late", "version": "1"}}
for line in sys.stdin:
    asked = json.loads(line)
    if "id" in asked:
        result = about if asked["method"] == "initialize" else {"tools": [], "content": []}
        if asked["method"] == "tools/call":
            time.sleep(late)
        print(json.dumps({"jsonrpc": "2.0", "id": asked["id"], "result": result}), flush=True)
"""

Kernel = Callable[[float], None]


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    """Sets which share of the time the kernel says that a process waited for a processor; none for the test's own threads."""
    began_ns, share = time.monotonic_ns(), 0.0

    def read(thread: starvation._Thread, name: str) -> str:
        if name == "stat":
            return f"{thread.number} (python) S 1"
        ours = Path(f"/proc/self/task/{thread.number}").exists()
        return f"0 {0 if ours else int(share * (time.monotonic_ns() - began_ns))} 1"

    def waits(new: float) -> None:
        nonlocal share
        share = new

    monkeypatch.setattr(starvation._Thread, "_read", read)
    return waits


async def stopped() -> StopReport:
    ready = asyncio.Event()
    process = await SubjectProcess.start(
        [sys.executable, "-c", ENDS_LATE, str(LATE_S)],
        env=subject_environment({}),
        cwd=None,
        on_line=lambda at, line: ready.set(),
        on_overflow=lambda at: None,
    )
    await ready.wait()
    return await process.stop(grace_s=GRACE_S)


def test_time_without_a_processor_is_not_held_against_a_process_that_ends(kernel: Kernel) -> None:
    kernel(1.0)
    report = asyncio.run(stopped())
    assert report.how == "eof"
    assert report.seconds > GRACE_S


def test_a_process_that_waits_for_something_else_has_no_more_time(kernel: Kernel) -> None:
    kernel(0.0)
    assert asyncio.run(stopped()).how == "terminated"


async def opened() -> float:
    """Open a session with the server that is late; return the seconds that it took."""
    command = [sys.executable, "-c", SERVES_LATE, str(LATE_S)]
    session = McpSession(command, {}, None, SessionOptions(start_timeout_s=START_S, era="legacy"))
    await session.open()
    await session.close()
    return (session.ready_ns - session.spawned_ns) / 1e9


def test_time_without_a_processor_is_not_held_against_a_process_that_starts(kernel: Kernel) -> None:
    kernel(1.0)
    assert asyncio.run(opened()) > START_S


def test_a_process_that_is_late_for_another_reason_has_no_more_time(kernel: Kernel) -> None:
    kernel(0.0)
    with pytest.raises(SubjectError, match="handshake"):
        asyncio.run(opened())


async def called() -> Exchange:
    """Call a tool that answers late."""
    command = [sys.executable, "-c", SERVES_LATE, str(LATE_S), "calls"]
    session = McpSession(command, {}, None, SessionOptions(start_timeout_s=PATIENCE_S, era="legacy"))
    await session.open()
    try:
        return await session.call("any", {}, timeout_s=START_S)
    finally:
        await session.close()


def test_time_without_a_processor_is_not_held_against_an_adapter_that_answers(kernel: Kernel) -> None:
    kernel(1.0)
    exchange = asyncio.run(called())
    assert exchange.failure is None
    assert exchange.starved_ns / 1e9 > LATE_S * 0.9


def test_an_adapter_that_answers_late_for_another_reason_is_not_waited_for(kernel: Kernel) -> None:
    kernel(0.0)
    exchange = asyncio.run(called())
    assert (exchange.failure, exchange.starved_ns) == ("timeout", 0)


@pytest.fixture
def late_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mocks are started by an interpreter that is late."""
    python = tmp_path / "python"
    python.write_text(
        f"#!{sys.executable}\nimport os, sys, time\ntime.sleep({LATE_S})\n"
        f"os.execv({sys.executable!r}, [{sys.executable!r}, *sys.argv[1:]])\n"
    )
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setattr("pytest_otmcp.plant.mock_device._LAUNCH_TIMEOUT_S", START_S)


@pytest.mark.asyncio
@pytest.mark.usefixtures("late_python")
async def test_a_mock_that_the_machine_does_not_let_run_is_no_silent_one(kernel: Kernel) -> None:
    kernel(1.0)
    device, begun = MockDevice("modbus"), time.monotonic()
    await device.launch()
    took = time.monotonic() - begun
    await device.close()
    assert took > START_S


@pytest.mark.asyncio
@pytest.mark.usefixtures("late_python")
async def test_a_mock_that_runs_and_says_nothing_is_a_fault_of_the_kit(kernel: Kernel) -> None:
    kernel(0.0)
    device = MockDevice("modbus")
    with pytest.raises(KitError, match="said nothing for"):
        await device.launch()
    await device.close()


@pytest.fixture
def busy() -> Iterator[list[int]]:
    """Two programs that never end and share one processor, whatever their shares are."""
    number = min(os.sched_getaffinity(0))
    code = f"import os\nos.sched_setaffinity(0, {{{number}}})\nwhile True: pass"
    programs = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(2)]
    yield [one.pid for one in programs]
    for one in programs:
        one.kill()
        one.wait()


def test_what_the_kernel_counts_is_added_to_the_time(busy: list[int]) -> None:
    patience, begun = Patience(0.0), time.monotonic()
    patience.watch(busy)
    while (
        waited_s := patience.left_s() + time.monotonic() - begun
    ) < GRACE_S and time.monotonic() < begun + PATIENCE_S:
        time.sleep(starvation.LOOK_S)
    assert waited_s >= GRACE_S
