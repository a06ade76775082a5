"""Decoder of DNP3 for recorded bytes: application fragments in transport segments in link frames (IEEE 1815).

Requests are described as far as their bytes go, also those that the outstation refuses. Confirmations and the acknowledgements of the
link layer ask the plant for nothing; a request for the status of the link does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...wire.framing import MalformedError
from ..conversation import Direction, Message, Outstanding
from ..journal import JournalEntry
from ..reread import difference
from .wire import LinkHeader, Segments, objects_of, unpack_frame

__all__ = ["ANSWERS", "Dnp3Conversation", "contradiction"]

ANSWERS = frozenset({("response", "request"), ("unsolicited", "request"), ("link_answer", "link_request")})
"""Kinds of entries of which the first can answer the second; a faulty device calls an answer unsolicited."""

CONFIRM, READ, WRITE, SELECT, OPERATE, DIRECT_OPERATE, DIRECT_OPERATE_NR = range(7)
RESPONSE, UNSOLICITED_RESPONSE = 129, 130

READS = frozenset({READ})
HOUSEKEEPING = frozenset({20, 21, 23, 24})
"""Functions that masters use for the session: enabling and disabling unsolicited responses, measuring the delay, recording the time.
Beside them, a WRITE that clears the restart bit (g80v1, index 7) or sets the clock (g50) is housekeeping. Every other function may change
the plant: writing, selecting and operating, freezing, restarts, applications, configuration, classes, files."""

_WITH_OBJECTS = frozenset({WRITE, SELECT, OPERATE, DIRECT_OPERATE, DIRECT_OPERATE_NR, RESPONSE, UNSOLICITED_RESPONSE})
_USER_DATA = frozenset({3, 4})
_REQUEST_LINK_STATUS = 9
_BROADCASTS = range(0xFFFD, 0x10000)
_KEPT = 300


class Dnp3Conversation:
    """One connection. Responses repeat the application sequence numbers of their requests."""

    def __init__(self) -> None:
        self._segments: Mapping[Direction, Segments] = {"in": Segments(), "out": Segments()}
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one link frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request``, ``confirm``,
        ``response``, ``unsolicited``, ``link_request`` and ``link_answer``."""
        unpacked = unpack_frame(frame)
        if unpacked is None:
            return [_malformed(direction, frame, "a check sum of the link frame is wrong")]
        header, data = unpacked
        if header.from_master != (direction == "in"):
            return [_malformed(direction, frame, "the direction bit is that of the other side")]
        if not header.primary or header.function not in _USER_DATA:
            return [self._link(direction, header)]
        try:
            fragment = self._segments[direction].add(data)
            return [] if fragment is None else [self._fragment(direction, header, fragment)]
        except MalformedError as error:
            return [_malformed(direction, frame, str(error))]

    def _link(self, direction: Direction, header: LinkHeader) -> Message:
        fields: dict[str, object] = {"link_function": header.function}
        if not header.primary:
            answered = self._outstanding.take("link") if direction == "out" else None
            return Message(direction=direction, kind="link_answer", fields=fields, answers=answered)
        status = direction == "in" and header.function == _REQUEST_LINK_STATUS
        message = Message(
            direction=direction,
            kind="link_request",
            fields={**fields, "source": header.source, "destination": header.destination},
            request=status,
        )
        if direction == "in":
            self._outstanding.add("link", message)
        return message

    def _fragment(self, direction: Direction, header: LinkHeader, fragment: bytes) -> Message:
        shown = _shown(direction, fragment)
        kind, request, changing = (shown.pop(name) for name in ("kind", "request", "state_changing"))
        if direction == "out":
            answered = self._outstanding.take(shown["sequence"]) if kind == "response" else None
            return Message(direction="out", kind=kind, fields={**shown, "apdu": fragment.hex()}, answers=answered)
        message = Message(
            direction="in",
            kind=kind,
            fields={**shown, "source": header.source, "destination": header.destination, "apdu": fragment.hex()},
            request=request,
            state_changing=changing,
        )
        if request and header.destination not in _BROADCASTS and shown["function"] != DIRECT_OPERATE_NR:
            self._outstanding.add(shown["sequence"], message)
        return message


def _malformed(direction: Direction, frame: bytes, reason: str) -> Message:
    return Message(direction=direction, kind="malformed", fields={"bytes": frame[:_KEPT].hex(), "reason": reason})


def _shown(direction: Direction, fragment: bytes) -> dict[str, Any]:
    """Return what an application fragment says.

    Raises:
        MalformedError: it is none of this direction.
    """
    head = 2 if direction == "in" else 4
    if len(fragment) < head:
        raise MalformedError("an application fragment without its header")
    control, function = fragment[0], fragment[1]
    if control & 0xC0 != 0xC0:
        raise MalformedError("an application fragment that is a part of a message")
    if (function in (RESPONSE, UNSOLICITED_RESPONSE)) != (direction == "out") or function > UNSOLICITED_RESPONSE:
        raise MalformedError(f"the function {function} in this direction")
    shown: dict[str, Any] = {"function": function, "sequence": control & 0x0F}
    if function == CONFIRM:
        unsolicited = {"unsolicited": bool(control & 0x10)}
        return {**shown, **unsolicited, "kind": "confirm", "request": False, "state_changing": False}
    objects: list[dict[str, Any]] = []
    try:
        objects = objects_of(fragment[head:], with_objects=function in _WITH_OBJECTS)
    except MalformedError as error:
        shown["problem"] = str(error)
    shown["objects"] = objects
    if direction == "out":
        kind = "unsolicited" if function == UNSOLICITED_RESPONSE else "response"
        shown |= {"iin": int.from_bytes(fragment[2:4], "little"), "confirm": bool(control & 0x20)}
        shown.pop("problem", None)
        return {**shown, "kind": kind, "request": False, "state_changing": False}
    keeping = function in READS | HOUSEKEEPING or (function == WRITE and _is_housekeeping(objects))
    return {**shown, "kind": "request", "request": True, "state_changing": not keeping}


def _is_housekeeping(objects: list[dict[str, Any]]) -> bool:
    return bool(objects) and all(
        header["group"] == 50
        or (
            (header["group"], header["variation"]) == (80, 1) and header.get("points") == [{"index": 7, "value": False}]
        )
        for header in objects
    )


def contradiction(entry: JournalEntry) -> str | None:
    """Say where an entry differs from its fragment; None where it does not."""
    members: Mapping[str, Any] = dict(entry)
    # What came in with a fragment is a request or a confirmation, whatever it is called; what went out may have been damaged on the way.
    known = entry["kind"] in ("request", "confirm", "response", "unsolicited")
    if not known and (entry["direction"] == "out" or "apdu" not in members):
        return None
    try:
        shown = _shown(entry["direction"], bytes.fromhex(members["apdu"]))
    except (KeyError, TypeError, ValueError):
        return f"has no fragment but {members.get('apdu')!r}"
    # Why objects cannot be read is said in the words of who read them.
    shown.pop("problem", None)
    return difference(members, shown, "fragment")
