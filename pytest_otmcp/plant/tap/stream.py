"""A proxy of TCP connections that records, and on demand disturbs, what passes.

Without rules bytes are handed on as they come, before anything else is done with them. With rules they are handed on
frame by frame (see ``faults``). ``down`` and ``up`` take the endpoint away and bring it back on the same port.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from ...core.errors import KitError
from ...core.exhaustion import exhausted
from ...protocols.conversation import Direction
from ...protocols.protocol import Framing
from ...wire.framing import Framer
from .faults import FaultPlan, FaultRule
from .lane import Lane, reset_connection
from .medium import Gate, Medium, MediumOwner, Rewrite
from .peer import process_of

__all__ = ["StreamTap"]

_CONNECT_TIMEOUT_S, _CLOSING_S = 5.0, 1.0
_DIRECTIONS: tuple[Direction, Direction] = ("in", "out")


class StreamTap(MediumOwner):
    """A proxy in front of ``target_host:target_port``; see :class:`~pytest_otmcp.plant.tap.tap.Tap`.

    Args:
        target_host, target_port: the device.
        framing: how to cut and decode what passes. Without it the journal holds connections only, and the rules of
            :meth:`inject` count pieces as they arrive instead of frames.
        gate: decides which frames reach the device; None lets everything through.
        rewrite: makes of the frames of the device what the client gets; None leaves them as they are.

    Raises:
        KitError: the framing cuts no streams, or there is a gate and nothing that cuts them.
    """

    def __init__(
        self,
        target_host: str,
        target_port: int,
        *,
        framing: Framing | None = None,
        gate: Gate | None = None,
        rewrite: Rewrite | None = None,
    ) -> None:
        if framing is not None and framing.frame_length is None:
            raise KitError("a TCP connection cannot be recorded: the frames of its protocol are datagrams")
        if gate is not None and framing is None:
            raise KitError("a TCP connection cannot be guarded without its frames")
        super().__init__(framing, gate, rewrite)
        self.host = "127.0.0.1"
        self._target = (target_host, target_port)
        self._framing = framing
        self._reserved: socket.socket | None = None
        self._server: asyncio.Server | None = None
        self._links: set[_Link] = set()
        self._accepted = 0
        self._is_aside = False

    @property
    def port(self) -> int:
        """Port of the tap; stays the same over :meth:`down` and :meth:`up`."""
        assert self._reserved is not None, "the tap has not been started"
        port: int = self._reserved.getsockname()[1]
        return port

    @property
    def open_connections(self) -> int:
        """Connections that are open now."""
        return len(self._links)

    @property
    def dead_connections(self) -> int:
        """Connections over which nothing passes any more, although neither side has been told of an end."""
        return sum(lane.is_black_hole for link in self._links for lane in link._lanes)

    async def start(self) -> None:
        """Take a free port and accept connections."""
        # The socket is bound and never listens: while the tap is down no process gets the port, connecting is refused.
        self._reserved = self._bound(0)
        await self.up()

    async def aclose(self) -> None:
        """End everything; no task and no socket is left."""
        await self.down()
        if self._reserved is not None:
            self._reserved.close()

    async def up(self) -> None:
        """Accept connections, on the same port as before."""
        if self._server is None:
            loop = asyncio.get_running_loop()
            self._server = await loop.create_server(self._accept, sock=self._bound(self.port))

    async def down(self) -> None:
        """Reset the connections and refuse new ones."""
        if self._server is not None:
            self._server.close()
            self._server = None
        links = list(self._links)
        for link in links:
            link.reset()
        for link in links:
            await link.ended.wait()

    @asynccontextmanager
    async def aside(self) -> AsyncIterator[None]:
        """Leave a device that takes one connection at a time to another client meanwhile; the tap's own clients stay connected to the tap."""
        self._is_aside = True
        try:
            await asyncio.gather(*(link.leave() for link in self._links))
            yield
        finally:
            self._is_aside = False
            for link in self._links:
                link.come_back()

    def inject(self, *rules: FaultRule) -> None:
        """Replace the fault plan, counting from now; without rules bytes pass untouched again."""
        self._medium.plan = FaultPlan(rules)

    def _bound(self, port: int) -> socket.socket:
        sock = self.new_socket(socket.SOCK_STREAM, socket.AF_INET)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            sock.bind((self.host, port))
        except OSError:
            sock.close()
            raise
        return sock

    def _accept(self) -> _Side:
        self._accepted += 1
        link = _Link(self._accepted, self._medium, self._target, self._framing, self._links.discard)
        link.is_aside = self._is_aside
        self._links.add(link)
        return link.client


