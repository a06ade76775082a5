"""Reference adapters over a long time: many calls, and a device that comes and goes, with flat memory and descriptors.

Short by default. ``OTMCP_SOAK_CALLS=20000 OTMCP_SOAK_S=3600 pytest tests/adapters/test_soak.py -m long -rP`` is a real soak, and
prints its figures.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable

import psutil
import pytest

from .cases import CASES, Case
from .conftest import Client, Rig

pytestmark = pytest.mark.long

CALLS = int(os.environ.get("OTMCP_SOAK_CALLS", "1000"))
SECONDS = float(os.environ.get("OTMCP_SOAK_S", "15"))
GROWTH = 8 * 1024 * 1024
"""Bytes by which a process may grow after its first calls: caches that fill, and the allocator's own arenas."""

every_case = pytest.mark.parametrize(
    "case",
    [CASES[0], *(pytest.param(case, marks=pytest.mark.weekly) for case in CASES[1:])],
    ids=lambda case: case.protocol,
)


def held(client: Client) -> tuple[int, int]:
    """Return resident memory in bytes, and the number of descriptors, of an adapter's process."""
    process = psutil.Process(client.process.pid)
    return process.memory_info().rss, process.num_fds()


def nothing_is_left(client: Client, before: tuple[int, int], done: str) -> None:
    """Compare what the process holds now with what it held before, and print both."""
    (memory, descriptors), after = before, held(client)
    print(f"{done}: {memory / 1e6:.1f} to {after[0] / 1e6:.1f} MB, {descriptors} to {after[1]} descriptors")
    assert after[1] == descriptors
    assert after[0] - memory < GROWTH


@every_case
def test_many_calls_leave_nothing_behind(case: Case, rigs: Callable[[Case], Rig]) -> None:
    rig = rigs(case)
    tools = itertools.cycle(sorted(case.tools.keys() - case.stateful))

    def call(times: int) -> None:
        for _ in range(times):
            tool = next(tools)
            rig.adapter.call(tool, case.tools[tool])

    call(CALLS // 4)
    before = held(rig.adapter)
    call(CALLS)
    nothing_is_left(rig.adapter, before, f"{CALLS} calls")


@every_case
def test_a_device_that_comes_and_goes_leaves_nothing_behind(case: Case, rigs: Callable[[Case], Rig]) -> None:
    rig = rigs(case)
    with rig.outage():
        pass
    before = held(rig.adapter)
    began, outages = time.monotonic(), 0
    while time.monotonic() - began < SECONDS:
        with rig.outage():
            assert not rig.adapter.call(case.probe, case.reads[case.probe]).envelope["success"]
        outages += 1
    assert outages > 0
    nothing_is_left(rig.adapter, before, f"{outages} outages")
