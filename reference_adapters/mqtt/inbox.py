"""Received messages until somebody reads them; bounded, and honest about what it had to drop."""

from __future__ import annotations

import base64
from collections import deque
from datetime import UTC, datetime
from typing import Any

from .connection import Message
from .topics import matches

__all__ = ["Inbox"]

CAPACITY = 5000


class Inbox:
    """Messages in the order of their arrival."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._messages: deque[tuple[str, Message]] = deque()
        self._capacity = capacity
        self._dropped = 0

    def add(self, message: Message) -> None:
        """Keep a message; the oldest gives way when the capacity is reached."""
        if len(self._messages) == self._capacity:
            self._messages.popleft()
            self._dropped += 1
        moment = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        self._messages.append((moment, message))

    def take(self, text: str, limit: int) -> dict[str, Any]:
        """Remove and return the oldest messages that a filter selects, and how many were dropped since the last time."""
        taken: list[dict[str, Any]] = []
        kept: deque[tuple[str, Message]] = deque()
        for moment, message in self._messages:
            if len(taken) < limit and matches(text, message.topic):
                taken.append(_described(moment, message))
            else:
                kept.append((moment, message))
        self._messages = kept
        dropped, self._dropped = self._dropped, 0
        return {"messages": taken, "dropped": dropped}


def _described(moment: str, message: Message) -> dict[str, Any]:
    try:
        payload, encoding = message.payload.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        payload, encoding = base64.b64encode(message.payload).decode(), "base64"
    return {
        "topic": message.topic,
        "payload": payload,
        "encoding": encoding,
        "qos": message.qos,
        "retain": message.retain,
        "received_at": moment,
    }
