"""The signals that ask a run to end: SIGTERM (``docker stop``, ``timeout``, a cancelled job) and SIGHUP (a closed terminal) end it
as Ctrl-C does, with verdict, reports, and nothing left running.

Python handles Ctrl-C only, and has it interrupt whatever is being done. While a result is written, and once the run is ending
anyway, an interruption would do harm: it is put off, or has no effect.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

__all__ = ["Endings"]

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Endings:
    """The handlers of one process that runs the suite. Only the main thread can have them; elsewhere nothing is handled.

    Attributes:
        name: of the signal that ended the run; None as long as none did. Ctrl-C is ``SIGINT``.
        workers: the workers of pytest-xdist by the numbers of their processes, which are told to end as well.
    """

    def __init__(self) -> None:
        self.name: str | None = None
        self.workers: dict[int, Any] = {}
        self._before: dict[int, Any] = {}
        self._ending = False
        self._patient = True
        self._held = 0
        self._put_off: int | None = None

    def install(self) -> None:
        """Handle the signals from now on, except those that this process ignores."""
        if self._before or threading.current_thread() is not threading.main_thread():
            return
        for number in _SIGNALS:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                self._before[number] = signal.signal(number, self._handle)

    def restore(self) -> None:
        """Handle the signals as before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def finishing(self) -> None:
        """Say that the run is ending: from now on only a second Ctrl-C interrupts, and the run then has no reports."""
        self._ending = True

    @contextmanager
    def held(self) -> Iterator[None]:
        """Put a signal off until the end of the block."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
        if not self._held and self._put_off is not None:
            self._end(self._put_off)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self._ending:
            if number == signal.SIGINT:
                if not self._patient:
                    raise KeyboardInterrupt
                self._patient = False
        elif self._held:
            self._put_off = number
        else:
            self._end(number)

    def _end(self, number: int) -> None:
        self._ending = True
        self._put_off = None
        # Whoever has pressed Ctrl-C once presses it again to have it end at once.
        self._patient = number != signal.SIGINT
        self.name = signal.Signals(number).name
        for worker in self.workers:
            # A terminal sends Ctrl-C to all of its processes itself, everything else to this one alone; a worker ends once.
            with suppress(ProcessLookupError):
                os.kill(worker, signal.SIGTERM)
        raise KeyboardInterrupt
