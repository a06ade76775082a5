"""The way between a TCP device and its clients, below every protocol: what a network does wrong, and how an answer travels.

A device hands its listener the factory :meth:`Network.protocol` instead of its own; its connections then get a :class:`Link` as
their transport. Links behave like the transports that they stand for until a fault plan or a poke says otherwise.

==============  ============================================================================================================
``open``        everything passes
``black_hole``  connections are accepted; what clients send is lost (and journalled as ``lost``, with the number of bytes), what
                the device sends, also the end of a connection, is lost too
``stalled``     connections are accepted; nothing is read and nothing sent, until the network is open again: then everything
                that was held back goes on, late
==============  ============================================================================================================

A connection that lost bytes in either direction stays dead when the network is open again: no client and no server can go on
in the middle of a stream. A new connection works.

Whatever the condition, a device takes no more than it can record: a client that floods it waits, as at a device of hardware, and the
device has time for the others and for its control channel.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import re
import socket
import struct
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .fault_rules import FLAG, Field, integer, number
from .journal import Journal
from .medium import Medium

if TYPE_CHECKING:
    from .tls import Tls

__all__ = ["AT_ONCE", "MANNERS", "Link", "Mangling", "Manner", "Network"]

_BURST = 20_000
_PER_S = 2_500
"""Records of the journal, and records per second: more than any item of the suite makes of an adapter that does what it is asked for."""
_PIECE = 8192
"""Bytes that are handed over at once: some hundred requests."""

_HEX = re.compile("(?:[0-9a-f]{2})*")


def _is_flip(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_POSITION.accepts, value)) and value[1] <= 0xFF


_POSITION = integer(0)
_MANGLING = {
    "flip": Field(accepts=lambda value: isinstance(value, list) and all(map(_is_flip, value)), expected=""),
    "cut": _POSITION,
    "append": Field(accepts=lambda value: isinstance(value, str) and bool(_HEX.fullmatch(value)), expected=""),
    "end": FLAG,
}


def _is_mangling(value: object) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() <= _MANGLING.keys()
        and all(_MANGLING[name].accepts(found) for name, found in value.items())
    )


MANNERS = {
    "drip_s": number(0, 60),
    "drip_bytes": integer(1, 65535),
    "duplicate": FLAG,
    "half_open": FLAG,
    "mangle": Field(
        accepts=_is_mangling,
        expected="an object with flip (a list of pairs of position and byte), cut (a number of bytes), append (hexadecimal), end",
        convert=lambda given: Mangling(**given),
    ),
}
"""Actions of a fault rule that every TCP device has; see :class:`Manner`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mangling:
    """What an answer's bytes become on their way.

    Attributes:
        flip: position and mask: the byte there, counted round and round, is changed in these bits.
        cut: so many bytes are missing at the end.
        append: bytes that follow, hexadecimal.
        end: the connection ends behind it.
    """

    flip: Sequence[Sequence[int]] = ()
    cut: int = 0
    append: str = ""
    end: bool = False

    def applied(self, data: bytes) -> bytes:
        """Return what is sent instead of the bytes of an answer."""
        changed = bytearray(data[: max(0, len(data) - self.cut)])
        for position, mask in self.flip if changed else ():
            changed[position % len(changed)] ^= mask
        return bytes(changed) + bytes.fromhex(self.append)


@dataclass(frozen=True, slots=True, kw_only=True)
class Manner:
    """How one answer travels.

    Attributes:
        drip_s: its bytes are sent in pieces, so many seconds apart; what is sent afterwards waits behind them.
        drip_bytes: length of a piece.
        duplicate: it is sent twice. The protocols do that themselves, so that the journal has both.
        half_open: the request is not executed, and from then on this connection is dead without an end: everything is lost, in
            both directions. Other connections are served.
        mangle: its bytes are changed; the journal then has what was sent, as an entry ``mangled``, instead of the answer.
    """

    drip_s: float = 0.0
    drip_bytes: int = 1
    duplicate: bool = False
    half_open: bool = False
    mangle: Mangling | None = None

    @classmethod
    def of(cls, values: dict[str, Any]) -> Manner:
        """Take the values of these fields out of the values of a rule."""
        return cls(**{name: values.pop(name) for name in MANNERS if name in values})


AT_ONCE = Manner()