class _Link:
    """The connection of one client, and the connection to the device that belongs to it."""

    def __init__(
        self,
        number: int,
        medium: Medium,
        target: tuple[str, int],
        framing: Framing | None,
        forget: Callable[[_Link], None],
    ) -> None:
        self.number = number
        self.ended = asyncio.Event()
        self.is_aside = False
        self._left = asyncio.Event()
        self._medium = medium
        self._target = target
        self._forget = forget
        self._connecting: asyncio.Task[None] | None = None
        self._condemned = False
        frame_length = None if framing is None else framing.frame_length
        self._lanes = [
            Lane(
                medium,
                number,
                direction,
                None if frame_length is None else Framer(frame_length),
                reset=self.reset,
                swallow=self._swallow,
                finished=self._finished,
            )
            for direction in _DIRECTIONS
        ]
        self.client = _Side(self, *self._lanes)
        self.device = _Side(self, *reversed(self._lanes))

    def connected(self, side: _Side) -> None:
        """Continue with a side that has got its transport."""
        if self.ended.is_set() or self._condemned:
            self.reset()
        elif side is self.client:
            assert side.transport is not None
            self._medium.journal.heard_of(self.number, process_of(side.transport))
            self._medium.journal.event(self.number, "in", "CONNECTED")
            if self._medium.plan.for_connection(self.number) is not None:
                self.reset()
            elif not self.is_aside:
                self._begin()

    def _begin(self) -> None:
        self._connecting = asyncio.create_task(self._connect(), name=f"otmcp-tap-{self.number}")

    async def leave(self) -> None:
        """End the connection to the device, not that of the client, and wait until the device has ended it too."""
        self.is_aside = True
        self._left.clear()
        if self._lanes[0].ended:
            self.reset()
        if self._connecting is not None:
            self._connecting.cancel()
            await asyncio.wait({self._connecting})
        self._lanes[0].hold()
        if (transport := self.device.transport) is not None:
            transport.write_eof()
            try:
                await asyncio.wait_for(self._left.wait(), _CLOSING_S)
            except TimeoutError:
                reset_connection(transport)
                await self._left.wait()

    def come_back(self) -> None:
        """Connect to the device again, where the client is still there."""
        self.is_aside = False
        if self.client.transport is not None and not self._condemned:
            self._begin()

    async def _connect(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(_CONNECT_TIMEOUT_S):
                await loop.create_connection(lambda: self.device, *self._target)
        except OSError as error:
            if exhausted(error) is not None:
                loop.call_exception_handler({"message": "the tap cannot connect", "exception": error})
            # The device refuses or is silent. The tap has accepted the client, so it can only reset the connection.
            self.reset()

    def lost(self, side: _Side, failure: Exception | None) -> None:
        """Close the other side of a connection that has ended, in the same manner: orderly or by a reset."""
        if side is self.device and self.is_aside:
            self._left.set()
            if self.client.transport is not None:
                return
        other = self.device if side is self.client else self.client
        if self._connecting is not None:
            self._connecting.cancel()
        if other.transport is not None:
            if failure is None:
                other.transport.close()
            else:
                reset_connection(other.transport)
        elif not self.ended.is_set():
            for lane in self._lanes:
                lane.stop()
            self._medium.journal.event(self.number, "in", "DISCONNECTED")
            self._forget(self)
            self.ended.set()

    def reset(self) -> None:
        """Reset both sides, also one that has been accepted and has no transport yet."""
        self._condemned = True
        for side in (self.client, self.device):
            if side.transport is not None:
                reset_connection(side.transport)

    def _swallow(self) -> None:
        for lane in self._lanes:
            lane.stop()
            lane.is_black_hole = True

    def _finished(self) -> None:
        if all(lane.ended for lane in self._lanes):
            for side in (self.client, self.device):
                if side.transport is not None:
                    side.transport.close()


class _Side(asyncio.Protocol):
    """One of the two TCP connections of a link; it feeds one lane, and the other lane writes to it."""

    def __init__(self, link: _Link, inbound: Lane, outbound: Lane) -> None:
        self._link = link
        self._inbound = inbound
        self._outbound = outbound
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self._inbound.read_from(transport)
        self._link.connected(self)
        self._outbound.write_to(transport)

    def data_received(self, data: bytes) -> None:
        self._inbound.feed(data)

    def eof_received(self) -> bool:
        if self._link.is_aside:
            # A client that ends meanwhile needs no connection to the device any more.
            if self is self._link.client:
                self._link.reset()
            return False
        self._inbound.feed_eof()
        # Half-closed: the other direction goes on.
        return True

    def pause_writing(self) -> None:
        self._outbound.pause_source()

    def resume_writing(self) -> None:
        self._outbound.resume_source()

    def connection_lost(self, exc: Exception | None) -> None:
        self.transport = None
        self._link.lost(self, exc)
