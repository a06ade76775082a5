"""Decoder of BACnet/IP for recorded datagrams, written from the standard's description alone.

ASHRAE 135: annex J (virtual link), clause 6.2 (network layer), 20.1 (APDUs), 15 and 16 (services). Requests are described as far as
they can be read, also those that the device refuses.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..conversation import Direction, Message, Outstanding
from ..journal import JournalEntry
from ..reread import difference
from .tags import NotTagged, Reader

__all__ = ["ANSWERS", "CHANGING", "CHANGING_UNCONFIRMED", "BacnetConversation", "contradiction"]

READ, READ_MULTIPLE, WRITE, WRITE_MULTIPLE = 12, 14, 15, 16
I_AM, I_HAVE, WHO_HAS, WHO_IS = 0, 1, 7, 8
CHANGING = frozenset({0, 7, 8, 9, 10, 11, 15, 16, 17, 20, 27})
"""Confirmed services that may change the device. Reads and subscriptions, which only a client's own list of notifications has, may not."""
CHANGING_UNCONFIRMED = frozenset({6, 9, 10, 12})
"""Time synchronization, UTC time synchronization, write group, you-are."""

_CARRIES = {0x04: 10, 0x0A: 4, 0x0B: 4}
"""Functions of the virtual link that carry a network message: forwarded, unicast, broadcast; and where that begins."""
_LINK_REQUESTS, _LINK_CHANGES = frozenset({1, 2, 5, 6, 8, 9}), frozenset({1, 8})
_CONFIRMED, _UNCONFIRMED, _SIMPLE_ACK, _COMPLEX_ACK, _SEGMENT_ACK, _ERROR, _REJECT, _ABORT = range(8)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Decoded:
    """A datagram as an entry shows it; ``key`` is what an answer shares with its request."""

    kind: str
    fields: Mapping[str, Any] = field(default_factory=dict)
    request: bool = False
    state_changing: bool = False
    key: Hashable = None


class _Malformed(Exception):
    pass


