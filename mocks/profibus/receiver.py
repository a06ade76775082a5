"""Bytes of a serial line, in pieces of any size, to whole telegrams."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from pytest_otmcp.wire.framing import MalformedError
from pytest_otmcp.wire.profibus import telegram_length

__all__ = ["Receiver"]

_PATIENCE_S = 0.2
"""Time that the rest of a telegram may take; what came is then no telegram, and the next byte begins one."""


class Receiver:
    """The receiver of one line.

    Args:
        telegram: takes a telegram; it may raise an MalformedError.
        malformed: takes bytes that are none, and the reason.
    """

    def __init__(self, telegram: Callable[[bytes], None], malformed: Callable[[bytes, str], None]) -> None:
        self._telegram = telegram
        self._malformed = malformed
        self._buffer = bytearray()
        self._timer: asyncio.TimerHandle | None = None

    def feed(self, data: bytes) -> None:
        """Take bytes that have arrived."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._buffer += data
        while self._buffer:
            try:
                length = telegram_length(self._buffer)
            except MalformedError as fault:
                # Where the next telegram begins cannot be told: a real station waits until the line is idle.
                self._give_up(str(fault))
                return
            if length is None or len(self._buffer) < length:
                self._timer = asyncio.get_running_loop().call_later(
                    _PATIENCE_S, self._give_up, "the rest of the telegram did not come"
                )
                return
            raw = bytes(self._buffer[:length])
            del self._buffer[:length]
            try:
                self._telegram(raw)
            except MalformedError as fault:
                self._malformed(raw, str(fault))

    def _give_up(self, reason: str) -> None:
        self._timer = None
        raw = bytes(self._buffer)
        self._buffer.clear()
        self._malformed(raw, reason)
