"""A TCP connection to a controller, with its session and its CIP connection, and the frames that come on it."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from ..core import BadReply
from .wire import HEADER, connected_message, header_of

__all__ = ["SEND_RR_DATA", "Connection", "Refused", "answer", "next_frame"]

SEND_RR_DATA, _SEND_UNIT_DATA = 0x6F, 0x70
_IDLE_S = 60.0
"""A controller forgets a connection 67 s after the last request on it (the interval that pylogix asks for, 2.1 s, times 32), and does
not answer on it any more."""
_LATE = 3
"""Late answers to earlier requests that may come before the answer."""


class Refused(Exception):
    """The status of an encapsulation header, which is its only argument."""

    def __init__(self, status: int) -> None:
        super().__init__(f"encapsulation status {status:02X}")
        self.status = status


@dataclass(slots=True)
class Connection:
    """A TCP connection with its session and, once it is opened, its CIP connection.

    Attributes:
        session: handle of the session, 0 before it is registered.
        answers: identifier of the connection in answers (target to originator).
        size: largest message, in bytes.
        used: time of the last request, by the clock of the event loop.
    """

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    session: int = 0
    answers: int = 0
    size: int = 0
    used: float = 0.0

    def abort(self) -> None:
        self.writer.transport.abort()

    def is_used_up(self) -> bool:
        """Tell whether the controller has ended the connection, has forgotten it, or has sent something that nobody had asked for."""
        reader: Any = self.reader
        idle = asyncio.get_running_loop().time() - self.used
        return bool(reader._buffer) or reader.at_eof() or self.writer.is_closing() or idle > _IDLE_S


async def next_frame(connection: Connection, command: int) -> tuple[int, bytes]:
    """Return session and body of the next frame, which must be an answer to this command.

    Raises:
        BadReply: it is not.
        Refused: its status is not that of a success.
        OSError, EOFError: there is none.
    """
    header = await connection.reader.readexactly(HEADER)
    length, session, status = header_of(header, command)
    body = await connection.reader.readexactly(length)
    if status:
        raise Refused(status)
    if connection.session not in (0, session):
        raise BadReply("it belongs to another session")
    return session, body


async def answer(connection: Connection, frame: bytes, sequence: int) -> bytes:
    """Send a frame, and return the message with its sequence count. What is late for an earlier request is passed over.

    Raises:
        BadReply: the answer belongs to another connection, or has a sequence count that no request had.
        Refused, OSError, EOFError: there is none.
    """
    connection.writer.write(frame)
    await connection.writer.drain()
    for _ in range(_LATE):
        identifier, found, message = connected_message((await next_frame(connection, _SEND_UNIT_DATA))[1])
        if identifier != connection.answers:
            raise BadReply("it belongs to another connection")
        late = (sequence - found) & 0xFFFF
        if not late:
            return message
        # The counts go up: a smaller one was an earlier request's.
        if late > 0x8000:
            break
    raise BadReply("its sequence count is not the request's")
