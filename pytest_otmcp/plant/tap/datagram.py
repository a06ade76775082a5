"""A relay of UDP datagrams that records, and on demand disturbs, what passes.

Each client address has an upstream socket of its own, so that the device tells clients apart and its answers find their way
back. A datagram is a frame.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from typing import Any

from ...protocols.conversation import Direction
from ...protocols.protocol import Framing
from .faults import STREAM_ACTIONS, Action, FaultPlan, FaultRule
from .frame_queue import FrameQueue
from .medium import WITHHELD, Gate, Medium, MediumOwner
from .peer import sender_of

__all__ = ["DatagramTap"]

_LARGEST_DATAGRAM = 65_535
_MOST_CLIENTS = 256
"""A client that takes a new port for every request must not use up the file descriptors of the process."""

_Address = Any
"""As :mod:`socket` has it, of any family."""


class DatagramTap(MediumOwner):
    """A relay in front of ``target_host:target_port``; see :class:`~pytest_otmcp.plant.tap.tap.Tap`.

    A connection of the journal is a client address. Of more than 256 the one that has been silent for longest is forgotten.

    Args:
        target_host, target_port: the device.
        framing: how to decode what passes; its ``frame_length`` is not used.
        gate: see :class:`~.medium.Medium`.
    """

    def __init__(
        self, target_host: str, target_port: int, *, framing: Framing | None = None, gate: Gate | None = None
    ) -> None:
        super().__init__(framing, gate)
        self.host = "127.0.0.1"
        self._target: _Address = (target_host, target_port)
        self._family: int = socket.AF_INET
        self._socket: socket.socket | None = None
        self._is_up = False
        self._clients: dict[_Address, _Client] = {}
        self._seen = 0

    @property
    def port(self) -> int:
        """Port of the tap; stays the same over :meth:`down` and :meth:`up`."""
        port: int = self._bound().getsockname()[1]
        return port

    @property
    def open_connections(self) -> int:
        """Client addresses that have an upstream socket now."""
        return len(self._clients)

    @property
    def dead_connections(self) -> int:
        """None: what a client's datagrams are discarded for ends with the fault plan."""
        return 0

    def _bound(self) -> socket.socket:
        assert self._socket is not None, "the tap has not been started"
        return self._socket

    async def start(self) -> None:
        """Take a free port and hand datagrams on."""
        found = await asyncio.get_running_loop().getaddrinfo(*self._target, type=socket.SOCK_DGRAM)
        self._family, _, _, _, self._target = found[0]
        self._socket = self.new_socket(socket.SOCK_DGRAM, socket.AF_INET)
        self._socket.setblocking(False)
        self._socket.bind((self.host, 0))
        await self.up()

    async def aclose(self) -> None:
        """End everything; no socket is left."""
        if self._socket is not None:
            await self.down()
            self._socket.close()

    async def up(self) -> None:
        """Hand datagrams on again; those that were sent meanwhile are discarded."""
        if not self._is_up:
            self._discard()
            asyncio.get_running_loop().add_reader(self._bound(), self._from_client)
            self._is_up = True

    async def down(self) -> None:
        """Stop handing on: nothing is answered, and nothing that is on its way or sent from now on is ever delivered.

        The socket stays: without it the system would tell clients that the port is unreachable, and a device that is gone
        tells them nothing.
        """
        if self._is_up:
            asyncio.get_running_loop().remove_reader(self._bound())
            self._is_up = False
        for client in self._clients.values():
            client.close()
        self._clients.clear()

    def inject(self, *rules: FaultRule) -> None:
        """Replace the fault plan, counting from now; without rules datagrams pass untouched again.

        The black holes of the old plan end with it: no connection does.

        Raises:
            ValueError: an action does not exist on this transport.
        """
        for rule in rules:
            if rule.action in STREAM_ACTIONS:
                raise ValueError(f"there is no {rule.action.value!r} among datagrams")
        self._medium.plan = FaultPlan(rules)
        for client in self._clients.values():
            client.is_black_hole = False

    def _discard(self) -> None:
        bound = self._bound()
        # No datagram takes less of the buffer than a byte: a client that never stops sending does not hold this up.
        for _ in range(bound.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)):
            try:
                bound.recv(1)
            except BlockingIOError:
                break

    def _from_client(self) -> None:
        try:
            data, address = self._bound().recvfrom(_LARGEST_DATAGRAM)
        except BlockingIOError:
            return
        client = self._clients.pop(address, None) or self._new_client(address)
        # The clients are in the order of their newest datagrams.
        self._clients[address] = client
        client.take("in", data)

    def _new_client(self, address: _Address) -> _Client:
        if len(self._clients) == _MOST_CLIENTS:
            self._clients.pop(next(iter(self._clients))).close()
        self._seen += 1
        self._medium.journal.heard_of(self._seen, sender_of(address))

        def answer(data: bytes) -> None:
            # A datagram that the system cannot send is lost, as on any network.
            with contextlib.suppress(OSError):
                self._bound().sendto(data, address)

        return _Client(self._seen, self._medium, self._family, self._target, answer)


class _Client:
    """One client address: its datagrams to the device, and the device's to it.

    Attributes:
        is_black_hole: everything is discarded.
    """

    def __init__(
        self,
        number: int,
        medium: Medium,
        family: int,
        target: _Address,
        answer: Callable[[bytes], None],
    ) -> None:
        self._number = number
        self._medium = medium
        self.is_black_hole = False
        self._upstream = socket.socket(family, socket.SOCK_DGRAM)
        self._upstream.setblocking(False)
        self._upstream.connect(target)
        asyncio.get_running_loop().add_reader(self._upstream, self._from_device)
        self._write = {"in": self._to_device, "out": answer}
        on_connection = {Action.BLACK_HOLE: self._swallow}
        self._queues = {direction: FrameQueue(write, on_connection) for direction, write in self._write.items()}

    def take(self, direction: Direction, data: bytes) -> None:
        """Record a datagram and hand it on as the fault plan says, one to the device only where the gate lets it through."""
        if self.is_black_hole:
            return
        gate = self._medium.gate
        if direction == "in" and gate is not None and not gate(data):
            self._medium.journal.frame(self._number, direction, data, WITHHELD)
            return
        queue = self._queues[direction]
        if self._medium.plan.empty and queue.idle:
            self._note(direction, data, None)
            self._write[direction](data)
            return
        rule = self._medium.plan.for_frame(self._number, direction)
        self._note(direction, data, rule)
        queue.put(rule, data)
        queue.run()

    def close(self) -> None:
        """Discard the datagrams that have not been handed on, and close the socket to the device."""
        self._swallow()
        asyncio.get_running_loop().remove_reader(self._upstream)
        self._upstream.close()

    def _note(self, direction: Direction, data: bytes, rule: FaultRule | None) -> None:
        fault = None if rule is None else rule.action.value
        self._medium.journal.frame(self._number, direction, data, fault)

    def _to_device(self, data: bytes) -> None:
        # A device that is not there is silent: the system's error that its port is unreachable is not handed on.
        with contextlib.suppress(OSError):
            self._upstream.send(data)

    def _from_device(self) -> None:
        try:
            data = self._upstream.recv(_LARGEST_DATAGRAM)
        except OSError:
            return
        self.take("out", data)

    def _swallow(self) -> None:
        self.is_black_hole = True
        for queue in self._queues.values():
            queue.stop()
