"""The journal of a device in the test's own process, decoded as the kit decodes that of a mock program."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pytest_otmcp.mocks.journal import Journal

from pytest_otmcp.plant.journal import DeviceJournal
from pytest_otmcp.protocols.conversation import Conversation

__all__ = ["OwnJournal"]


class OwnJournal:
    """What a device has recorded, as entries.

    Args:
        recorded: by the device.
        conversation: makes the decoder of one connection.
    """

    def __init__(self, recorded: Journal, conversation: Callable[[], Conversation]) -> None:
        self._recorded = recorded
        self._entries = DeviceJournal(conversation)

    def since(self, seq: int, **match: Any) -> list[Any]:
        """Return the entries from ``seq`` on that have these fields."""
        self._take()
        return [
            entry
            for entry in self._entries.since(seq)
            if all(entry.get(name) == value for name, value in match.items())
        ]

    @property
    def next(self) -> int:
        """Sequence number that the next entry will get."""
        self._take()
        return self._entries.next

    async def wait(self, seq: int, match: dict[str, Any], count: int, timeout_s: float) -> list[Any]:
        """Return the entries with these fields as soon as there are ``count``, or those that there are in the end."""

        async def more(timeout_s: float) -> None:
            await self._recorded.wait(self._entries.taken, timeout_s)
            self._take()

        self._take()
        found: list[Any] = await self._entries.wait(seq, match, count, timeout_s, more)
        return found

    def _take(self) -> None:
        journal = self._recorded
        records = journal.since(self._entries.taken)
        self._entries.take(
            {
                "records": [record.told() for record in records],
                "first": journal.first,
                "next": journal.next,
                "peers": journal.peers(records),
            }
        )