class Network(Medium):
    """The way between one device and its clients.

    Args:
        numbers: of connections; from 1 on where they are not shared with another network.
    """

    def __init__(self, journal: Journal, numbers: Iterator[int] | None = None) -> None:
        super().__init__(journal)
        self.links: set[Link] = set()
        self.numbers = numbers or itertools.count(1)
        self._tls: Tls | None = None
        self._allowance = float(_BURST)
        self._recorded, self._counted_s = journal.next, 0.0

    @property
    def dead(self) -> int:
        """Number of connections that are dead."""
        return sum(link.dead for link in self.links)

    def protocol(self, factory: Callable[[], asyncio.Protocol]) -> Callable[[], asyncio.Protocol]:
        """Return the factory for a listener whose connections this factory serves."""

        def served() -> asyncio.Protocol:
            below = _Below(self, factory())
            return below if self._tls is None else self._tls.end(below)

        return served

    def secure(self, folder: Path) -> None:
        """Speak TLS with the certificates of a folder from now on; see :mod:`.tls`."""
        from .tls import Tls

        self._tls = Tls(folder, self._journal, self, self.numbers)

    def poke(self, params: Mapping[str, Any]) -> bool:
        if "tls" not in params:
            return super().poke(params)
        if self._tls is None or len(params) > 1 or not isinstance(params["tls"], str):
            raise ValueError("a poke of TLS is {'tls': NAME}, of a device that was started with certificates")
        self._tls.present(params["tls"])
        self.close()
        return True

    def restored(self) -> None:
        """Be as at the start."""
        self.become("open")
        if self._tls is not None and not self._tls.is_usual:
            self._tls.present()
            self.close()

    def _changed(self) -> None:
        for link in list(self.links):
            link.changed()

    def overdrawn_s(self) -> float:
        """Return for how many seconds the device takes no further requests; 0 unless it is flooded."""
        now, recorded = asyncio.get_running_loop().time(), self._journal.next
        refilled = self._allowance + (now - self._counted_s) * _PER_S
        self._allowance = min(_BURST, refilled) - (recorded - self._recorded)
        self._recorded, self._counted_s = recorded, now
        return max(0.0, -self._allowance / _PER_S)

    def lost(self, link: Link, count: int) -> None:
        """Record bytes that a client sent and that never reached the device."""
        self._journal.event(connection=link.number, direction="in", kind="lost", count=count)

    def mangled(self, link: Link, data: bytes) -> None:
        """Record what was sent in an answer's place. Like garbage it answers nothing: no client can tell what it is."""
        self._journal.event(connection=link.number, direction="out", kind="mangled", bytes=data.hex())

    def close(self) -> None:
        """End every connection, also those whose device has forgotten them."""
        for link in list(self.links):
            link.cut()


class _Below(asyncio.Protocol):
    """What the event loop knows as the protocol of a connection."""

    def __init__(self, network: Network, above: asyncio.Protocol) -> None:
        self.number = 0
        self._network = network
        self._above = above
        self._link: Link

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._link = Link(self._network, transport, self._above, self.number or next(self._network.numbers))
        self._network.links.add(self._link)
        self._above.connection_made(self._link)
        self._link.changed()

    def connection_lost(self, exc: Exception | None) -> None:
        self._network.links.discard(self._link)
        self._link.forget(exc)

    def data_received(self, data: bytes) -> None:
        self._link.received(data)

    def eof_received(self) -> bool | None:
        return None if self._link.dead else self._above.eof_received()

    def pause_writing(self) -> None:
        self._above.pause_writing()

    def resume_writing(self) -> None:
        self._above.resume_writing()


