"""Decoder of PROFIBUS telegrams for recorded bytes.

Telegrams, addresses and frame control: IEC 61158-4-3 (EN 50170 volume 2, part 4); services and their access points: part 8 of the same.
Whether a Data_Exchange changes outputs cannot be read in its bytes: the conversation remembers those before it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..conversation import Direction, Message
from ..journal import JournalEntry
from ..reread import difference

__all__ = ["ANSWERS", "ProfibusConversation", "contradiction"]

ANSWERS = frozenset({("response", "request"), ("response", "cycle")})
"""Kinds of entries of which the first can answer the second."""

_SHORT = bytes([0xE5])
_SERVICES = {
    0x37: "set_slave_add",
    0x38: "rd_inp",
    0x39: "rd_outp",
    0x3A: "global_control",
    0x3B: "get_cfg",
    0x3C: "slave_diag",
    0x3D: "set_prm",
    0x3E: "chk_cfg",
}
_OF_MASTERS = 0x3E
_WITH_REPLY, _WITHOUT_ANSWER, _STATUS = (12, 13), (4, 6), 9
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
        except ValueError as error:
            told = {"bytes": frame[:_KEPT].hex(), "reason": str(error)}
            return [Message(direction=direction, kind="malformed", fields=told)]
        fields["telegram"] = frame.hex()
        kind = fields.pop("kind")
        if direction == "out":
            return [self._answer(fields)]
        if kind == "message" and frame[:1] == b"\xdc":
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
        ValueError: it is none.
    """
    if frame == _SHORT:
        return {"kind": "message"} if direction == "in" else {"kind": "response", "status": None, "data": ""}
    if frame[:1] == b"\xdc" and len(frame) == 3:
        return {"kind": "message"}
    destination, source, control, rest = _body(frame)
    saps: list[int | None] = []
    for address in (destination, source):
        sap = None
        if address & 0x80:
            if not rest or rest[0] > 0x3F:
                raise ValueError("an address extension that is no service access point")
            sap, rest = rest[0], rest[1:]
        saps.append(sap)
    asks = bool(control & 0x40)
    if asks != (direction == "in"):
        if direction == "in":
            return {"kind": "message"}
        raise ValueError("a request in the direction of answers")
    if not asks:
        return {
            "kind": "response",
            "master": destination & 0x7F,
            "station": source & 0x7F,
            "status": control & 0x0F,
            "data": rest.hex(),
        }
    service = _service(control & 0x0F, *saps)
    told: dict[str, Any] = {
        "kind": "request",
        "service": service,
        "station": destination & 0x7F,
        "master": source & 0x7F,
        "function": control & 0x0F,
        "dsap": saps[0],
        "ssap": saps[1],
        "data": rest.hex(),
    }
    if control & 0x10:
        told["count"] = bool(control & 0x20)
    if service == "set_prm" and len(rest) >= 7:
        told["ident"] = rest[4:6].hex()
    return told


def _body(frame: bytes) -> tuple[int, int, int, bytes]:
    start = frame[0] if frame else 0
    if start == 0x10 and len(frame) == 6:
        body = frame[1:4]
    elif start == 0xA2 and len(frame) == 14:
        body = frame[1:12]
    elif start == 0x68 and len(frame) >= 10 and frame[1] == frame[2] == len(frame) - 6 and frame[3] == 0x68:
        body = frame[4:-2]
    else:
        raise ValueError("it has no start or length of a telegram")
    if frame[-2] != sum(body) % 256 or frame[-1] != 0x16:
        raise ValueError("its checksum or its end is wrong")
    return body[0], body[1], body[2], body[3:]


def _service(function: int, dsap: int | None, ssap: int | None) -> str:
    if function == _STATUS:
        return "fdl_status"
    if function in _WITH_REPLY and dsap is None and ssap is None:
        return "data_exchange"
    if function not in (*_WITH_REPLY, *_WITHOUT_ANSWER) or ssap != _OF_MASTERS or dsap is None:
        return "other"
    service = _SERVICES.get(dsap, "other")
    return service if (service == "global_control") == (function in _WITHOUT_ANSWER) else "other"


def contradiction(entry: JournalEntry) -> str | None:
    """Say where an entry differs from its telegram; None where it does not."""
    members: Mapping[str, Any] = dict(entry)
    # What came in with a telegram is a request, whatever it is called; what went out may have been damaged on the way.
    if entry["kind"] not in ("request", "cycle", "response") and (
        entry["direction"] == "out" or "telegram" not in members
    ):
        return None
    try:
        shown = _fields(entry["direction"], bytes.fromhex(members["telegram"]))
    except (KeyError, TypeError, ValueError):
        return f"has no telegram but {members.get('telegram')!r}"
    if entry["kind"] == "token":
        shown["kind"] = "token"
    elif shown["kind"] == "request" and shown["service"] == "data_exchange":
        # Which of the two it is depends on what the slave held.
        shown["kind"] = entry["kind"] if entry["kind"] in ("request", "cycle") else "request"
    if shown["kind"] in ("request", "cycle"):
        shown["request"] = shown["kind"] == "request"
    return difference(members, shown, "telegram")
