"""Decoder of EtherNet/IP for recorded frames; :mod:`pytest_otmcp.wire.ethernetip` says what their bytes mean.

Registering a session, and opening and closing connections for messages, ask the plant for nothing.
"""

from __future__ import annotations

import struct
from typing import Any

from ...wire.ethernetip.asked import asked_for, content_of
from ...wire.ethernetip.describe import described_reply
from ...wire.ethernetip.frames import LIST_IDENTITY, NOP, REGISTER, SEND_RR_DATA, SEND_UNIT_DATA, UNREGISTER, Frame
from ...wire.framing import MalformedError
from ..conversation import Direction, Message, Outstanding

__all__ = ["EthernetIpConversation"]

_KEPT = 300
_SESSION = ("forward_open", "forward_close")
_ANSWERS = {"request": "response", "register": "register_response", "list": "list_response"} | {
    kind: f"{kind}_response" for kind in _SESSION
}


class EthernetIpConversation:
    """One connection. Answers repeat the sender contexts of their requests, those on a CIP connection its sequence counts."""

    def __init__(self) -> None:
        self._outstanding = Outstanding()
        self._peers: dict[int, int] = {}
        """Connection id of the controller to that of the client, as forward opens were answered."""

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``register``, ``unregister``,
        ``list``, ``forward_open``, ``forward_close``, ``request``, the first of them and the last three with ``…response``."""
        try:
            read = Frame.parse(frame, answer=direction == "out")
            if read.command == NOP:
                return []
            if read.command == UNREGISTER:
                return [Message(direction=direction, kind="unregister", fields={"frame": frame.hex()})]
            kind, fields = _fields(direction, read)
        except (MalformedError, IndexError) as error:
            told = {"bytes": frame[:_KEPT].hex(), "reason": str(error)}
            return [Message(direction=direction, kind="malformed", fields=told)]
        by_context = (read.command, read.context)
        if direction == "out":
            return [self._answer(kind, {**fields, "frame": frame.hex()}, by_context)]
        message = Message(
            direction="in",
            kind=kind,
            fields={**{name: one for name, one in fields.items() if name != "state_changing"}, "frame": frame.hex()},
            request=kind == "request",
            state_changing=bool(fields.get("state_changing")),
        )
        self._outstanding.add(by_context, message)
        if "sequence" in fields:
            peer = self._peers.get(fields["connection_id"], 0)
            self._outstanding.add((peer, fields["sequence"]), message)
        return [message]

    def _answer(self, kind: str, fields: dict[str, Any], by_context: tuple[int, bytes]) -> Message:
        key = (fields.pop("connection_id"), fields.pop("sequence")) if "sequence" in fields else by_context
        asked = self._outstanding.take(key)
        if asked is None:
            return Message(direction="out", kind=kind, fields=fields)
        if asked.kind != "register" and "service" in asked.fields:
            fields["service"] = asked.fields["service"]
        kind = _ANSWERS[asked.kind]
        if kind == "forward_open_response" and not fields.get("status") and fields.get("items"):
            own, peer = struct.unpack_from("<II", bytes.fromhex(fields["items"][0].get("data", "")).ljust(8, b"\0"))
            self._peers[own] = peer
        return Message(direction="out", kind=kind, fields=fields, answers=asked)


def _fields(direction: Direction, frame: Frame) -> tuple[str, dict[str, Any]]:
    """Return the kind of a message, and what it says. An answer's kind is ``response``, whatever it answers.

    Raises:
        MalformedError, IndexError: it carries none.
    """
    with_packet = frame.command in (SEND_RR_DATA, SEND_UNIT_DATA)
    if direction == "out":
        if not with_packet or frame.status:
            return "response", {"encapsulation": frame.status} if frame.status else {}
        numbers, message = content_of(frame)
        return "response", {**numbers, **described_reply(message)}
    if with_packet:
        asked = asked_for(frame)
        return asked.kind, dict(asked.fields)
    if frame.command == REGISTER:
        return "register", {"service": "register", "items": [{"asks": "register"}]}
    if frame.command == LIST_IDENTITY:
        asks = "list_identity"
        return "request", {"service": asks, "items": [{"asks": asks}], "state_changing": False}
    return "list", {"command": frame.command}
