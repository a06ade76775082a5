"""What a packet asks for: the request to the message router, with what is around it."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .cip import CONNECTION_MANAGER, LARGE_FORWARD_OPEN, UNCONNECTED_SEND
from .describe import describe
from .messages import Refusal, Request

__all__ = ["AskedFor", "connected_request", "unconnected_request"]

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


def connected_request(connection_id: int, content: bytes) -> AskedFor:
    """Return the request on a connection; its sequence count comes first."""
    count, message = int.from_bytes(content[:2], "little"), content[2:]
    fields = {**describe(message), "sequence": count, "connection_id": connection_id}
    return AskedFor(kind="request", fields=fields, message=message)


def unconnected_request(message: bytes) -> AskedFor:
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