class Link(asyncio.Transport):
    """The transport of a connection, as its device sees it.

    Attributes:
        number: number of the connection in the journal.
        dead: nothing passes any more, although neither side has been told of an end.
        gone: set when the device has been told that the connection has ended.
    """

    def __init__(self, network: Network, transport: asyncio.Transport, above: asyncio.Protocol, number: int) -> None:
        super().__init__()
        self.number = number
        self.dead = False
        self.gone = asyncio.Event()
        self._network = network
        self._transport = transport
        self._above: asyncio.Protocol | None = above
        self._manner = AT_ONCE
        # What waits behind a drip, or until the network is open; None stands for the end of the connection.
        self._waiting: deque[tuple[bytes, float, int] | None] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._untaken = bytearray()
        self._held: set[str] = set()
        self._closing = False

    # -- what the network does ----------------------------------------------------------------------------

    def changed(self) -> None:
        """Follow the condition of the network."""
        stalled = self._network.condition == "stalled"
        if stalled != self._stalled:
            self._hold("stalled", stalled)
            if not stalled:
                self._go_on()

    @property
    def _stalled(self) -> bool:
        return "stalled" in self._held

    def _hold(self, reason: str, held: bool) -> None:
        """Read and hand over nothing as long as there is a reason."""
        (self._held.add if held else self._held.discard)(reason)
        self._take()
        (self._transport.pause_reading if self._held else self._transport.resume_reading)()

    def received(self, data: bytes) -> None:
        """Hand over bytes of the client, or lose them."""
        self._untaken += data
        self._take()

    def _take(self) -> None:
        """Hand over what has arrived, piece by piece, as long as the device can take it."""
        while self._untaken and not self._held:
            if wait_s := self._network.overdrawn_s():
                self._hold("pace", True)
                asyncio.get_running_loop().call_later(wait_s, self._hold, "pace", False)
                return
            piece = bytes(self._untaken[:_PIECE])
            del self._untaken[:_PIECE]
            if not self.carries():
                self._network.lost(self, len(piece))
            elif self._above is not None:
                self._above.data_received(piece)

    def die(self) -> None:
        """Lose everything from now on, in both directions."""
        self.dead = True
        self._waiting.clear()

    def forget(self, exc: Exception | None) -> None:
        """Tell the device that the connection has ended, unless it ended it itself."""
        if self._timer is not None:
            self._timer.cancel()
        self._untaken.clear()
        above, self._above = self._above, None
        if above is not None:
            above.connection_lost(exc)
        self.gone.set()

    def cut(self) -> None:
        """End the connection for the client too."""
        self._transport.abort()

    # -- how an answer travels ----------------------------------------------------------------------------

    @contextlib.contextmanager
    def sending(self, manner: Manner) -> Iterator[None]:
        """Write everything inside this context in this manner."""
        self._manner = manner
        try:
            yield
        finally:
            self._manner = AT_ONCE

    def carries(self) -> bool:
        """Tell whether what is written now is sent at all, so that a journal may say so."""
        if self._network.condition == "black_hole":
            self.dead = True
        return not self.dead

    def write(self, data: Any) -> None:
        if not self.carries():
            return
        mangle = self._manner.mangle
        if mangle is not None:
            data = mangle.applied(data)
            self._network.mangled(self, data)
        self._pass_on(data)
        if mangle is not None and mangle.end:
            self.close()

    def _pass_on(self, data: Any) -> None:
        if self._manner.drip_s or self._waiting or self._timer is not None or self._stalled:
            self._waiting.append((bytes(data), self._manner.drip_s, self._manner.drip_bytes))
            self._go_on()
        else:
            self._send(data)

    def _send(self, data: Any) -> None:
        # The client may have reset the connection while its requests are still being answered, and the loop tells of that
        # end afterwards: each further write would be a line of asyncio's on stderr.
        if not self._transport.is_closing():
            self._transport.write(data)

    def _go_on(self) -> None:
        """Send what waits, until a byte has to wait for its time."""
        if self._timer is not None or self._stalled:
            return
        while self._waiting:
            first = self._waiting.popleft()
            if first is None:
                self._transport.close()
                return
            data, drip_s, piece = first
            if not drip_s:
                self._send(data)
                continue
            self._send(data[:piece])
            if data[piece:]:
                self._waiting.appendleft((data[piece:], drip_s, piece))
            self._timer = asyncio.get_running_loop().call_later(drip_s, self._next_byte)
            return

    def _next_byte(self) -> None:
        self._timer = None
        self._go_on()

    # -- the rest of a transport --------------------------------------------------------------------------

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return self._transport.get_extra_info(name, default)

    def is_closing(self) -> bool:
        return self._closing or self._transport.is_closing()

    def close(self) -> None:
        if self._lost_end():
            return
        self._closing = True
        if self._waiting or self._timer is not None or self._stalled:
            self._waiting.append(None)
        else:
            self._transport.close()

    def abort(self) -> None:
        if not self._lost_end():
            self._closing = True
            self._transport.abort()

    def reset(self) -> None:
        """End the connection with RST: with SO_LINGER 0 the kernel sends that instead of FIN."""
        if not self.dead:
            sock = self._transport.get_extra_info("socket")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.abort()

    def _lost_end(self) -> bool:
        """End the connection for the device alone, if the end does not reach the client; tell whether that is so."""
        if self.carries():
            return False
        if not self._closing:
            self._closing = True
            asyncio.get_running_loop().call_soon(self.forget, None)
        return True

    def can_write_eof(self) -> bool:
        return True

    def write_eof(self) -> None:
        if self.carries():
            self._transport.write_eof()

    def pause_reading(self) -> None:
        self._hold("device", True)

    def resume_reading(self) -> None:
        self._hold("device", False)

    def is_reading(self) -> bool:
        return self._transport.is_reading()

    def get_write_buffer_size(self) -> int:
        return self._transport.get_write_buffer_size()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._transport.set_write_buffer_limits(high, low)

    def get_protocol(self) -> asyncio.BaseProtocol:
        return self._transport.get_protocol()
