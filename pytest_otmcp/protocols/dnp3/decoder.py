"""Decoder of DNP3 for recorded link frames; :mod:`pytest_otmcp.wire.dnp3` says what their bytes mean.

Confirmations and the acknowledgements of the link layer ask the plant for nothing; a request for the status of the link does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...wire.dnp3.application import (
    BROADCASTS,
    CONFIRM,
    DIRECT_OPERATE_NR,
    UNSOLICITED_RESPONSE,
    Request,
    response_fields,
)
from ...wire.dnp3.link import (
    CONFIRMED_USER_DATA,
    FIRST,
    REQUEST_LINK_STATUS,
    UNCONFIRMED_USER_DATA,
    LinkFrame,
    Reassembly,
)
from ...wire.framing import MalformedError
from ..conversation import Direction, Message, Outstanding

__all__ = ["Dnp3Conversation"]


_KEPT = 300


class Dnp3Conversation:
    """One connection. Responses repeat the application sequence numbers of their requests."""

    def __init__(self) -> None:
        self._segments: Mapping[Direction, Reassembly] = {"in": Reassembly(), "out": Reassembly()}
        self._frames: Mapping[Direction, list[bytes]] = {"in": [], "out": []}
        """Frames of the fragment that is being put together."""
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one link frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request``, ``confirm``,
        ``response``, ``unsolicited``, ``link_request`` and ``link_answer``."""
        try:
            link = LinkFrame.parse(frame)
            if link.from_master != (direction == "in"):
                raise MalformedError("link: the direction bit is that of the other side")
            if not link.primary or link.function not in (UNCONFIRMED_USER_DATA, CONFIRMED_USER_DATA):
                return [self._link(direction, link)]
            fragment = self._segments[direction].take(link.data)
            frames = self._frames[direction]
            if link.data[0] & FIRST:
                frames.clear()
            frames.append(frame)
            return [] if fragment is None else [self._fragment(direction, link, fragment, tuple(frames))]
        except MalformedError as error:
            return [_malformed(direction, frame, str(error))]

    def _link(self, direction: Direction, header: LinkFrame) -> Message:
        fields: dict[str, object] = {"link_function": header.function}
        if not header.primary:
            answered = self._outstanding.take("link") if direction == "out" else None
            return Message(direction=direction, kind="link_answer", fields=fields, answers=answered)
        status = direction == "in" and header.function == REQUEST_LINK_STATUS
        message = Message(
            direction=direction,
            kind="link_request",
            fields={**fields, "source": header.source, "destination": header.destination},
            request=status,
        )
        if direction == "in":
            self._outstanding.add("link", message)
        return message

    def _fragment(self, direction: Direction, header: LinkFrame, fragment: bytes, frames: tuple[bytes, ...]) -> Message:
        shown = _shown(direction, fragment)
        kind, request, changing = (shown.pop(name) for name in ("kind", "request", "state_changing"))
        if direction == "out":
            answered = self._outstanding.take(shown["sequence"]) if kind == "response" else None
            fields = {**shown, "apdu": fragment.hex()}
            return Message(direction="out", kind=kind, fields=fields, answers=answered, frames=frames)
        message = Message(
            direction="in",
            kind=kind,
            fields={**shown, "source": header.source, "destination": header.destination, "apdu": fragment.hex()},
            request=request,
            state_changing=changing,
            frames=frames,
        )
        if request and header.destination not in BROADCASTS and shown["function"] != DIRECT_OPERATE_NR:
            self._outstanding.add(shown["sequence"], message)
        return message


def _malformed(direction: Direction, frame: bytes, reason: str) -> Message:
    return Message(direction=direction, kind="malformed", fields={"bytes": frame[:_KEPT].hex(), "reason": reason})


def _shown(direction: Direction, fragment: bytes) -> dict[str, Any]:
    """Return what an application fragment says.

    Raises:
        MalformedError: it is none of this direction.
    """
    if direction == "out":
        shown = response_fields(fragment)
        kind = "unsolicited" if shown["function"] == UNSOLICITED_RESPONSE else "response"
        return {**shown, "kind": kind, "request": False, "state_changing": False}
    request = Request.parse(fragment)
    asks = request.function != CONFIRM
    kind = "request" if asks else "confirm"
    return {**request.described(), "kind": kind, "request": asks, "state_changing": request.state_changing}
