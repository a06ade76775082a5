"""Pages that look on: all hear everything, and one that does not read delays nobody."""

from __future__ import annotations

import asyncio

from pytest_otmcp.console.feed import Feed


def test_every_page_hears_what_happens_from_when_it_came() -> None:
    async def heard() -> list[object]:
        feed = Feed()
        with feed.page() as early:
            feed.tell({"n": 1})
            with feed.page() as late:
                feed.tell({"n": 2})
                feed.tell(None)
                return [[event["n"] async for event in page] for page in (early, late)]

    assert asyncio.run(heard()) == [[1, 2], [2]]


def test_a_page_that_does_not_read_misses_the_oldest_and_is_told_how_many() -> None:
    async def heard() -> list[object]:
        feed = Feed(longest=3)
        with feed.page() as page:
            for number in range(5):
                feed.tell({"n": number})
            feed.tell(None)
            return [event async for event in page]

    assert asyncio.run(heard()) == [{"kind": "lost", "count": 3}, {"n": 3}, {"n": 4}]
