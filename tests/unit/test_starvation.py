"""A process that the machine does not let run is not held to have ignored the end of its stdin, or to start too late."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pytest_otmcp.core.errors import KitError, SubjectError
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.session.process import StopReport, SubjectProcess, subject_environment
from pytest_otmcp.session.session import McpSession, SessionOptions

GRACE_S = 0.3
START_S = 1.0
WORK_S = 0.5
LAUNCH_S = 4 * WORK_S
"""Seconds: longer than a mock takes that works so long before, shorter than where another program takes the processor."""
WORKS = """
import os, sys, time
os.nice(10)
os.sched_setaffinity(0, {int(sys.argv[1])})
print(flush=True)
sys.stdin.read()
while time.process_time() < float(sys.argv[2]):
    pass
"""
"""Ends after its stdin, and after so many seconds on the processor."""

SERVES = """
import json, os, sys, time
os.nice(10)
os.sched_setaffinity(0, {int(sys.argv[1])})
while time.process_time() < float(sys.argv[2]):
    pass
time.sleep(float(sys.argv[3]))
about = {"protocolVersion": "2025-06-18", "capabilities": {"tools": {}}, "serverInfo": {"name": "late", "version": "1"}}
for line in sys.stdin:
    asked = json.loads(line)
    if "id" in asked:
        result = about if asked["method"] == "initialize" else {"tools": []}
        print(json.dumps({"jsonrpc": "2.0", "id": asked["id"], "result": result}), flush=True)
"""
"""Serves no tools, after so many seconds on the processor and so many asleep."""


@pytest.fixture
def processor() -> Iterator[int]:
    """A processor that another program takes nearly whole from who is nice."""
    number = min(os.sched_getaffinity(0))
    busy = subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"import os\nos.sched_setaffinity(0, {{{number}}})\nprint(flush=True)\nwhile True: pass",
        ],
        stdout=subprocess.PIPE,
    )
    assert busy.stdout is not None
    busy.stdout.readline()
    yield number
    busy.kill()
    busy.wait()
    busy.stdout.close()


async def stopped(code: str, *arguments: object) -> StopReport:
    ready = asyncio.Event()
    process = await SubjectProcess.start(
        [sys.executable, "-c", code, *map(str, arguments)],
        env=subject_environment({}),
        cwd=None,
        on_line=lambda at, line: ready.set(),
        on_overflow=lambda at: None,
    )
    await ready.wait()
    return await process.stop(grace_s=GRACE_S)


def test_time_without_a_processor_is_not_held_against_a_process_that_ends(processor: int) -> None:
    report = asyncio.run(stopped(WORKS, processor, 0.1))
    assert report.how == "eof"
    assert report.seconds > GRACE_S


def test_a_process_that_waits_for_something_else_has_no_more_time() -> None:
    report = asyncio.run(stopped("import sys, time\nprint(flush=True)\nsys.stdin.read()\ntime.sleep(60)"))
    assert report.how == "terminated"


async def opened(*arguments: object) -> float:
    """Open a session with the server that is late; return the seconds that it took."""
    command = [sys.executable, "-c", SERVES, *map(str, arguments)]
    session = McpSession(command, {}, None, SessionOptions(start_timeout_s=START_S, era="legacy"))
    await session.open()
    await session.close()
    return (session.ready_ns - session.spawned_ns) / 1e9


def test_time_without_a_processor_is_not_held_against_a_process_that_starts(processor: int) -> None:
    assert asyncio.run(opened(processor, 0.3, 0)) > START_S


def test_a_process_that_is_late_for_another_reason_has_no_more_time() -> None:
    with pytest.raises(SubjectError, match="handshake"):
        asyncio.run(opened(min(os.sched_getaffinity(0)), 0, 60))


@pytest.mark.asyncio
async def test_a_mock_that_the_machine_does_not_let_run_is_no_silent_one(
    processor: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python = tmp_path / "python"
    python.write_text(
        f"#!{sys.executable}\nimport os, sys, time\nos.nice(10)\nos.sched_setaffinity(0, {{{processor}}})\n"
        f"while time.process_time() < {WORK_S}:\n    pass\n"
        f"os.execv({sys.executable!r}, [{sys.executable!r}, *sys.argv[1:]])\n"
    )
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setattr("pytest_otmcp.plant.mock_device._LAUNCH_TIMEOUT_S", LAUNCH_S)
    device, begun = MockDevice("modbus"), time.monotonic()
    await device.launch()
    took = time.monotonic() - begun
    await device.close()
    assert took > LAUNCH_S


@pytest.mark.asyncio
async def test_a_mock_that_runs_and_says_nothing_is_a_fault_of_the_kit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python = tmp_path / "python"
    python.write_text(f"#!{sys.executable}\nimport sys\nsys.stdin.read()\n")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setattr("pytest_otmcp.plant.mock_device._LAUNCH_TIMEOUT_S", LAUNCH_S)
    device = MockDevice("modbus")
    with pytest.raises(KitError, match="said nothing for"):
        await device.launch()
    await device.close()
