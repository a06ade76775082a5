"""Lines of the toy protocol and what they say: the device reads them, and the kit makes journal entries of them."""

from __future__ import annotations

from typing import Any

from pytest_otmcp.protocols.conversation import Direction, Message

__all__ = ["ToyConversation", "line_length", "parsed"]

_KINDS = {"R": "read", "W": "write", "V": "value", "K": "written", "E": "error"}


def parsed(line: bytes) -> dict[str, Any]:
    """Return the kind of a line, and the numbers that it names."""
    letter, *numbers = line.decode("ascii", "replace").split() or [""]
    names = zip(("address", "value"), map(int, numbers), strict=False)
    kind = _KINDS.get(letter, "malformed")
    return {"kind": kind, **dict(names), "request": kind in ("read", "write"), "state_changing": kind == "write"}


def line_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the line at the beginning of the buffer; None while its end has not come."""
    return buffer.find(b"\n") + 1 or None


class ToyConversation:
    """One connection: the device answers in the order in which it is asked."""

    def __init__(self) -> None:
        self._asked: list[Message] = []

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """See :class:`pytest_otmcp.protocols.conversation.Conversation`."""
        fields = parsed(frame)
        contract = {name: fields.pop(name) for name in ("kind", "request", "state_changing")}
        answers = self._asked.pop(0) if direction == "out" and self._asked else None
        message = Message(direction=direction, answers=answers, fields=fields, **contract)
        if direction == "in":
            self._asked.append(message)
        return [message]
