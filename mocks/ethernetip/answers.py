"""The answers of the controller on one TCP connection: right, or in the manner of a fault rule."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pytest_otmcp.wire.ethernetip.frames import (
    CONNECTED_ADDRESS,
    CONNECTED_DATA,
    NULL_ADDRESS,
    UNCONNECTED_DATA,
    Frame,
    packet,
)
from pytest_otmcp.wire.ethernetip.messages import Reply

from ..framed_connection import FramedConnection
from .connections import Connection
from .faults import Rule

__all__ = ["Answers", "Asked", "carried"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """A request that is answered.

    Attributes:
        seq: number of its record.
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


class Answers:
    """Sends answers."""

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
        self.send(asked, rule, frame)

    def send(self, asked: Asked, rule: Rule | None, answer: Frame) -> None:
        """Answer, in the manner of a rule."""
        if rule is None:
            self._client.send(answer.encoded(), asked.seq)
            return
        if rule.encapsulation is not None:
            answer = replace(answer, status=rule.encapsulation, data=b"")
        if rule.context:
            answer = replace(answer, context=bytes([answer.context[0] ^ rule.context]) + answer.context[1:])
        self._client.misbehave(rule, partial(self._falsify, asked, answer, rule))

    def _falsify(self, asked: Asked, answer: Frame, rule: Rule) -> None:
        raw, said = answer.encoded(), dict[str, Any]()
        if rule.context or rule.sequence or rule.connection:
            # What it answers cannot be told by its bytes.
            kind = "response" if asked.kind == "request" else f"{asked.kind}_response"
            said |= {"kind": kind, "service": asked.fields["service"]}
        frames = [raw]
        if rule.length:
            said["length"] = rule.length
            raw = raw[:2] + ((len(answer.data) + rule.length) & 0xFFFF).to_bytes(2, "little") + raw[4:]
        self._client.send(raw, asked.seq, rule, frames, **said)
