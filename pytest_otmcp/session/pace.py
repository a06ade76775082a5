"""A limit of calls per time that the adapter declares, and that the kit keeps to."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

__all__ = ["Pace"]


class Pace:
    """Lets so many calls begin that the adapter receives no more than its limit allows.

    A call counts from its request until ``per_s`` seconds after its answer: the adapter received it at some time between the
    two, so the distance between any two of its receipts is not shorter than the limit's, however long messages take.

    Args:
        calls: the most calls, at least 1.
        per_s: the time in seconds that the limit is about.
    """

    def __init__(self, calls: int, per_s: float) -> None:
        self._per_s = per_s
        self._free = asyncio.Semaphore(calls)

    @asynccontextmanager
    async def call(self) -> AsyncIterator[None]:
        """Wait until the limit has room, and count the call that is made inside the block."""
        await self._free.acquire()
        try:
            yield
        finally:
            asyncio.get_running_loop().call_later(self._per_s, self._free.release)
