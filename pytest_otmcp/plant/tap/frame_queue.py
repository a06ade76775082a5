"""The queue of one direction of a tapped connection: frames are handed on in order, each as its fault rule says."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping

from .faults import Action, FaultRule

__all__ = ["FrameQueue"]


class FrameQueue:
    """Frames that wait until the frames before them have been handed on.

    Args:
        write: hands on a frame, or what a fault has left of it.
        on_connection: functions for the actions that concern the whole connection instead of a frame.
    """

    def __init__(self, write: Callable[[bytes], None], on_connection: Mapping[Action, Callable[[], None]]) -> None:
        self._write = write
        self._on_connection = on_connection
        self._queue: deque[tuple[FaultRule | None, bytes] | Callable[[], None]] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._held: bytes | None = None

    @property
    def idle(self) -> bool:
        """True when no frame waits or is held back: a frame without a rule may be written past the queue."""
        return not self._queue and self._timer is None and self._held is None

    def put(self, rule: FaultRule | None, frame: bytes) -> None:
        """Append a frame; :meth:`run` hands it on."""
        self._queue.append((rule, frame))

    def put_end(self, act: Callable[[], None]) -> None:
        """Append the end of the stream; ``act`` is called when all frames before it have been handed on."""
        self._queue.append(act)

    def stop(self) -> None:
        """Discard what has not been handed on."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._queue.clear()
        self._held = None

    def run(self) -> None:
        """Hand on the frames that do not have to wait."""
        while self._queue and self._timer is None:
            step = self._queue.popleft()
            if callable(step):
                self._complete()
                step()
            elif step[0] is None:
                self._write(step[1])
                self._complete()
            else:
                self._apply(step[0], step[1])

    def _complete(self) -> None:
        """Hand on the frame that was held back; the frame that had to pass before it has been handed on."""
        if self._held is not None:
            held, self._held = self._held, None
            self._write(held)

    def _apply(self, rule: FaultRule, frame: bytes) -> None:
        if rule.action in self._on_connection:
            self._on_connection[rule.action]()
        elif rule.action is Action.DELAY:
            self._later(rule.seconds, lambda: self._write(frame))
        elif rule.action is Action.DRIP:
            self._drip(rule.seconds, frame)
        elif rule.action is Action.REORDER and self._held is None:
            self._held = frame
        else:
            for altered in _altered(rule, frame):
                self._write(altered)
            self._complete()

    def _later(self, seconds: float, act: Callable[[], None]) -> None:
        def due() -> None:
            self._timer = None
            act()
            self._complete()
            self.run()

        self._timer = asyncio.get_running_loop().call_later(seconds, due)

    def _drip(self, seconds: float, frame: bytes) -> None:
        self._write(frame[:1])
        if len(frame) == 1:
            self._complete()
            return

        def due() -> None:
            self._timer = None
            self._drip(seconds, frame[1:])
            self.run()

        self._timer = asyncio.get_running_loop().call_later(seconds, due)


def _altered(rule: FaultRule, frame: bytes) -> tuple[bytes, ...]:
    """Return the frames that are handed on in the place of this one."""
    if rule.action is Action.DROP:
        return ()
    if rule.action is Action.TRUNCATE:
        return (frame[: rule.length],)
    if rule.action is Action.DUPLICATE:
        return (frame, frame)
    if rule.action is Action.CORRUPT and -len(frame) <= rule.offset < len(frame):
        altered = bytearray(frame)
        altered[rule.offset] ^= rule.mask
        return (bytes(altered),)
    return (frame,)
