"""The kit's event loop: whoever interrupts the waiting thread does not leave the work running."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from pytest_otmcp.session.loop import LoopThread


@pytest.fixture
def thread() -> Iterator[LoopThread]:
    loop = LoopThread()
    yield loop
    loop.close()


class Work:
    """Work that never ends by itself."""

    def __init__(self) -> None:
        self.begun = self.ended = False

    async def done(self) -> None:
        self.begun = True
        try:
            await asyncio.Event().wait()
        finally:
            self.ended = True


@pytest.mark.parametrize("handed_over", [True, False])
def test_work_has_ended_when_an_interrupt_came_around_its_handing_over(
    thread: LoopThread, monkeypatch: pytest.MonkeyPatch, handed_over: bool
) -> None:
    loop, work = thread._loop, Work()
    genuine = loop.call_soon_threadsafe

    def interrupted(callback: Callable[..., object], *arguments: Any, **more: Any) -> None:
        monkeypatch.setattr(loop, "call_soon_threadsafe", genuine)
        if handed_over:
            genuine(callback, *arguments, **more)
        raise KeyboardInterrupt

    monkeypatch.setattr(loop, "call_soon_threadsafe", interrupted)
    with pytest.raises(KeyboardInterrupt):
        thread.run(work.done())
    assert work.begun == work.ended
    assert [task for task in asyncio.all_tasks(loop) if not task.done()] == []


def test_what_work_returns_and_raises_is_handed_on(thread: LoopThread) -> None:
    async def seven() -> int:
        return 7

    async def fails() -> None:
        raise ValueError("no")

    assert thread.run(seven()) == 7
    with pytest.raises(ValueError, match="no"):
        thread.run(fails())
