"""A process that the machine does not let run is not held to have ignored the end of its stdin."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from pytest_otmcp.session.process import StopReport, SubjectProcess, subject_environment

GRACE_S = 0.3
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
