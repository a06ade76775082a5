"""The way between a device on a serial line and its clients: what a line does wrong. The line is a pseudo terminal.

==============  ============================================================================================================
``open``        everything passes
``black_hole``  what clients send is lost (and journalled as ``lost``, with the number of bytes), what the device sends is lost too
``stalled``     nothing is read and nothing sent, until the line is open again: then everything that was held back goes on, late
==============  ============================================================================================================

A client of a serial line has no connection: the number in the journal is that of the process that has the terminal open, or had it
last: what is read of a client that has closed it meanwhile was sent by that client.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import itertools
import os
from collections.abc import Callable

from .journal import Journal
from .medium import MessageMedium
from .peer import terminal_holder
from .terminal_marks import Marks

__all__ = ["SerialLine"]

_MOST = 65536
_GET_PEER = 0x5441
"""TIOCGPTPEER of ioctl_tty(2): opens the terminal that belongs to a master."""
_MARK_S = 0.5
"""Seconds for which a mark is waited for."""
_MARKS = 4
"""How many are sent before it is given up: a client that discards them all has no telegrams on their way either."""


class SerialLine(MessageMedium):
    """One pseudo terminal of a device.

    Args:
        journal: of the device.
        receive: takes the number of a client and its bytes, in pieces of any size.
    """

    def __init__(self, journal: Journal, receive: Callable[[int, bytes], None]) -> None:
        super().__init__(journal)
        self._receive = receive
        self._master = -1
        self._terminal = -1
        self._numbers = itertools.count(1)
        self._clients: dict[tuple[int, str | None] | None, int] = {}
        self._latest: int | None = None
        self._marks = Marks()
        self._news = asyncio.Event()

    def open(self, master: int) -> None:
        """Serve on a pseudo terminal, by the file descriptor of its master."""
        self._master = master
        # A client that reads nothing must not stop the device; a real line would not wait for it either.
        os.set_blocking(master, False)
        self._terminal = fcntl.ioctl(master, _GET_PEER, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        asyncio.get_running_loop().add_reader(master, self._readable)

    async def caught_up(self) -> None:
        """Return when all that clients had sent before has been read.

        A client may discard what is on its way, the mark included (TCOFLUSH of tcflush(3)): then another is sent.
        """
        for _ in range(_MARKS):
            if self._master < 0:
                return
            number, mark = self._marks.next()
            # Where nothing more fits in, what is there is read first, and makes room for the next.
            with contextlib.suppress(BlockingIOError):
                os.write(self._terminal, mark)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_MARK_S):
                    while self._marks.passed < number:
                        self._news.clear()
                        await self._news.wait()
                return

    def _readable(self) -> None:
        data = self._marks.without(os.read(self._master, _MOST))
        self._news.set()
        if data:
            self._take(data)

    def _take(self, data: bytes) -> None:
        number = self._number()
        self._arrived(number, len(data), lambda: self._receive(number, data))

    def _number(self) -> int:
        process, key = terminal_holder(self._master)
        if key is None and self._latest is not None:
            return self._latest
        number = self._clients.get(key)
        if number is None:
            number = self._clients[key] = next(self._numbers)
            self._journal.heard_of(number, process)
        if key is not None:
            self._latest = number
        return number

    def carries(self) -> bool:
        """Tell whether what is sent now is sent at all, so that a journal may say so."""
        return self.condition != "black_hole" and self._master >= 0

    def send(self, data: bytes, drip_s: float = 0.0) -> None:
        """Send bytes, one by one where they are to be seconds apart."""
        if self.condition == "stalled":
            self._held.append(lambda: self.send(data, drip_s))
            return
        if not self.carries():
            return
        now = data[:1] if drip_s else data
        try:
            os.write(self._master, now)
        except BlockingIOError:
            # Nobody reads: the line's buffer is full, and what does not fit is lost.
            return
        if rest := data[len(now) :]:
            asyncio.get_running_loop().call_later(drip_s, self.send, rest, drip_s)

    def close(self) -> None:
        """Serve nobody any more."""
        if self._master >= 0:
            asyncio.get_running_loop().remove_reader(self._master)
            os.close(self._terminal)
            self._master = self._terminal = -1
