"""CIP connections of the controller: forward open, forward close, and the routes of both and of other requests.

Source: ODVA's volume 1, 3-5, as the public developer guide has it. Only connections for messages (transport class 3) to the message
router can be opened; none for input or output data.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from pytest_otmcp.wire.ethernetip.cip import FORWARD_OPEN, LARGE_FORWARD_OPEN, UNCONNECTED_SEND
from pytest_otmcp.wire.ethernetip.messages import TOO_LITTLE_DATA, Path, Refusal, Reply

__all__ = ["Connection", "Connections", "misrouted"]

_FAILED = 0x01
DUPLICATE, CLASS_NOT_SUPPORTED, NOT_FOUND, BAD_SIZE, NO_MORE = 0x0100, 0x0103, 0x0107, 0x0109, 0x0113
NO_SUCH_PORT, NO_SUCH_LINK, BAD_SEGMENT = 0x0311, 0x0312, 0x0315

_TRANSPORT_CLASS = 0x0F
_MESSAGES = 3
_LARGEST = {FORWARD_OPEN: 511, LARGE_FORWARD_OPEN: 4002}
_BACKPLANE, _SLOT = 1, 0
_FIRST_ID = 0x20000001
_ROUTER = (2, 1)

Triad = tuple[int, int, int]
"""Serial number of a connection, vendor and serial number of the originator: unique among connections."""


@dataclass(slots=True, kw_only=True)
class Connection:
    """An open CIP connection.

    Attributes:
        own_id: with which the client addresses it.
        peer_id: with which it is answered.
        size: bytes of a message in either direction, the sequence count included.
        carrier: number of the TCP connection that it was opened on.
        count: sequence count of the last request; None before the first.
        last: answer to it; None while there is none.
    """

    own_id: int
    peer_id: int
    triad: Triad
    size: int
    carrier: int
    count: int | None = None
    last: Reply | None = None


@dataclass(slots=True)
class Connections:
    """The connections that are open.

    Attributes:
        forgotten: how many ended with their TCP connection, without a forward close.
    """

    open: dict[int, Connection] = field(default_factory=dict)
    forgotten: int = 0
    _next: int = _FIRST_ID

    def forward_open(self, code: int, data: bytes, carrier: int, limit: int) -> Reply:
        """Open a connection for messages.

        Args:
            code: of the service: 54, or 5B for sizes above 511 bytes.
            limit: so many can be open.
        """
        wide = code == LARGE_FORWARD_OPEN
        form = struct.Struct("<BBIIHHIB3xIIIIBB" if wide else "<BBIIHHIB3xIHIHBB")
        if len(data) < form.size or len(data) != form.size + 2 * data[form.size - 1]:
            return Reply(service=code, status=TOO_LITTLE_DATA)
        _, _, _, peer, *triad, _, out_interval, out, in_interval, into, transport, _ = form.unpack_from(data)
        key: Triad = (triad[0], triad[1], triad[2])
        size = min(_length(out, wide), _length(into, wide))
        problem = _misplaced(data[form.size :])
        if transport & _TRANSPORT_CLASS != _MESSAGES:
            problem = CLASS_NOT_SUPPORTED
        elif problem is None and not 64 <= size <= _LARGEST[code]:
            problem = BAD_SIZE
        elif problem is None and any(one.triad == key for one in self.open.values()):
            problem = DUPLICATE
        elif problem is None and len(self.open) >= limit:
            problem = NO_MORE
        if problem is not None:
            return _refused(code, problem, key)
        opened = Connection(own_id=self._next, peer_id=peer, triad=key, size=size, carrier=carrier)
        self._next += 1
        self.open[opened.own_id] = opened
        answer = struct.pack("<IIHHIIIBB", opened.own_id, peer, *key, out_interval, in_interval, 0, 0)
        return Reply(service=code, data=answer)

    def forward_close(self, code: int, data: bytes) -> Reply:
        """Close a connection by its triad."""
        if len(data) < 12 or len(data) != 12 + 2 * data[10]:
            return Reply(service=code, status=TOO_LITTLE_DATA)
        key: Triad = struct.unpack_from("<HHI", data, 2)
        found = next((one for one in self.open.values() if one.triad == key), None)
        if found is None:
            return _refused(code, NOT_FOUND, key)
        del self.open[found.own_id]
        return Reply(service=code, data=struct.pack("<HHIBB", *key, 0, 0))

    def ended(self, carrier: int) -> None:
        """Close what was opened on a TCP connection that has ended (volume 2, 2-5.5: it goes with its carrier)."""
        left = [one for one in self.open.values() if one.carrier == carrier]
        self.forgotten += len(left)
        for one in left:
            del self.open[one.own_id]


def _length(parameters: int, wide: bool) -> int:
    return parameters & (0xFFFF if wide else 0x01FF)


def _refused(code: int, reason: int, key: Triad) -> Reply:
    return Reply(service=code, status=_FAILED, extended=(reason,), data=struct.pack("<HHIBB", *key, 0, 0))


def _misplaced(route: bytes) -> int | None:
    """Return why a connection path does not lead to the message router of this controller; None if it does."""
    try:
        path = Path.parse(route)
    except Refusal:
        return BAD_SEGMENT
    if (problem := route_of(path.ports)) is not None:
        return problem
    return None if (path.class_id, path.instance) == _ROUTER and not path.steps else BAD_SEGMENT


def route_of(ports: tuple[tuple[int, bytes], ...]) -> int | None:
    """Return why hops do not lead to this controller, the only module of its chassis; None if they do."""
    for port, link in ports:
        if port != _BACKPLANE:
            return NO_SUCH_PORT
        if link != bytes([_SLOT]):
            return NO_SUCH_LINK
    return None if len(ports) <= 1 else NO_SUCH_PORT


def misrouted(route: bytes) -> Reply | None:
    """Return the answer to an Unconnected Send whose route does not lead to this controller; None if it does, or there is none."""
    try:
        problem = route_of(Path.parse(route).ports)
    except Refusal:
        problem = BAD_SEGMENT
    if problem is None:
        return None
    # One word of the route is left, the one that leads nowhere.
    return Reply(service=UNCONNECTED_SEND, status=_FAILED, extended=(problem,), data=b"\x01\0")
