"""Messages that a decoder makes of recorded frames; each says what it asks or which message it answers. Pure.

A decoder knows the wire and nothing else. Sequence numbers and times are added where the journal is kept; until then an
answer refers to the message object that it answers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

__all__ = ["Conversation", "Conversations", "Direction", "InOrder", "Message", "Outstanding"]

Direction = Literal["in", "out"]

_MOST_OUTSTANDING = 65_536
"""Outstanding messages at most: identifiers of two bytes, which most protocols have, cannot tell more of them apart."""
_MOST_CONVERSATIONS = 4096
"""A client that sends each datagram from another port never ends a conversation."""


@dataclass(slots=True, kw_only=True, eq=False)
class Message:
    """One message of a client or of its device, decoded. A message equals only itself.

    Attributes:
        direction: ``in`` for what the device received, ``out`` for what it sent.
        kind: kind of the message, in the protocol's words; ``malformed`` for bytes that cannot be read.
        fields: further members of the journal entry, JSON-safe; of a malformed message ``bytes`` (hexadecimal digits) and
            ``reason``.
        request, state_changing: see :class:`~pytest_otmcp.protocols.journal.JournalEntry`.
        answers: the message of the other direction that this one answers.
        frames: to be kept of it: where several frames made it, or where its own holds a credential, which must not be kept.
            A conversation that decodes them in this order makes the same message of them.
        unsure: members of the entry that the bytes do not settle, so that a mock may know better; it is believed about no other.
        seq: its number in the journal, once it has one.
    """

    direction: Direction
    kind: str
    fields: Mapping[str, object] = field(default_factory=dict)
    request: bool = False
    state_changing: bool = False
    answers: Message | None = None
    frames: Sequence[bytes] = ()
    unsure: Collection[str] = ()
    seq: int | None = None


class Conversation(Protocol):
    """Decoder of both directions of one connection, frame by frame."""

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame; several frames may be needed for a message. A frame of any content is decoded without an
        exception."""
        ...


class Conversations:
    """The conversations of a device's connections.

    Args:
        new: makes the decoder of one connection.
    """

    def __init__(self, new: Callable[[], Conversation]) -> None:
        self._new = new
        self._of: dict[int, Conversation] = {}

    def decode(self, connection: int, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame of a connection."""
        conversation = self._of.get(connection)
        if conversation is None:
            if len(self._of) == _MOST_CONVERSATIONS:
                del self._of[next(iter(self._of))]
            conversation = self._of[connection] = self._new()
        return conversation.decode(direction, frame)

    def end(self, connection: int) -> None:
        """Forget a connection that has ended."""
        self._of.pop(connection, None)


class Outstanding:
    """The messages of one connection that have not been answered, by the identifiers that their answers repeat.

    A client that uses an identifier again has given up waiting: the answer belongs to the newest message. When too many
    messages have no answer, the oldest are forgotten.
    """

    def __init__(self) -> None:
        self._messages: dict[Hashable, Message] = {}

    def add(self, key: Hashable, message: Message) -> None:
        """Remember a message that is to be answered."""
        self._messages.pop(key, None)
        self._messages[key] = message
        if len(self._messages) > _MOST_OUTSTANDING:
            del self._messages[next(iter(self._messages))]

    def take(self, key: Hashable) -> Message | None:
        """Return the message that an answer with this key is for, and forget it; None if there is none."""
        return self._messages.pop(key, None)


class InOrder:
    """Decoder for a protocol whose device answers each frame of a connection by one, in the order in which they came.

    Args:
        parsed: returns the members of a frame's entry, ``kind``, ``request`` and ``state_changing`` among them.
    """

    def __init__(self, parsed: Callable[[bytes], Mapping[str, Any]]) -> None:
        self._parsed = parsed
        self._asked: deque[Message] = deque(maxlen=_MOST_OUTSTANDING)

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """See :class:`Conversation`."""
        fields = dict(self._parsed(frame))
        known = {name: fields.pop(name) for name in ("kind", "request", "state_changing")}
        answers = self._asked.popleft() if direction == "out" and self._asked else None
        message = Message(direction=direction, answers=answers, fields=fields, **known)
        if direction == "in":
            self._asked.append(message)
        return [message]
