"""The way between a device and its clients on a cable of Ethernet: what a cable does wrong. See :mod:`.cable` for how it is made.

==============  ============================================================================================================
``open``        everything passes
``black_hole``  what clients send is lost (and journalled as ``lost``, with the number of bytes), what the device sends is lost too
``stalled``     nothing is read and nothing sent, until the cable is open again: then everything that was held back goes on, late
==============  ============================================================================================================

A client has no connection: the number in the journal is that of the packet socket that is open at the other end.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Collection
from functools import partial

from .cable import CableEnd
from .journal import Journal
from .medium import MessageMedium
from .peer import holder

__all__ = ["Frames"]

_MOST = 65536
_AT_ONCE = 64
_EVERY_PROTOCOL = 3


class Frames(MessageMedium):
    """The device's end of a cable.

    Args:
        journal: of the device.
        ethertype: of the frames that are the device's.
        receive: takes the number of a client and a frame, from the destination address on.
        further: types of frames beside these, which clients send by other sockets.
    """

    def __init__(
        self,
        journal: Journal,
        ethertype: int,
        receive: Callable[[int, bytes], None],
        *,
        further: Collection[int] = (),
    ) -> None:
        super().__init__(journal)
        self._receive = receive
        self._ethertype = ethertype
        self._taken = {ethertype, *further}
        self._end: CableEnd | None = None
        self._numbers = itertools.count(1)
        self._clients: dict[int, int] = {}
        self._listed = b""
        self._number = 0

    def open(self, end: CableEnd) -> None:
        """Serve on a cable."""
        self._end = end
        asyncio.get_running_loop().add_reader(end.socket, self._readable)

    def _readable(self) -> None:
        assert self._end is not None
        for _ in range(_AT_ONCE):
            try:
                frame = self._end.socket.recv(_MOST)
            except BlockingIOError:
                return
            if int.from_bytes(frame[12:14]) in self._taken:
                number = self._client()
                self._arrived(number, len(frame), partial(self._receive, number, frame))

    def _client(self) -> int:
        """Return the number of the client. The kernel lists the packet sockets; whose they are is looked up when the list has changed."""
        assert self._end is not None
        self._end.sockets.seek(0)
        listed = self._end.sockets.read(_MOST)
        if listed != self._listed:
            self._listed = listed
            # sk, references, type, protocol, interface, running, memory, user, inode
            rows = [line.split() for line in listed.splitlines()[1:]]
            fit = [int(row[8]) for row in rows if int(row[3], 16) in (self._ethertype, _EVERY_PROTOCOL)] or [0]
            for inode in fit:
                if inode not in self._clients:
                    self._clients[inode] = next(self._numbers)
                    self._journal.heard_of(self._clients[inode], holder(inode))
            # Of several sockets the one that was opened last is taken. Each processor numbers its sockets for itself, so the highest
            # inode may be that of an older one.
            self._number = max(self._clients[inode] for inode in fit)
        return self._number

    def carries(self) -> bool:
        """Tell whether what is sent now is sent at all, so that a journal may say so."""
        return self.condition != "black_hole" and self._end is not None

    def send(self, frame: bytes) -> None:
        """Send a frame, from the destination address on."""
        if self.condition == "stalled":
            self._held.append(lambda: self.send(frame))
        elif self.carries():
            assert self._end is not None
            try:
                self._end.socket.send(frame)
            except BlockingIOError:
                # Nobody reads: the frame is lost, as on a real cable.
                return

    def close(self) -> None:
        """Serve nobody any more."""
        if self._end is not None:
            asyncio.get_running_loop().remove_reader(self._end.socket)
            self._end.socket.close()
            self._end = None