class BacnetConversation:
    """The datagrams of one client."""

    def __init__(self) -> None:
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one datagram, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request``, ``response``,
        ``message`` for APDUs that ask and answer nothing, ``bvlc``, ``network-message`` and ``malformed``."""
        found = _decoded(direction, frame)
        answers = self._outstanding.take(found.key) if direction == "out" and found.key is not None else None
        message = Message(
            direction=direction,
            kind=found.kind,
            fields={**found.fields, "bytes": frame.hex()},
            request=found.request,
            state_changing=found.state_changing,
            answers=answers,
        )
        if found.request:
            self._outstanding.add(found.key, message)
        return [message]


ANSWERS = frozenset({("response", "request"), ("bvlc", "bvlc")})
"""Kinds of entries of which the first can answer the second."""

_READ = ("request", "response", "message", "bvlc")
_UNREAD = ("malformed", "network-message")
"""Kinds of datagrams that say nothing to the device."""


def contradiction(entry: JournalEntry) -> str | None:
    """Say where an entry differs from its datagram; None where it does not."""
    members: Mapping[str, Any] = dict(entry)
    # What came in with bytes is what they say, whatever it is called; what went out may have been damaged on the way.
    came = entry["direction"] == "in" and "bytes" in members and entry["kind"] not in _UNREAD
    if entry["kind"] not in _READ and not came:
        return "is called a request, and has no datagram to ask with" if entry["request"] else None
    try:
        datagram = bytes.fromhex(members["bytes"])
    except (KeyError, TypeError, ValueError):
        return f"has no datagram but {members.get('bytes')!r}"
    found = _decoded(entry["direction"], datagram)
    shown = {"kind": found.kind, "request": found.request, "state_changing": found.state_changing, **found.fields}
    return difference(members, shown, "datagram")


def _decoded(direction: Direction, datagram: bytes) -> _Decoded:
    try:
        return _link(direction, datagram)
    except (_Malformed, IndexError, NotTagged):
        return _Decoded(kind="malformed")


def _link(direction: Direction, datagram: bytes) -> _Decoded:
    if len(datagram) < 4 or datagram[0] != 0x81 or int.from_bytes(datagram[2:4]) != len(datagram):
        raise _Malformed
    function = datagram[1]
    if function not in _CARRIES:
        asks = direction == "in" and function in _LINK_REQUESTS
        return _Decoded(
            kind="bvlc",
            fields={"function": function},
            request=asks,
            state_changing=asks and function in _LINK_CHANGES,
            key="bvlc" if asks or function == 0 else None,
        )
    return _network(direction, datagram[_CARRIES[function] :])


def _network(direction: Direction, npdu: bytes) -> _Decoded:
    if npdu[0] != 1:
        raise _Malformed
    control, position, elsewhere = npdu[1], 2, False
    if control & 0x20:
        elsewhere = npdu[position : position + 2] != b"\xff\xff"
        position += 3 + npdu[position + 2]
    if control & 0x08:
        position += 3 + npdu[position + 2]
    if control & 0x20:
        position += 1
    if control & 0x80:
        return _Decoded(kind="network-message", fields={"message": npdu[position] if len(npdu) > position else None})
    if elsewhere and direction == "in":
        return _Decoded(kind="network-message", fields={"message": None})
    return _apdu(direction, npdu[position:])


def _apdu(direction: Direction, apdu: bytes) -> _Decoded:
    kind = apdu[0] >> 4
    if kind == _UNCONFIRMED:
        return _unconfirmed(direction, apdu[1], apdu[2:])
    if kind == _CONFIRMED:
        is_segmented = bool(apdu[0] & 0x08)
        at = 5 if is_segmented else 3
        service, invoke_id = apdu[at], apdu[2]
        fields: dict[str, Any] = {"pdu_type": kind, "service": service, "invoke_id": invoke_id}
        if direction == "out":
            return _Decoded(kind="message", fields=fields)
        return _Decoded(
            kind="request",
            fields=fields if is_segmented else {**fields, **_asked(service, apdu[at + 1 :])},
            request=True,
            state_changing=service in CHANGING,
            key=invoke_id,
        )
    fields = {"pdu_type": kind, "invoke_id": apdu[1]}
    if kind in (_SIMPLE_ACK, _COMPLEX_ACK, _ERROR):
        at = 4 if kind == _COMPLEX_ACK and apdu[0] & 0x08 else 2
        fields["service"] = apdu[at]
        if direction == "out":
            fields |= _answered(kind, apdu[at], apdu[at + 1 :], is_part=at == 4)
    if direction == "in":
        return _Decoded(kind="message", fields=fields)
    if kind in (_REJECT, _ABORT):
        fields["reject" if kind == _REJECT else "abort"] = apdu[2]
    is_answer = kind in (_SIMPLE_ACK, _COMPLEX_ACK, _ERROR, _REJECT, _ABORT)
    return _Decoded(kind="response" if is_answer else "message", fields=fields, key=apdu[1] if is_answer else None)


def _unconfirmed(direction: Direction, service: int, data: bytes) -> _Decoded:
    fields: dict[str, Any] = {"pdu_type": _UNCONFIRMED, "service": service}
    reader = Reader(data)
    if direction == "out":
        if service in (I_AM, I_HAVE):
            shown = reader.value()
            (_, instance) = shown["value"] if isinstance(shown["value"], list) else (None, None)
            key = "who-is" if service == I_AM else "who-has"
            return _Decoded(kind="response", fields={**fields, "device": instance}, key=key)
        return _Decoded(kind="message", fields=fields)
    changes = service in CHANGING_UNCONFIRMED
    if service == WHO_IS:
        if not reader.done:
            fields |= _bounds(reader)
            if not reader.done:
                raise _Malformed
        return _Decoded(kind="request", fields=fields, request=True, key="who-is")
    if service == WHO_HAS:
        if reader.sees("context", 0):
            fields |= _bounds(reader)
        fields |= {"object": reader.identifier(2)} if reader.sees("context", 2) else {"name": reader.text(3)}
        return _Decoded(kind="request", fields=fields, request=True, key="who-has")
    return _Decoded(
        kind="request" if changes else "message", fields=fields, request=changes, state_changing=changes, key="other"
    )


def _bounds(reader: Reader) -> dict[str, int]:
    return {"low": reader.unsigned(0), "high": reader.unsigned(1)}


def _reference(reader: Reader, target: list[int], first: int) -> dict[str, Any]:
    found: dict[str, Any] = {"object": target, "property": reader.unsigned(first)}
    if reader.sees("context", first + 1):
        found["index"] = reader.unsigned(first + 1)
    return found


def _asked(service: int, data: bytes) -> dict[str, Any]:
    """Return what a request reads or writes; nothing of one that cannot be read."""
    reader = Reader(data)
    try:
        if service == READ:
            return {"reads": [_reference(reader, reader.identifier(0), 1)]}
        if service == READ_MULTIPLE:
            return {"reads": _several(reader, _reference)}
        if service == WRITE:
            return {"writes": [_written(reader, reader.identifier(0), 1)]}
        if service == WRITE_MULTIPLE:
            return {"writes": _several(reader, _written)}
    except NotTagged:
        pass
    return {}


def _written(reader: Reader, target: list[int], first: int) -> dict[str, Any]:
    written = _reference(reader, target, first)
    written["values"] = reader.values(first + 2)
    if reader.sees("context", first + 3):
        written["priority"] = reader.unsigned(first + 3)
    return written


def _several(reader: Reader, one: Callable[[Reader, list[int], int], dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what a request asks for at the properties of several objects."""
    found = []
    while not reader.done:
        target = reader.identifier(0)
        reader.passes("open", 1)
        while reader.sees("context", 0):
            found.append(one(reader, target, 0))
        reader.passes("close", 1)
    if not found:
        raise NotTagged
    return found


def _answered(kind: int, service: int, data: bytes, *, is_part: bool) -> dict[str, Any]:
    reader = Reader(data)
    if kind == _ERROR and service == WRITE_MULTIPLE:
        return {"error": [one["value"] for one in reader.values(0)]}
    if kind == _ERROR:
        return {"error": [reader.value()["value"], reader.value()["value"]]}
    if kind != _COMPLEX_ACK or is_part:
        return {}
    if service == READ:
        found = _reference(reader, reader.identifier(0), 1)
        return {"results": [{**found, "values": reader.values(3, constructed=True)}]}
    if service != READ_MULTIPLE:
        return {}
    results = []
    while not reader.done:
        target = reader.identifier(0)
        reader.passes("open", 1)
        while not reader.sees("close", 1):
            found = _reference(reader, target, 2)
            if reader.sees("open", 5):
                found["error"] = [one["value"] for one in reader.values(5)]
            else:
                found["values"] = reader.values(4, constructed=True)
            results.append(found)
        reader.passes("close", 1)
    return {"results": results}
