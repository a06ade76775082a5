"""Received messages until a tool reads them; the number is bounded, and dropped messages are counted."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from datetime import UTC, datetime

from .connection import Message
from .topics import matches

__all__ = ["Inbox", "Received"]

MAX_MESSAGES = 5000
MAX_BYTES = 16 * 1024 * 1024
MAX_TAKEN_BYTES = 4 * 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class Received:
    """A message and the moment of its arrival, UTC."""

    message: Message
    at: datetime

    @property
    def size(self) -> int:
        """Bytes of topic and payload."""
        return len(self.message.payload) + len(self.message.topic)


class Inbox:
    """Messages in the order of their arrival; the oldest are dropped when there are too many, or they are too large."""

    def __init__(self) -> None:
        self._messages: deque[Received] = deque()
        self._bytes = 0
        self._dropped = 0

    def add(self, message: Message) -> None:
        """Keep a message."""
        received = Received(message=message, at=datetime.now(UTC))
        self._messages.append(received)
        self._bytes += received.size
        while len(self._messages) > MAX_MESSAGES or self._bytes > MAX_BYTES:
            self._bytes -= self._messages.popleft().size
            self._dropped += 1

    def take(self, text: str, limit: int) -> tuple[list[Received], int]:
        """Remove and return the oldest messages that a filter selects, and the number of the others that it selects.

        At most :data:`MAX_TAKEN_BYTES` at once, but at least one message.
        """
        taken: list[Received] = []
        kept: deque[Received] = deque()
        size = remaining = 0
        selected: dict[str, bool] = {}
        for received in self._messages:
            topic = received.message.topic
            if topic not in selected:
                selected[topic] = matches(text, topic)
            if not selected[topic]:
                kept.append(received)
            elif remaining or len(taken) == limit or (taken and size + received.size > MAX_TAKEN_BYTES):
                kept.append(received)
                remaining += 1
            else:
                taken.append(received)
                size += received.size
        self._messages = kept
        self._bytes -= size
        return taken, remaining

    def take_dropped(self) -> int:
        """Return the number of messages dropped since the last call."""
        dropped, self._dropped = self._dropped, 0
        return dropped
