"""One direction of one tapped connection: hands bytes on, and does to them what the fault plan says."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from ...protocols.framing import Conversation, Framer
from .faults import Action, FaultPlan, FaultRule
from .journal import TapJournal

__all__ = ["Chunk", "Lane", "Medium", "reset_connection"]

_CHUNKS_KEPT = 200_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """Bytes as they arrived at the tap.

    Attributes:
        t_ns: monotonic.
        connection: number of the connection, from 1.
        direction: ``in`` towards the device, ``out`` from it.
    """

    t_ns: int
    connection: int
    direction: str
    data: bytes


@dataclass(slots=True)
class Medium:
    """What all lanes of a tap share."""

    journal: TapJournal = field(default_factory=TapJournal)
    chunks: deque[Chunk] = field(default_factory=lambda: deque(maxlen=_CHUNKS_KEPT))
    plan: FaultPlan = field(default_factory=FaultPlan)


def reset_connection(transport: asyncio.Transport) -> None:
    """Close a TCP connection with RST, whatever is still to be sent."""
    sock = transport.get_extra_info("socket")
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    transport.abort()


class Lane:
    """Reads from one transport, writes to another.

    Bytes that come before there is a transport to write to wait in memory; later the usual back pressure applies.

    Attributes:
        ended: the end of the stream has been handed on.
        black_hole: swallow everything from now on.
    """

    def __init__(
        self,
        medium: Medium,
        connection: int,
        direction: str,
        framer: Framer | None,
        conversation: Conversation | None,
        *,
        reset: Callable[[], None],
        swallow: Callable[[], None],
        finished: Callable[[], None],
    ) -> None:
        self._medium = medium
        self._connection = connection
        self._direction = direction
        self._framer = framer
        self._conversation = conversation
        self._reset = reset
        self._swallow = swallow
        self._finished = finished
        self._source: asyncio.Transport | None = None
        self._sink: asyncio.Transport | None = None
        self._early: list[bytes | None] = []
        self._queue: deque[tuple[FaultRule | None, bytes | None]] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._held: bytes | None = None
        # How many bytes of the frame that is not yet complete have been handed on already.
        self._ahead = 0
        self.black_hole = False
        self.ended = False

    # -- transports ---------------------------------------------------------------------------------------

    def read_from(self, transport: asyncio.Transport) -> None:
        """The transport whose bytes are fed into this lane."""
        self._source = transport

    def write_to(self, transport: asyncio.Transport) -> None:
        """The transport that gets them; what has been waiting goes out now."""
        self._sink = transport
        early, self._early = self._early, []
        for data in early:
            if data is None:
                self._take_eof()
            else:
                self._take(data)

    def pause_source(self) -> None:
        """The sink has enough."""
        if self._source is not None and not self._source.is_closing():
            self._source.pause_reading()

    def resume_source(self) -> None:
        """The sink takes more."""
        if self._source is not None and not self._source.is_closing():
            self._source.resume_reading()

    def stop(self) -> None:
        """Forget what has not been handed on."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._queue.clear()
        self._early.clear()
        self._held = None

    # -- bytes --------------------------------------------------------------------------------------------

    def feed(self, data: bytes) -> None:
        """Bytes have arrived."""
        if self._sink is None:
            self._early.append(data)
        else:
            self._take(data)
        chunk = Chunk(t_ns=time.monotonic_ns(), connection=self._connection, direction=self._direction, data=data)
        self._medium.chunks.append(chunk)

    def feed_eof(self) -> None:
        """No more bytes will come."""
        if self._sink is None:
            self._early.append(None)
        else:
            self._take_eof()

    def _take(self, data: bytes) -> None:
        if self.black_hole:
            return
        if self._medium.plan.empty and not self._queue and self._timer is None and self._held is None:
            self._pass_on(data)
        else:
            self._disturb(data)

    def _take_eof(self) -> None:
        if self.black_hole:
            # Nobody would ever notice that the connection is over: clear it away.
            self._reset()
            return
        if self._framer is not None and (rest := self._framer.pending[self._ahead :]):
            self._queue.append((None, rest))
        self._queue.append((None, None))
        self._pump()

    def _write(self, data: bytes) -> None:
        if self._sink is not None and not self._sink.is_closing():
            self._sink.write(data)

    def _pass_on(self, data: bytes) -> None:
        framer = self._framer
        if framer is None:
            self._write(data)
            return
        # Written before it is cut: what the tap does for itself must not cost the adapter time.
        self._write(framer.pending[self._ahead :] + data)
        for frame in framer.feed(data):
            self._note(frame, None)
        self._ahead = 0 if self._check_stream() else len(framer.pending)

    def _disturb(self, data: bytes) -> None:
        frames = [data] if self._framer is None else self._framer.feed(data)
        for frame in frames:
            ahead, self._ahead = self._ahead, 0
            rule = None
            if not ahead:
                rule = self._medium.plan.for_frame(self._connection, self._direction)
            self._note(frame, rule)
            self._queue.append((rule, frame[ahead:]))
        if rest := self._check_stream():
            self._queue.append((None, rest[self._ahead :]))
            self._ahead = 0
        self._pump()

    def _note(self, frame: bytes, rule: FaultRule | None) -> None:
        if self._conversation is not None and self._framer is not None:
            fault = None if rule is None else rule.action.value
            self._medium.journal.frame(self._connection, self._direction, frame, fault, self._conversation)

    def _check_stream(self) -> bytes:
        """When the stream can no longer be cut: note it, and treat the rest as bytes; returns what was not cut."""
        framer = self._framer
        if framer is None or framer.malformed is None:
            return b""
        rest = framer.pending
        self._medium.journal.event(
            self._connection, self._direction, "malformed", bytes=rest[:256].hex(), reason=framer.malformed
        )
        self._framer = None
        return rest

    # -- faults -------------------------------------------------------------------------------------------

    def _pump(self) -> None:
        while self._queue and self._timer is None:
            rule, data = self._queue.popleft()
            if data is None:
                self._complete()
                self.ended = True
                if self._sink is not None and not self._sink.is_closing():
                    self._sink.write_eof()
                self._finished()
            elif rule is None:
                self._write(data)
                self._complete()
            else:
                self._apply(rule, data)

    def _complete(self) -> None:
        """A frame has gone: one that was held back for it follows."""
        if self._held is not None:
            held, self._held = self._held, None
            self._write(held)

    def _apply(self, rule: FaultRule, data: bytes) -> None:
        if rule.action is Action.RESET:
            self._reset()
        elif rule.action is Action.BLACK_HOLE:
            self._swallow()
        elif rule.action is Action.DELAY:
            self._later(rule.seconds, lambda: self._write(data))
        elif rule.action is Action.DRIP:
            self._drip(rule.seconds, data)
        elif rule.action is Action.REORDER and self._held is None:
            self._held = data
        else:
            self._write(_altered(rule, data))
            self._complete()

    def _later(self, seconds: float, act: Callable[[], None]) -> None:
        def due() -> None:
            self._timer = None
            act()
            self._complete()
            self._pump()

        self._timer = asyncio.get_running_loop().call_later(seconds, due)

    def _drip(self, seconds: float, data: bytes) -> None:
        self._write(data[:1])
        if len(data) == 1:
            self._complete()
            return

        def due() -> None:
            self._timer = None
            self._drip(seconds, data[1:])
            self._pump()

        self._timer = asyncio.get_running_loop().call_later(seconds, due)


def _altered(rule: FaultRule, data: bytes) -> bytes:
    if rule.action is Action.TRUNCATE:
        return data[: rule.length]
    if rule.action is Action.DUPLICATE:
        return data + data
    if rule.action is Action.CORRUPT and -len(data) <= rule.offset < len(data):
        altered = bytearray(data)
        altered[rule.offset] ^= rule.mask
        return bytes(altered)
    return data
