"""A witness beside the wire: a capture of what goes to a real device, for an adapter whose address for it cannot be changed.

A capture program writes the file, at a mirror port of a switch or on this machine. What it shows nobody can hold back: the kit
asks for reads alone there. To know that the capture has come as far as now, the kit opens a connection to the device and waits until
that is in it.
"""

from __future__ import annotations

import asyncio
import os
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from ..core.errors import KitError, UsageError
from ..protocols.conversation import Direction
from ..protocols.protocol import Framing
from ..wire.capture import Capture, Segment, Stream
from ..wire.framing import Framer, MalformedError
from .tap.faults import FaultRule
from .tap.medium import MediumOwner
from .tap.peer import holder_of

__all__ = ["Mirror", "OwnConnections"]

_PAUSE_S, _LOOK_S, _SHOWN_S = 0.02, 0.1, 10.0
_CHUNK, _SHOWN = 1 << 20, 256
_NOTHING: Mapping[str, Any] = {}

Address = tuple[str, int]


class OwnConnections:
    """The connections of the kit's own to one device, which a capture shows like any other."""

    def __init__(self) -> None:
        self._ends: set[Address] = set()

    def note(self, transport: asyncio.BaseTransport | None) -> None:
        """Note a connection that has just been made, before anything is sent on it."""
        if transport is not None:
            self._ends.add(transport.get_extra_info("sockname")[:2])

    def take(self, end: Address) -> bool:
        """Tell whether a connection is the kit's own. Its port may be another's the next time."""
        found = end in self._ends
        self._ends.discard(end)
        return found


class _Connection:
    """One connection to the device, as the capture shows it."""

    def __init__(self, number: int, client: Address, framing: Framing) -> None:
        assert framing.frame_length is not None, "a stream is cut into frames"
        self.number, self.client = number, client
        self.is_own: bool | None = None
        self.has_spoken = False
        self.streams: dict[Direction, Stream] = {"in": Stream(), "out": Stream()}
        self.framers: dict[Direction, Framer] = {way: Framer(framing.frame_length) for way in self.streams}
        self.ended: set[Direction] = set()


