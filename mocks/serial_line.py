"""The way between a device on a serial line and its clients: what a line does wrong. The line is a pseudo terminal.

==============  ============================================================================================================
``open``        everything passes
``black_hole``  what clients send is lost (and journalled as ``lost``, with the number of bytes), what the device sends is lost too
``stalled``     nothing is read and nothing sent, until the line is open again: then everything that was held back goes on, late
==============  ============================================================================================================

A client of a serial line has no connection: the number in the journal is that of the process that has the terminal open.
"""

from __future__ import annotations

import asyncio
import itertools
import os
from collections.abc import Callable

from .journal import Journal
from .medium import MessageMedium
from .peer import terminal_holder

__all__ = ["SerialLine"]

_MOST = 65536


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
        self._numbers = itertools.count(1)
        self._clients: dict[tuple[int, str | None] | None, int] = {}

    def open(self, master: int) -> None:
        """Serve on a pseudo terminal, by the file descriptor of its master."""
        self._master = master
        # A client that reads nothing must not stop the device; a real line would not wait for it either.
        os.set_blocking(master, False)
        asyncio.get_running_loop().add_reader(master, self._readable)

    def _readable(self) -> None:
        data = os.read(self._master, _MOST)
        number = self._number()
        self._arrived(number, len(data), lambda: self._receive(number, data))

    def _number(self) -> int:
        process, key = terminal_holder(self._master)
        number = self._clients.get(key)
        if number is None:
            number = self._clients[key] = next(self._numbers)
            self._journal.heard_of(number, process)
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
            self._master = -1
