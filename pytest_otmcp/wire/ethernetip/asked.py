"""What a packet asks for: the request to the message router, with what is around it."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..framing import MalformedError
from .cip import CONNECTION_MANAGER, LARGE_FORWARD_OPEN, UNCONNECTED_SEND
from .describe import describe
from .frames import (
    CONNECTED_ADDRESS,
    CONNECTED_DATA,
    NULL_ADDRESS,
    SEND_UNIT_DATA,
    UNCONNECTED_DATA,
    Frame,
    packet_items,
)
from .messages import Refusal, Request

__all__ = ["AskedFor", "asked_for", "content_of"]

_TRANSPORT_CLASS = 0x0F
_MESSAGES = (2, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedFor:
    """A request that arrived.

    Attributes:
        kind: of its journal entry: ``request``, ``forward_open`` or ``forward_close``.
        fields: members of that entry.
        message: the request to the message router.
        route: of an Unconnected Send, empty for others.
    """

    kind: str
    fields: Mapping[str, Any]
    message: bytes
    route: bytes = b""


_CONNECTED = ((CONNECTED_ADDRESS, 4, 4), (CONNECTED_DATA, 4, 0xFFFF))
_UNCONNECTED = ((NULL_ADDRESS, 0, 0), (UNCONNECTED_DATA, 2, 0xFFFF))
"""The first items of a packet that carries a message: type, and least and most number of bytes."""


def content_of(frame: Frame) -> tuple[dict[str, int], bytes]:
    """Return the message that a packet carries, and its sequence count and connection id, if it came on a CIP connection.

    Raises:
        MalformedError: it carries none.
    """
    items, connected = packet_items(frame.data), frame.command == SEND_UNIT_DATA
    if items is None or not _fit(items, _CONNECTED if connected else _UNCONNECTED):
        raise MalformedError("encapsulation: no packet that carries a message")
    (_, address), (_, content) = items[:2]
    if not connected:
        return {}, content
    numbers = {"sequence": int.from_bytes(content[:2], "little"), "connection_id": int.from_bytes(address, "little")}
    return numbers, content[2:]


def _fit(items: Sequence[tuple[int, bytes]], wanted: Sequence[tuple[int, int, int]]) -> bool:
    """Tell whether the first items of a packet are those of a message; others may follow (addresses of sockets)."""
    return len(items) >= len(wanted) and all(
        kind == expected and least <= len(content) <= most
        for (kind, content), (expected, least, most) in zip(items, wanted, strict=False)
    )


def asked_for(frame: Frame) -> AskedFor:
    """Return the request that a packet carries.

    Raises:
        MalformedError: it carries none.
    """
    numbers, message = content_of(frame)
    if not numbers:
        return _unconnected(message)
    return AskedFor(kind="request", fields={**describe(message), **numbers}, message=message)


def _unconnected(message: bytes) -> AskedFor:
    """Return the request without a connection; an Unconnected Send holds it."""
    fields = describe(message)
    item: Mapping[str, Any] = next(iter(fields["items"]), {})
    if (item.get("code"), item.get("class")) == (UNCONNECTED_SEND, CONNECTION_MANAGER):
        found = _unwrapped(Request.parse(message).data)
        # What holds none is answered as a service that the connection manager does not have.
        if found is not None:
            message, route = found
            fields = {**describe(message), "route": route.hex()}
            return AskedFor(kind="request", fields=fields, message=message, route=route)
    kind = fields["service"]
    if kind not in ("forward_open", "forward_close"):
        return AskedFor(kind="request", fields=fields, message=message)
    if kind == "forward_open" and _connects_data(message):
        # A connection that carries outputs drives the plant.
        return AskedFor(kind="request", fields={**fields, "state_changing": True}, message=message)
    return AskedFor(kind=kind, fields=fields, message=message)


def _unwrapped(data: bytes) -> tuple[bytes, bytes] | None:
    """Return the request that an Unconnected Send carries, and its route; None where it is cut off."""
    if len(data) < 4:
        return None
    (length,) = struct.unpack_from("<H", data, 2)
    end = 4 + length + length % 2
    if length < 2 or len(data) < end + 2 or len(data) != end + 2 + 2 * data[end]:
        return None
    return data[4 : 4 + length], data[end + 2 :]


def _connects_data(message: bytes) -> bool:
    """Tell whether a forward open asks for a connection that carries data of the plant, not messages."""
    try:
        data = Request.parse(message).data
    except Refusal:
        return False
    place = 38 if message[0] == LARGE_FORWARD_OPEN else 34
    return len(data) > place and data[place] & _TRANSPORT_CLASS not in _MESSAGES
