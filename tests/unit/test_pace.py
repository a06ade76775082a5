"""The kit keeps to the limit of calls that an adapter declares."""

from __future__ import annotations

import asyncio
import time

import pytest

from pytest_otmcp.session.pace import Pace

pytestmark = pytest.mark.asyncio

PER_S = 0.2


async def test_no_more_calls_than_the_limit_are_received_in_its_time() -> None:
    pace = Pace(3, PER_S)
    received: list[float] = []

    async def call() -> None:
        async with pace.call():
            await asyncio.sleep(0)
            received.append(time.monotonic())

    await asyncio.gather(*(call() for _ in range(10)))
    assert len(received) == 10
    assert all(later - earlier >= PER_S for earlier, later in zip(received, received[3:], strict=False))
    # What the limit allows at once is not held back.
    assert received[2] - received[0] < PER_S


async def test_a_call_that_is_cancelled_counts_as_well() -> None:
    pace = Pace(1, PER_S)
    begun = time.monotonic()

    async def hangs() -> None:
        async with pace.call():
            await asyncio.Event().wait()

    with pytest.raises(TimeoutError):
        await asyncio.wait_for(hangs(), 0.01)
    async with pace.call():
        assert time.monotonic() - begun >= PER_S
