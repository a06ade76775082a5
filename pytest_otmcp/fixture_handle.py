"""How handles get their work done on the kit's loop, from plain tests and from asynchronous ones on any loop."""

from __future__ import annotations

from collections.abc import Coroutine
from typing import Any, TypeVar

from .errors import KitError, SubjectError, UsageError
from .loop import LoopThread

__all__ = ["Handle"]

T = TypeVar("T")

_SENTENCES = (KitError, SubjectError, UsageError)
"""Errors that say all there is to say: where inside the kit they came up is no news to whoever reads a failed test."""


class Handle:
    """Something that lives on the kit's loop and is used from elsewhere."""

    def __init__(self, loop: LoopThread) -> None:
        self._loop = loop

    def _do(self, work: Coroutine[Any, Any, T]) -> T:
        __tracebackhide__ = True
        try:
            return self._loop.run(work)
        except _SENTENCES as error:
            raise error.with_traceback(None) from None

    async def _wait(self, work: Coroutine[Any, Any, T]) -> T:
        __tracebackhide__ = True
        try:
            return await self._loop.wait(work)
        except _SENTENCES as error:
            raise error.with_traceback(None) from None