class Mirror(MediumOwner):
    """The capture of what goes to ``host:port``; see :class:`~pytest_otmcp.plant.tap.tap.Tap`, as far as nothing is held back.

    Args:
        path: of the file, which is being written.
        host, port: the device; the adapter has the same address.
        framing: how to cut and decode what passes.
        see: is shown each frame to the device.
        own: connections that are not the adapter's.
    """

    def __init__(
        self, path: Path, host: str, port: int, framing: Framing, see: Callable[[bytes], None], own: OwnConnections
    ) -> None:
        super().__init__(framing)
        self.host, self.port = host, port
        self._path, self._framing, self._see, self._own = path, framing, see, own
        self._capture = Capture()
        self._file = -1
        self._device: Address = (host, port)
        self._connections: dict[Address, _Connection] = {}
        self._number = 0
        self._marks: dict[int, int | None] = {}
        self._here: str | None = None
        self._clock_ns = 0
        self._tail: asyncio.Task[None] | None = None
        self._problem: str | None = None
        self._seen: list[tuple[_Connection, Callable[[], None]]] = []

    @property
    def dead_connections(self) -> int:
        """None: nothing is held back."""
        return 0

    async def start(self) -> None:
        """Read what is there, and make sure that what goes to the device is in the capture.

        Raises:
            UsageError: it is not.
        """
        found = await asyncio.get_running_loop().getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        self._device = str(found[0][4][0]), self.port
        try:
            self._file = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK)
            self._tail = asyncio.create_task(self._follow(), name="otmcp-mirror")
            await self.settle()
        except OSError as error:
            raise UsageError(f"--otmcp-mirror: {self._path} cannot be read: {error.strerror}") from None
        except KitError as error:
            raise UsageError(f"--otmcp-mirror: {error}") from None
        # What the file had before is nobody's of this run.
        self._connections.clear()
        self.begin_journal()

    async def aclose(self) -> None:
        """Leave the file."""
        if self._tail is not None:
            self._tail.cancel()
            await asyncio.wait({self._tail})
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    async def up(self) -> None:
        """Do nothing: the device is where it was."""

    async def down(self) -> None:
        """Do nothing: nobody can take the device's address away."""

    def inject(self, *rules: FaultRule) -> None:
        """Refuse rules: nothing can be disturbed here."""
        if rules:
            raise KitError("what a capture shows cannot be disturbed")

    async def settle(self) -> None:
        """Return when the journal has all that has passed until now.

        Raises:
            KitError: the capture does not show it.
        """
        with socket.socket(self._family(), socket.SOCK_STREAM) as mark:
            mark.setblocking(False)
            mark.bind(("", 0))
            port = mark.getsockname()[1]
            sent_ns, self._marks[port] = time.monotonic_ns(), None
            mark.connect_ex(self._device)
            until = time.monotonic() + _SHOWN_S
            while self._marks[port] is None:
                if self._problem is not None:
                    self._fail(self._problem)
                if time.monotonic() > until:
                    self._fail(
                        f"does not show within {_SHOWN_S:g} s what goes to {self.host}:{self.port}; capture there, all of each packet, and "
                        "have it written at once, as `tcpdump --immediate-mode -U -s 0 -B 65536 -w FILE` does"
                    )
                await asyncio.sleep(_PAUSE_S / 4)
                self._read()
        if any(stream.waiting for connection in self._connections.values() for stream in connection.streams.values()):
            self._fail("has lost packets")
        shown_ns = self._marks.pop(port)
        assert shown_ns is not None
        self._clock_ns = sent_ns - shown_ns
        self._record()

    async def more(self, timeout_s: float) -> None:
        """Return when there may be more in the journal, or after so many seconds."""
        await asyncio.sleep(min(timeout_s, _LOOK_S))
        await self.settle()

    def _family(self) -> socket.AddressFamily:
        return socket.AF_INET6 if ":" in self._device[0] else socket.AF_INET

    def _fail(self, problem: str) -> NoReturn:
        raise KitError(f"the capture {self._path} {problem}")

    # -- the file -----------------------------------------------------------------------------------------

    async def _follow(self) -> None:
        """Read on: which process has a connection is known only while it has it."""
        while self._problem is None:
            self._read()
            await asyncio.sleep(_PAUSE_S)

    def _read(self) -> None:
        with suppress(BlockingIOError):
            while self._problem is None and (data := os.read(self._file, _CHUNK)):
                try:
                    for segment in self._capture.feed(data):
                        self._take(segment)
                except MalformedError as error:
                    self._problem = f"cannot be read: {error}"

    def _take(self, segment: Segment) -> None:
        is_asked = segment.target == self._device
        if not is_asked and segment.source != self._device:
            return
        client = segment.source if is_asked else segment.target
        if is_asked and segment.opens and client[1] in self._marks:
            self._marks[client[1]] = self._marks[client[1]] or segment.t_ns
            self._here = client[0]
            return
        if client[0] != self._here:
            # A mirror port shows what others do as well, and the adapter is on this machine.
            return
        if is_asked and segment.opens and not self._again(client, segment):
            self._number += 1
            self._connections[client] = _Connection(self._number, client, self._framing)
            self.journal.heard_of(self._number, holder_of(client, self._device))
        connection = self._connections.get(client)
        if connection is None:
            return
        if segment.cut and segment.data:
            self._problem = "has parts of packets alone"
        self._feed(connection, client, "in" if is_asked else "out", segment)

    def _again(self, client: Address, segment: Segment) -> bool:
        known = self._connections.get(client)
        return known is not None and known.streams["in"].begins_with(segment)

    def _feed(self, connection: _Connection, client: Address, way: Direction, segment: Segment) -> None:
        def seen(record: Callable[[], None]) -> None:
            self._seen.append((connection, record))

        if data := connection.streams[way].take(segment):
            if not connection.has_spoken:
                connection.has_spoken = True
                seen(partial(self._event, connection, "in", "CONNECTED", segment.t_ns))
            seen(partial(self._note, connection, way, data, segment.t_ns))
        if segment.ends:
            connection.ended.add(way)
        if segment.resets or len(connection.ended) == len(connection.streams):
            if connection.has_spoken:
                seen(partial(self._event, connection, "in", "DISCONNECTED", segment.t_ns))
            del self._connections[client]

    def _record(self) -> None:
        """Record what was seen: by now it is known which connections are the kit's own."""
        seen, self._seen = self._seen, []
        for connection, record in seen:
            if connection.is_own is None:
                connection.is_own = self._own.take(connection.client)
            if not connection.is_own:
                record()

    def _note(self, connection: _Connection, way: Direction, data: bytes, t_ns: int) -> None:
        framer = connection.framers[way]
        was_cut = framer.malformed is None
        for frame in framer.feed(data):
            if way == "in":
                self._see(frame)
            self.journal.frame(connection.number, way, frame, None, t_ns + self._clock_ns)
        if was_cut and framer.malformed is not None:
            told = {"bytes": framer.pending[:_SHOWN].hex(), "reason": framer.malformed}
            self._event(connection, way, "malformed", t_ns, told)

    def _event(
        self, connection: _Connection, way: Direction, kind: str, t_ns: int, told: Mapping[str, Any] = _NOTHING
    ) -> None:
        self.journal.event(connection.number, way, kind, passed_ns=t_ns + self._clock_ns, **told)
