"""One direction of one tapped connection, which hands on bytes and applies the fault plan to them."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import time
from collections.abc import Callable

from ...protocols.conversation import Direction
from ...wire.framing import Framer
from .faults import Action, FaultRule
from .frame_queue import FrameQueue
from .medium import WITHHELD, Medium

__all__ = ["Lane", "reset_connection"]

_NOTHING_OF_IT = FaultRule(action=Action.DROP)


def reset_connection(transport: asyncio.Transport) -> None:
    """Close a TCP connection with RST; what is still to be sent is lost."""
    sock = transport.get_extra_info("socket")
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    transport.abort()


class Lane:
    """A lane that reads from one transport and writes to another.

    Bytes that arrive before there is a transport to write to are kept in memory; later the usual back pressure applies.

    Attributes:
        ended: the end of the stream has been handed on.
        is_black_hole: everything is discarded from now on.
    """

    def __init__(
        self,
        medium: Medium,
        connection: int,
        direction: Direction,
        framer: Framer | None,
        *,
        reset: Callable[[], None],
        swallow: Callable[[], None],
        finished: Callable[[], None],
    ) -> None:
        self._medium = medium
        self._connection = connection
        self._direction = direction
        self._framer = framer
        self._rewrite = medium.rewrite if direction == "out" else None
        self._reset = reset
        self._finished = finished
        self._source: asyncio.Transport | None = None
        self._sink: asyncio.Transport | None = None
        self._early: list[bytes | None] = []
        self._queue = FrameQueue(self._write, {Action.RESET: reset, Action.BLACK_HOLE: swallow})
        # Number of bytes of the incomplete frame that have been handed on already.
        self._ahead = 0
        self.is_black_hole = False
        self.ended = False

    # -- transports ---------------------------------------------------------------------------------------

    def read_from(self, transport: asyncio.Transport) -> None:
        """Note the transport whose bytes are fed into this lane."""
        self._source = transport

    def write_to(self, transport: asyncio.Transport) -> None:
        """Note the transport to write to, and write the bytes that have been waiting."""
        self._sink = transport
        early, self._early = self._early, []
        for data in early:
            if data is None:
                self._take_eof()
            else:
                self._take(data)

    def hold(self) -> None:
        """Keep in memory what comes, until there is another transport to write to."""
        self._sink = None
        self.resume_source()

    def pause_source(self) -> None:
        """Stop reading: the sink's buffer is full."""
        if self._source is not None and not self._source.is_closing():
            self._source.pause_reading()

    def resume_source(self) -> None:
        """Start reading again: the sink accepts more."""
        if self._source is not None and not self._source.is_closing():
            self._source.resume_reading()

    def stop(self) -> None:
        """Discard what has not been handed on."""
        self._queue.stop()
        self._early.clear()

    # -- bytes --------------------------------------------------------------------------------------------

    def feed(self, data: bytes) -> None:
        """Take bytes that have arrived."""
        if self._sink is None:
            self._early.append(data)
        else:
            self._take(data)

    def feed_eof(self) -> None:
        """Note that no more bytes will come."""
        if self._sink is None:
            self._early.append(None)
        else:
            self._take_eof()

    def _take(self, data: bytes) -> None:
        if self.is_black_hole:
            return
        if self._is_guarded:
            self._guard(data)
        elif self._medium.plan.empty and self._queue.idle and self._rewrite is None:
            self._pass_on(data)
        else:
            self._disturb(data)

    def _take_eof(self) -> None:
        if self.is_black_hole:
            # Neither side would ever notice the end of the connection, so it is reset.
            self._reset()
            return
        if not self._is_guarded and self._framer is not None and (rest := self._framer.pending[self._ahead :]):
            self._queue.put(None, rest)
        self._queue.put_end(self._end)
        self._queue.run()

    def _end(self) -> None:
        self.ended = True
        if self._sink is not None and not self._sink.is_closing():
            self._sink.write_eof()
        self._finished()

    def _write(self, data: bytes) -> None:
        if self._sink is not None and not self._sink.is_closing():
            self._sink.write(data)

    def _pass_on(self, data: bytes) -> None:
        framer = self._framer
        if framer is None:
            self._write(data)
            return
        # The bytes are written before they are cut into frames: the tap's own work must not cost the adapter time. The time is that of before:
        # an answer is not later at the device than at the adapter.
        passed_ns = time.monotonic_ns()
        self._write(framer.pending[self._ahead :] + data)
        for frame in framer.feed(data):
            self._note(frame, None, passed_ns)
        self._ahead = 0 if self._check_stream() else len(framer.pending)

    def _disturb(self, data: bytes) -> None:
        frames = [data] if self._framer is None else self._framer.feed(data)
        if self._rewrite is not None:
            rewritten = [self._rewrite(frame) for frame in frames]
            frames = [frame for frame in rewritten if frame is not None]
            if len(frames) < len(rewritten):
                self._reset()
                return
        for frame in frames:
            ahead, self._ahead = self._ahead, 0
            rule = None
            if not ahead:
                rule = self._medium.plan.for_frame(self._connection, self._direction)
            self._note(frame, rule)
            self._queue.put(rule, frame[ahead:])
        if rest := self._check_stream():
            self._queue.put(None, rest[self._ahead :])
            self._ahead = 0
        self._queue.run()

    @property
    def _is_guarded(self) -> bool:
        return self._direction == "in" and self._medium.gate is not None

    def _guard(self, data: bytes) -> None:
        """Hand on the whole frames that the gate lets through; a stream that can no longer be cut ends here."""
        gate, framer = self._medium.gate, self._framer
        if gate is None or framer is None:
            self._reset()
            return
        for frame in framer.feed(data):
            passes = gate(frame)
            rule = self._medium.plan.for_frame(self._connection, self._direction) if passes else _NOTHING_OF_IT
            fault = None if rule is None else rule.action.value
            self._medium.journal.frame(self._connection, self._direction, frame, fault if passes else WITHHELD)
            self._queue.put(rule, frame)
        self._queue.run()
        if self._check_stream():
            self._reset()

    def _note(self, frame: bytes, rule: FaultRule | None, passed_ns: int | None = None) -> None:
        if self._framer is not None:
            fault = None if rule is None else rule.action.value
            self._medium.journal.frame(self._connection, self._direction, frame, fault, passed_ns)

    def _check_stream(self) -> bytes:
        """Note when the stream can no longer be cut, and treat the rest as bytes; return what was not cut."""
        framer = self._framer
        if framer is None or framer.malformed is None:
            return b""
        rest = framer.pending
        self._medium.journal.event(
            self._connection, self._direction, "malformed", bytes=rest[:256].hex(), reason=framer.malformed
        )
        self._framer = None
        return rest
