"""Decoder of EtherNet/IP for recorded bytes: encapsulation, sessions, CIP connections.

ODVA's volume 2, chapter 2 (encapsulation, common packet format) and volume 1, 3-5 (forward open), as the public developer guide has
them. Registering a session, and opening and closing connections for messages, ask the plant for nothing.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from ...wire.framing import MalformedError
from ..conversation import Direction, Message, Outstanding
from ..journal import JournalEntry
from ..reread import difference
from .message import asked_of, results_of, unwrapped

__all__ = ["ANSWERS", "EthernetIpConversation", "contradiction", "frame_length"]

NOP, LIST_IDENTITY, REGISTER, UNREGISTER, UNCONNECTED, CONNECTED = 0x00, 0x63, 0x65, 0x66, 0x6F, 0x70

_HEADER = struct.Struct("<HHII8sI")
_LONGEST = 0x1FFF
_KEPT = 300
_SESSION = ("forward_open", "forward_close")
ANSWERS = {"request": "response", "register": "register_response", "list": "list_response"} | {
    kind: f"{kind}_response" for kind in _SESSION
}


def frame_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the frame at the beginning of the buffer.

    Raises:
        MalformedError: it is longer than any message of a Logix controller.
    """
    if len(buffer) < 4:
        return None
    length = int.from_bytes(buffer[2:4], "little")
    if length > _LONGEST:
        raise MalformedError(f"the length of the encapsulation is {length}, it must be {_LONGEST} or less")
    return _HEADER.size + length


class EthernetIpConversation:
    """One connection. Answers repeat the sender contexts of their requests, those on a CIP connection its sequence counts."""

    def __init__(self) -> None:
        self._outstanding = Outstanding()
        self._peers: dict[int, int] = {}
        """Connection id of the controller to that of the client, as forward opens were answered."""

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``register``, ``unregister``,
        ``list``, ``forward_open``, ``forward_close``, ``request``, the first of them and the last three with ``…response``."""
        command, _, _, status, context, options = _HEADER.unpack_from(frame)
        if options or (direction == "in" and status):
            reason = f"status {status:X} and options {options:X} in its header"
            return [_malformed(direction, frame, reason)]
        if command == NOP:
            return []
        if command == UNREGISTER:
            return [Message(direction=direction, kind="unregister", fields={"frame": frame.hex()})]
        try:
            kind, fields = _fields(direction, frame)
        except (struct.error, IndexError, ValueError):
            return [_malformed(direction, frame, "no packet that carries a message")]
        by_context = (command, context)
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
        kind = ANSWERS[asked.kind]
        if kind == "forward_open_response" and not fields.get("status") and fields.get("items"):
            own, peer = struct.unpack_from("<II", bytes.fromhex(fields["items"][0].get("data", "")).ljust(8, b"\0"))
            self._peers[own] = peer
        return Message(direction="out", kind=kind, fields=fields, answers=asked)


def _malformed(direction: Direction, frame: bytes, reason: str) -> Message:
    return Message(direction=direction, kind="malformed", fields={"bytes": frame[:_KEPT].hex(), "reason": reason})


def _fields(direction: Direction, frame: bytes) -> tuple[str, dict[str, Any]]:
    """Return the kind of a message, and what it says. An answer's kind is ``response``, whatever it answers.

    Raises:
        struct.error, IndexError, ValueError: it carries none.
    """
    command, _, _, status, _, _ = _HEADER.unpack_from(frame)
    if direction == "out":
        failed = {"encapsulation": status} if status else {}
        if command not in (UNCONNECTED, CONNECTED) or status:
            return "response", failed
        sequenced, message = _packet(command, frame[_HEADER.size :])
        return "response", {**sequenced, **results_of(message)}
    if command in (UNCONNECTED, CONNECTED):
        return _request(command, frame[_HEADER.size :])
    if command == REGISTER:
        return "register", {"service": "register", "items": [{"asks": "register"}]}
    if command == LIST_IDENTITY:
        asks = "list_identity"
        return "request", {"service": asks, "items": [{"asks": asks}], "state_changing": False}
    return "list", {"command": command}


def _request(command: int, data: bytes) -> tuple[str, dict[str, Any]]:
    sequenced, message = _packet(command, data)
    inner = unwrapped(message) if command == UNCONNECTED else None
    if inner is not None:
        return "request", {**asked_of(inner[0]), "route": inner[1].hex()}
    asked = asked_of(message)
    opening = command == UNCONNECTED and asked["service"] in _SESSION and not asked["state_changing"]
    return (asked["service"] if opening else "request"), {**asked, **sequenced}


def _packet(command: int, data: bytes) -> tuple[dict[str, int], bytes]:
    """Return sequence count and connection id of a packet, if it has them, and the message that it carries.

    Raises:
        struct.error, ValueError: it carries none.
    """
    items = []
    (interface, _, count), rest = struct.unpack_from("<IHH", data), data[8:]
    for _ in range(count):
        kind, length = struct.unpack_from("<HH", rest)
        if len(rest) < 4 + length:
            raise ValueError
        items.append((kind, rest[4 : 4 + length]))
        rest = rest[4 + length :]
    if interface or rest or len(items) < 2:
        raise ValueError
    (address_kind, address), (data_kind, content) = items[:2]
    if command == UNCONNECTED:
        if (address_kind, address, data_kind) != (0, b"", 0xB2) or len(content) < 2:
            raise ValueError
        return {}, content
    if (address_kind, len(address), data_kind) != (0xA1, 4, 0xB1) or len(content) < 4:
        raise ValueError
    numbers = {"sequence": int.from_bytes(content[:2], "little"), "connection_id": int.from_bytes(address, "little")}
    return numbers, content[2:]


def contradiction(entry: JournalEntry) -> str | None:
    """Say where an entry differs from its frame; None where it does not."""
    members: Mapping[str, Any] = dict(entry)
    incoming = entry["direction"] == "in"
    # What came in with a frame is told by the frame, whatever the entry says; what went out may have been damaged on the way.
    if "frame" not in members and entry["kind"] not in ANSWERS | dict.fromkeys(ANSWERS.values()):
        return "is called a request, and has no frame" if entry["request"] else None
    if not incoming and entry["kind"] not in ANSWERS.values():
        return None
    try:
        raw = bytes.fromhex(members["frame"])
        if incoming and raw[0] == UNREGISTER:
            return difference(members, {"kind": "unregister", "request": False, "state_changing": False}, "frame")
        kind, shown = _fields(entry["direction"], raw)
    except (KeyError, TypeError, ValueError, IndexError, struct.error):
        return f"has no frame but {members.get('frame')!r}"
    if incoming:
        shown |= {"kind": kind, "request": kind == "request", "state_changing": bool(shown.get("state_changing"))}
    elif "status" in members and "status" not in shown:
        return "has a status, its frame carries no message that could have one"
    else:
        # An answer's numbers are those of the client's end.
        shown = {name: value for name, value in shown.items() if name not in ("connection_id", "sequence")}
    return difference(members, shown, "frame")
