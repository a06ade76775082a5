"""Connections of devices whose protocol has frames in a stream: what comes in is cut into frames, what goes out may be spoilt by a rule.

A witness is strict: bytes that are no frame are recorded and end the connection, so that they are not overlooked.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

from pytest_otmcp.wire.framing import FrameLength, MalformedError

from .fault_plan import FaultRule
from .fault_rules import FLAG, integer, number
from .journal import Direction
from .network import MANNERS, Link
from .peer import process_of
from .tcp_device import TcpDevice

__all__ = ["ANSWER_FAULTS", "AnswerRule", "FramedConnection"]

_MOST_SHOWN = 300
"""Bytes of malformed input that the journal keeps."""

ANSWER_FAULTS = {
    "delay_s": number(0, 3600),
    "drop": FLAG,
    "garbage": FLAG,
    "truncate": integer(0, 1024),
    "close": FLAG,
    "reset": FLAG,
    **MANNERS,
}
"""Actions of a fault rule that every one of these devices has; see :class:`AnswerRule`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerRule(FaultRule):
    """What a fault rule of any of these devices may do to an answer; the request has been executed.

    Attributes:
        delay_s: answer this many seconds later; later requests are not delayed by it.
        drop: do not answer.
        garbage: answer with bytes that are no frame.
        truncate: send only this many bytes of the answer.
        close, reset: close the connection instead, or reset it.
    """

    delay_s: float = 0.0
    drop: bool = False
    garbage: bool = False
    truncate: int | None = None
    close: bool = False
    reset: bool = False


D = TypeVar("D", bound=TcpDevice)


class FramedConnection(asyncio.Protocol, ABC, Generic[D]):
    """One client's connection. Frames are handled in order; a segment of TCP may hold several, or a part of one.

    Args:
        device: that the client has connected to.
        frame_length: returns the length in bytes of the frame at the beginning of a buffer that is not empty, None while too little
            of it has arrived; raises :class:`MalformedError` when no frame begins like that.

    Attributes:
        device: that the client has connected to.
        transport: to the client.
        number: of the connection, in the journal.
        garbage: what a client gets in the place of an answer when a rule wants bytes that are no frame.
    """

    garbage: ClassVar[bytes] = b"\xde\xad\xbe\xef\xff\xff\x00\x01"

    def __init__(self, device: D, frame_length: FrameLength) -> None:
        self.device = device
        self.transport: Link
        self.number: int
        self._frame_length = frame_length
        self._buffer = bytearray()

    @abstractmethod
    def frame(self, raw: bytes) -> None:
        """Handle a frame that has arrived.

        Raises:
            MalformedError: it is none; the connection is ended.
        """

    def received(self, raw: bytes, rule: FaultRule | None = None, **said: Any) -> int:
        """Record a frame that came in; return the number of the record.

        Args:
            rule: that applies to it.
            said: of it beside its bytes.
        """
        if rule is not None:
            said["fault"] = rule.action
        return self.device.journal.frame(raw, connection=self.number, direction="in", **said)

    # -- what comes in --------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, Link)
        self.transport = transport
        self.number = transport.number
        peer = transport.get_extra_info("peername")[1]
        self.device.journal.connected(self.number, process_of(transport), peer=peer)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._buffer:
            self._malformed("the connection ended inside a frame")
        self._event("in", "DISCONNECTED")

    def pause_writing(self) -> None:
        # No more requests are read from a client that does not read its answers: the answers must not accumulate.
        self.transport.pause_reading()

    def resume_writing(self) -> None:
        self.transport.resume_reading()

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        while self._buffer and not self.transport.is_closing():
            try:
                length = self._frame_length(self._buffer)
                if length is None or len(self._buffer) < length:
                    return
                self.frame(bytes(self._buffer[:length]))
            except MalformedError as fault:
                # Where the next frame begins can no longer be known.
                self._malformed(str(fault))
                self.transport.abort()
                return
            del self._buffer[:length]

    def _malformed(self, reason: str) -> None:
        self._event("in", "malformed", bytes=bytes(self._buffer[:_MOST_SHOWN]).hex(), reason=reason)
        self._buffer.clear()

    def _event(self, direction: Direction, kind: str, **fields: Any) -> None:
        self.device.journal.event(connection=self.number, direction=direction, kind=kind, **fields)

    # -- what goes out --------------------------------------------------------------------------------------------

    def carries(self) -> bool:
        """Tell whether what is sent now is sent at all, so that the journal may say so."""
        return not self.transport.is_closing() and self.transport.carries()

    def send(
        self,
        raw: bytes,
        asked: int | None,
        rule: AnswerRule | None = None,
        frames: Sequence[bytes] = (),
        **said: Any,
    ) -> None:
        """Send a frame, or several, and record it, unless nothing can be sent any more.

        Args:
            raw: its bytes, before a rule cuts them off.
            frames: to record, where they are several, or where a rule has made of their bytes what is no frame.
            asked: number of the record of the request that it answers; None for a message that nobody asked for.
            rule: that applies to the request.
            said: of it beside its bytes.
        """
        if not self.carries():
            return

        def record(**also: Any) -> None:
            for frame in frames or (raw,):
                self.device.journal.frame(frame, connection=self.number, direction="out", answers=asked, **said, **also)

        if rule is None:
            record()
            self.transport.write(raw)
            return
        spoilt = {"truncate": rule.truncate, "drip_s": rule.manner.drip_s or None}
        shown = {name: value for name, value in spoilt.items() if value is not None}
        twice: tuple[dict[str, Any], ...] = ({}, {"duplicate": True})
        for again in twice[: 1 + rule.manner.duplicate]:
            # What is mangled on its way has an entry of its own, see Manner.
            if rule.manner.mangle is None:
                record(**shown, **again)
            with self.transport.sending(rule.manner):
                self.transport.write(raw[: rule.truncate])

    def misbehave(self, rule: AnswerRule, send: Callable[[], None]) -> None:
        """Do what a rule wants in the place of an answer, or call what sends the answer, now or later."""
        if rule.drop:
            return
        if rule.close:
            self.transport.close()
        elif rule.reset:
            self.transport.reset()
        elif rule.garbage:
            # The entry answers no request: no client can tell which request the bytes are for.
            if self.carries():
                self._event("out", "garbage", bytes=self.garbage.hex())
                self.transport.write(self.garbage)
        elif rule.delay_s:
            asyncio.get_running_loop().call_later(rule.delay_s, send)
        else:
            send()
