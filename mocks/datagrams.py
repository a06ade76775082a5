"""The way between a UDP device and its clients: what a network does wrong. See :mod:`.network` for that of TCP devices.

==============  ============================================================================================================
``open``        everything passes
``black_hole``  what clients send is lost (and journalled as ``lost``, with the number of bytes), what the device sends is lost too
``stalled``     nothing is read and nothing sent, until the network is open again: then everything that was held back goes on, late
==============  ============================================================================================================

A client of UDP has no connection: the number in the journal is that of an address and the socket behind it.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from typing import Any, cast

from .journal import Journal
from .medium import MessageMedium
from .peer import holder, socket_of

__all__ = ["Datagrams"]

Address = Any


class Datagrams(MessageMedium, asyncio.DatagramProtocol):
    """One UDP endpoint of a device.

    Args:
        journal: of the device.
        receive: takes the number of a client and its datagram, and what sends an answer to it.
    """

    def __init__(self, journal: Journal, receive: Callable[[int, bytes, Callable[[bytes], None]], None]) -> None:
        super().__init__(journal)
        self._receive = receive
        self._transport: asyncio.DatagramTransport
        self._numbers = itertools.count(1)
        self._clients: dict[tuple[Address, int], int] = {}

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        number = self._number(addr)
        self._arrived(number, len(data), lambda: self._deliver(number, data, addr))

    def _number(self, addr: Address) -> int:
        client = socket_of(self._transport.get_extra_info("sockname"), addr)
        number = self._clients.get((addr, client))
        if number is None:
            number = self._clients[addr, client] = next(self._numbers)
            self._journal.heard_of(number, holder(client))
        return number

    def _deliver(self, number: int, data: bytes, addr: Address) -> None:
        def send(answer: bytes) -> None:
            if self.condition == "stalled":
                self._held.append(lambda: send(answer))
            elif self.carries():
                self._transport.sendto(answer, addr)

        self._receive(number, data, send)

    def carries(self) -> bool:
        """Tell whether what is sent now is sent at all, so that a journal may say so."""
        return self.condition != "black_hole" and not self._transport.is_closing()

    def close(self) -> None:
        """Serve nobody any more."""
        self._transport.close()
