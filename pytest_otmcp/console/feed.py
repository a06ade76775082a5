"""What happens in the console, told to every page that looks on. A slow page misses the oldest events and is told so; it delays nobody."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import contextmanager

__all__ = ["Event", "Feed"]

Event = Mapping[str, object]

_LONGEST = 1000
"""Events that wait for a page."""


class _Page:
    """One page: what waits for it, and how much of it was lost."""

    def __init__(self, longest: int) -> None:
        self.waiting: asyncio.Queue[Event | None] = asyncio.Queue(longest)
        self.lost = 0


class Feed:
    """The pages that look on."""

    def __init__(self, longest: int = _LONGEST) -> None:
        self._longest = longest
        self._pages: set[_Page] = set()

    def tell(self, event: Event | None) -> None:
        """Tell every page of an event; None ends what they read."""
        for page in self._pages:
            if page.waiting.full():
                page.waiting.get_nowait()
                page.lost += 1
            page.waiting.put_nowait(event)

    @contextmanager
    def page(self) -> Iterator[AsyncIterator[Event]]:
        """Give a page the events from now on; ``{"kind": "lost", "count": n}`` stands for those that it missed."""
        page = _Page(self._longest)
        self._pages.add(page)
        try:
            yield _events(page)
        finally:
            self._pages.discard(page)


async def _events(page: _Page) -> AsyncIterator[Event]:
    while (event := await page.waiting.get()) is not None:
        if page.lost:
            yield {"kind": "lost", "count": page.lost}
            page.lost = 0
        yield event
