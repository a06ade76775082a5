"""The answers of the controller on one TCP connection: right, or in the manner of a fault rule."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ..framed_connection import FramedConnection
from .connections import Connection
from .describe import described_reply
from .faults import Rule
from .frames import CONNECTED_ADDRESS, CONNECTED_DATA, NULL_ADDRESS, UNCONNECTED_DATA, Frame, packet
from .messages import Reply

__all__ = ["Answers", "Asked", "carried"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """A request that is answered.

    Attributes:
        seq: of its entry.
        kind: of that entry.
        frame: that it came in.
        fields: the services that it asks for, as the journal has them.
        connection: CIP connection that it came on; None for none.
        count: sequence count there.
    """

    seq: int
    kind: str
    frame: Frame
    fields: Mapping[str, Any]
    connection: Connection | None = None
    count: int = 0


def carried(frame: Frame, connection: Connection, count: int, message: bytes, other: int = 0) -> Frame:
    address = struct.pack("<I", (connection.peer_id + other) & 0xFFFFFFFF)
    content = struct.pack("<H", count & 0xFFFF) + message
    return replace(frame, data=packet((CONNECTED_ADDRESS, address), (CONNECTED_DATA, content)))


def _of(asked: Asked) -> dict[str, Any]:
    """Return the members that an answer has in common with its request."""
    return {"service": asked.fields["service"]}


class Answers:
    """Sends answers, and records them."""

    def __init__(self, client: FramedConnection[Any]) -> None:
        self._client = client

    def reply(self, asked: Asked, rule: Rule | None, reply: Reply) -> None:
        message = reply.encoded()
        if asked.connection is None:
            data = packet((NULL_ADDRESS, b""), (UNCONNECTED_DATA, message))
            frame = replace(asked.frame, data=data)
        else:
            asked.connection.last = reply
            shift, other = (0, 0) if rule is None else (rule.sequence, rule.connection)
            frame = carried(asked.frame, asked.connection, asked.count + shift, message, other)
        self.send(asked, rule, frame, **_of(asked), **described_reply(message))

    def send(self, asked: Asked, rule: Rule | None, answer: Frame, **fields: Any) -> None:
        """Answer, in the manner of a rule."""
        kind = "response" if asked.kind == "request" else f"{asked.kind}_response"
        if rule is None:
            self.write(asked.seq, kind, answer, **fields)
            return
        if rule.encapsulation is not None:
            answer, fields = replace(answer, status=rule.encapsulation, data=b""), _of(asked)
        if rule.context:
            answer = replace(answer, context=bytes([answer.context[0] ^ rule.context]) + answer.context[1:])
        self._client.misbehave(rule, partial(self.write, asked.seq, kind, answer, rule, **fields))

    def write(self, asked: int, kind: str, answer: Frame, rule: Rule | None = None, **fields: Any) -> None:
        """Send an answer to the request that has the sequence number ``asked``, and record it."""
        raw = answer.encoded()
        fields["frame"] = raw.hex()
        if answer.status:
            fields["encapsulation"] = answer.status
        if rule is not None and rule.length:
            fields["length"] = rule.length
            raw = raw[:2] + ((len(answer.data) + rule.length) & 0xFFFF).to_bytes(2, "little") + raw[4:]
        self._client.write(raw, kind, asked, rule, **fields)
