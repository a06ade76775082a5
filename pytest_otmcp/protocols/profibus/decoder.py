"""Decoder of PROFIBUS telegrams; :mod:`pytest_otmcp.wire.profibus` says what their bytes mean.

Whether a request changes anything cannot be read in its bytes: it depends on the state of the slave, and of a Data_Exchange on the outputs
before it, which the conversation remembers. A mock knows better, and says so.
"""

from __future__ import annotations

from typing import Any

from ...wire.framing import MalformedError
from ...wire.profibus import SHORT_ACKNOWLEDGEMENT, TOKEN, Telegram, request_fields
from ..conversation import Direction, Message

__all__ = ["ProfibusConversation"]


_KEPT = 300


class ProfibusConversation:
    """One line. The slave that was asked last answers before anybody is asked again."""

    def __init__(self) -> None:
        self._asked: Message | None = None
        self._outputs: dict[object, object] = {}

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one telegram, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request``, ``cycle``,
        ``response``, ``token``, ``message``."""
        try:
            fields = _fields(direction, frame)
        except MalformedError as error:
            told = {"bytes": frame[:_KEPT].hex(), "reason": str(error)}
            return [Message(direction=direction, kind="malformed", fields=told)]
        fields["telegram"] = frame.hex()
        kind = fields.pop("kind")
        if direction == "out":
            return [self._answer(fields)]
        if kind == "message" and frame[0] == TOKEN:
            kind = "token"
        if kind != "request":
            return [Message(direction="in", kind=kind, fields=fields)]
        return [self._request(fields)]

    def _request(self, fields: dict[str, Any]) -> Message:
        service, key = fields["service"], (fields["station"], fields["master"])
        cycle = service == "data_exchange" and self._outputs.get(key) == fields["data"]
        if service == "data_exchange":
            self._outputs[key] = fields["data"]
        elif service == "chk_cfg":
            self._outputs.pop(key, None)
        changes = (service == "data_exchange" and not cycle) or service == "set_slave_add"
        self._asked = Message(
            direction="in",
            kind="cycle" if cycle else "request",
            fields=fields,
            request=not cycle,
            state_changing=changes,
            unsure=("kind", "request", "state_changing"),
        )
        return self._asked

    def _answer(self, fields: dict[str, Any]) -> Message:
        asked, self._asked = self._asked, None
        if asked is not None:
            # The short acknowledgement says of itself only that it is one.
            told = {name: asked.fields[name] for name in ("service", "station", "master")}
            fields = told | fields
        return Message(direction="out", kind="response", fields=fields, answers=asked)


def _fields(direction: Direction, frame: bytes) -> dict[str, Any]:
    """Return what a telegram says.

    Raises:
        MalformedError: it is none.
    """
    if frame == bytes([SHORT_ACKNOWLEDGEMENT]):
        return {"kind": "message"} if direction == "in" else {"kind": "response", "status": None, "data": ""}
    if frame[:1] == bytes([TOKEN]) and len(frame) == 3:
        return {"kind": "message"}
    telegram = Telegram.parse(frame)
    if direction == "in":
        return {"kind": "request", **request_fields(telegram)} if telegram.is_request else {"kind": "message"}
    if telegram.is_request:
        raise MalformedError("a request in the direction of answers")
    return {
        "kind": "response",
        "master": telegram.destination,
        "station": telegram.source,
        "status": telegram.function,
        "data": telegram.data.hex(),
    }
