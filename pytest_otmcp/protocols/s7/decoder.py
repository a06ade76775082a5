"""Decoder of classic S7 communication for recorded frames; :mod:`pytest_otmcp.wire.s7` says what their bytes mean.

Connecting and the agreement on a PDU ask the plant for nothing.
"""

from __future__ import annotations

from typing import Any

from ...wire.framing import MalformedError
from ...wire.s7 import ACK, ACK_DATA, DATA, JOB, USER_DATA, Connect, Pdu, answer_fields, request_fields
from ..conversation import Direction, Message, Outstanding

__all__ = ["S7Conversation"]

_COTP = {0xE0: "connect_request", 0xD0: "connect_confirm", 0x80: "disconnect_request"}
_KEPT = 300


class S7Conversation:
    """One connection. Answers repeat the PDU references of their requests."""

    def __init__(self) -> None:
        self._outstanding = Outstanding()
        self._connected = False

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``connect_request``,
        ``connect_confirm``, ``connect_refused``, ``disconnect_request``, ``setup``, ``setup_response``, ``request``,
        ``response``."""
        tpdu = frame[4:]
        kind = _COTP.get(tpdu[1])
        raw = tpdu[3:]
        try:
            if kind is not None:
                return [self._transport(direction, kind, tpdu)]
            if tpdu[1] != DATA:
                raise MalformedError("it is no S7 PDU")
            fields = _fields(direction, raw)
        except MalformedError as error:
            return [_malformed(direction, frame, str(error))]
        return [self._message(direction, raw, fields)]

    def _message(self, direction: Direction, raw: bytes, fields: dict[str, Any]) -> Message:
        key = fields["reference"]
        if direction == "in":
            setting_up = fields["service"] == "setup"
            message = Message(
                direction="in",
                kind="setup" if setting_up else "request",
                fields={**{k: v for k, v in fields.items() if k != "state_changing"}, "pdu": raw.hex()},
                request=not setting_up,
                state_changing=fields["state_changing"],
            )
            self._outstanding.add(key, message)
            return message
        asked = self._outstanding.take(key)
        service = "other" if asked is None else asked.fields["service"]
        kind = "setup_response" if service == "setup" else "response"
        return Message(
            direction="out", kind=kind, fields={"service": service, **fields, "pdu": raw.hex()}, answers=asked
        )

    def _transport(self, direction: Direction, kind: str, tpdu: bytes) -> Message:
        if kind == "disconnect_request" and direction == "out" and not self._connected:
            kind = "connect_refused"
        self._connected = self._connected or kind == "connect_confirm"
        fields: dict[str, object] = {}
        if kind == "connect_request":
            asked = Connect.parse(tpdu)
            fields = {"called": asked.called.hex(), "calling": asked.calling.hex()}
            if len(asked.called) == 2:
                fields |= {"rack": asked.rack, "slot": asked.slot}
        return Message(direction=direction, kind=kind, fields=fields)


def _malformed(direction: Direction, frame: bytes, reason: str) -> Message:
    return Message(direction=direction, kind="malformed", fields={"bytes": frame[:_KEPT].hex(), "reason": reason})


def _fields(direction: Direction, raw: bytes) -> dict[str, Any]:
    """Return what a PDU says.

    Raises:
        MalformedError: it is cut off, or none of this direction.
    """
    pdu = Pdu.parse(raw)
    if pdu.rosctr not in ((JOB, USER_DATA) if direction == "in" else (ACK, ACK_DATA, USER_DATA)):
        raise MalformedError(f"a PDU of the kind {pdu.rosctr} in this direction")
    return request_fields(pdu) if direction == "in" else answer_fields(pdu)
