"""Decoder of Modbus TCP for recorded frames; :mod:`pytest_otmcp.wire.modbus` says what their bytes mean.

Every message of a client is a request; the functions of :data:`~pytest_otmcp.wire.modbus.STATE_CHANGING` may change the plant.
"""

from __future__ import annotations

from ...wire.modbus import HEADER, STATE_CHANGING, request_fields, response_fields
from ..conversation import Direction, Message, Outstanding

__all__ = ["ModbusConversation"]


class ModbusConversation:
    """One connection. It remembers requests, so that answers can be read: an answer pads its bits to whole bytes."""

    def __init__(self) -> None:
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request`` and
        ``response``."""
        transaction, protocol, length, unit = HEADER.unpack_from(frame)
        pdu = frame[7:]
        key = (transaction, unit, pdu[0] & 0x7F)
        fields: dict[str, object] = {"unit": unit, "transaction_id": transaction}
        if direction == "in":
            message = Message(
                direction="in",
                kind="request",
                fields={**fields, **request_fields(pdu), "pdu": pdu.hex()},
                request=True,
                state_changing=pdu[0] in STATE_CHANGING,
            )
            self._outstanding.add(key, message)
            return [message]
        asked = self._outstanding.take(key)
        fields |= {**response_fields(pdu, {} if asked is None else asked.fields), "pdu": pdu.hex()}
        if protocol:
            fields["protocol_id"] = protocol
        if length != len(pdu) + 1:
            fields["length"] = length
        return [Message(direction="out", kind="response", fields=fields, answers=asked)]
