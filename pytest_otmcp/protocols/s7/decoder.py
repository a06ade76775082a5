"""Decoder of classic S7 communication for recorded bytes.

TPKT: RFC 1006, section 6. COTP class 0: ITU-T X.224, section 13. S7 itself was never published; the layout of its header, jobs and
user data is the one that is publicly known (Wireshark's dissector). Requests are described as far as their bytes go, also those
that the controller refuses: the bytes that arrived are evidence. Connecting and the agreement on a PDU ask the plant for nothing.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from ...wire.framing import MalformedError
from ..conversation import Direction, Message, Outstanding
from ..journal import JournalEntry
from ..reread import difference

__all__ = ["ANSWERS", "S7Conversation", "contradiction", "tpkt_length"]

_PROTOCOL = 0x32
JOB, ACK, ACK_DATA, USER_DATA = 1, 2, 3, 7
READ, WRITE, SETUP = 0x04, 0x05, 0xF0
SUCCESS = 0xFF

STATE_CHANGING_JOBS = frozenset({WRITE, 0x1A, 0x1B, 0x1C, 0x28, 0x29})
"""Jobs that can change the controller: write, download, control (start, compress, copy to ROM), stop."""
STATE_CHANGING_USER_DATA = frozenset({(7, 2)})
"""Function group and subfunction: setting the clock."""

_SERVICES = {SETUP: "setup", READ: "read", WRITE: "write", 0x28: "control", 0x29: "stop"}
_INFORMATION = {(4, 1): "szl", (7, 1): "clock", (7, 2): "set_clock"}
_COTP = {0xE0: "connect_request", 0xD0: "connect_confirm", 0x80: "disconnect_request"}
ANSWERS = frozenset({("response", "request"), ("setup_response", "setup")})
"""Kinds of entries of which the first can answer the second."""
_CALLING, _CALLED = 0xC1, 0xC2
_LENGTH_IN_BITS = frozenset({3, 4, 5})
_KEPT = 300


def tpkt_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the TPKT at the beginning of the buffer.

    Raises:
        MalformedError: the version is not 3, or the length is impossible.
    """
    if buffer and buffer[0] != 3:
        raise MalformedError(f"the version of the TPKT is {buffer[0]}, it must be 3")
    if len(buffer) < 4:
        return None
    length = int.from_bytes(buffer[2:4], "big")
    if length < 7:
        raise MalformedError(f"the length of the TPKT is {length}, it must be 7 or more")
    return length


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
        if kind is not None:
            return [self._transport(direction, kind, tpdu)]
        raw = tpdu[3:]
        if tpdu[1] != 0xF0 or len(raw) < 10 or raw[0] != _PROTOCOL:
            return [_malformed(direction, frame, "it is no S7 PDU")]
        kinds = (JOB, USER_DATA) if direction == "in" else (ACK, ACK_DATA, USER_DATA)
        if raw[1] not in kinds:
            return [_malformed(direction, frame, f"a PDU of the kind {raw[1]} in this direction")]
        try:
            fields = _fields(direction, raw)
        except (struct.error, IndexError):
            return [_malformed(direction, frame, "its lengths do not fit")]
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
            tsaps = _parameters(tpdu[7:])
            called = tsaps.get(_CALLED, b"")
            fields = {"called": called.hex(), "calling": tsaps.get(_CALLING, b"").hex()}
            if len(called) == 2:
                fields |= {"rack": called[1] >> 5, "slot": called[1] & 0x1F}
        return Message(direction=direction, kind=kind, fields=fields)


def _malformed(direction: Direction, frame: bytes, reason: str) -> Message:
    return Message(direction=direction, kind="malformed", fields={"bytes": frame[:_KEPT].hex(), "reason": reason})


def _parameters(rest: bytes) -> dict[int, bytes]:
    found: dict[int, bytes] = {}
    while len(rest) >= 2:
        found[rest[0]], rest = rest[2 : 2 + rest[1]], rest[2 + rest[1] :]
    return found


def _fields(direction: Direction, raw: bytes) -> dict[str, Any]:
    """Return what a PDU says.

    Raises:
        struct.error, IndexError: it is cut off.
    """
    reference, parameters, data = struct.unpack_from(">HHH", raw, 4)
    head = 12 if raw[1] in (ACK, ACK_DATA) else 10
    if len(raw) != head + parameters + data:
        raise IndexError
    fields: dict[str, Any] = {"reference": reference}
    head_of_it, content = raw[head : head + parameters], raw[head + parameters :]
    if direction == "in":
        return fields | _request(raw[1], head_of_it, content)
    if raw[1] == USER_DATA:
        error = int.from_bytes(head_of_it[10:12], "big")
        return fields | {"error": error or None, "code": content[0] if content else None, "items": []}
    error = int.from_bytes(raw[10:12], "big")
    return fields | {"error": error or None, "items": _results(head_of_it, content)}


def _request(kind: int, parameters: bytes, data: bytes) -> dict[str, Any]:
    if kind == USER_DATA:
        return _information(parameters, data)
    function = parameters[0]
    fields: dict[str, Any] = {
        "service": _SERVICES.get(function, "other"),
        "function": function,
        "state_changing": function in STATE_CHANGING_JOBS,
    }
    if function in (READ, WRITE):
        items = _addresses(parameters)
        if items is not None:
            if function == WRITE:
                for item, content in zip(items, _written(len(items), data), strict=False):
                    item["data"] = content.hex()
            fields["items"] = items
    return fields


def _information(parameters: bytes, data: bytes) -> dict[str, Any]:
    if len(parameters) not in (8, 12):
        return {"service": "other", "state_changing": False}
    group = parameters[5] & 0x0F, parameters[6]
    fields: dict[str, Any] = {
        "service": _INFORMATION.get(group, "other"),
        "group": group[0],
        "subfunction": group[1],
        "state_changing": group in STATE_CHANGING_USER_DATA,
    }
    if fields["service"] == "szl" and len(data) == 8:
        fields["szl_id"], fields["szl_index"] = struct.unpack_from(">HH", data, 4)
    return fields


def _addresses(parameters: bytes) -> list[dict[str, Any]] | None:
    """Return the variables that a job names by ANY pointers; None where it names them otherwise."""
    items = []
    if len(parameters) < 2 or len(parameters) != 2 + 12 * parameters[1] or not parameters[1]:
        return None
    for start in range(2, len(parameters), 12):
        specification, length, syntax, transport, count, db, area = struct.unpack_from(">BBBBHHB", parameters, start)
        if (specification, length, syntax) != (0x12, 10, 0x10):
            return None
        address = int.from_bytes(parameters[start + 9 : start + 12], "big")
        place = {"area": area, "db": db, "byte": address // 8, "bit": address % 8}
        items.append({**place, "transport": transport, "count": count})
    return items


def _written(count: int, data: bytes) -> list[bytes]:
    """Return the bytes for each variable of a write; none where the data does not add up."""
    found = []
    for number in range(count):
        if len(data) < 4:
            return []
        length = int.from_bytes(data[2:4], "big")
        size = (length + 7) // 8 if data[1] in _LENGTH_IN_BITS else length
        if len(data) < 4 + size:
            return []
        found.append(data[4 : 4 + size])
        # Data of an odd length is padded, except for the last.
        data = data[4 + size + (size % 2 if number < count - 1 else 0) :]
    return [] if data else found


def _results(parameters: bytes, data: bytes) -> list[dict[str, Any]]:
    """Return code and data of each variable that an answer is about."""
    function = parameters[0] if parameters else None
    if function == WRITE:
        return [{"code": code} for code in data]
    found: list[dict[str, Any]] = []
    while function == READ and len(data) >= 4:
        code, transport, length = struct.unpack_from(">BBH", data)
        size = (length + 7) // 8 if transport in (4, 5) else length
        found.append({"code": code, "data": data[4 : 4 + size].hex()} if code == SUCCESS else {"code": code})
        data = data[4 + size + size % 2 :]
    return found


def contradiction(entry: JournalEntry) -> str | None:
    """Say where an entry differs from its PDU; None where it does not."""
    members: Mapping[str, Any] = dict(entry)
    # What came in with a PDU is a request, whatever it is called; what went out may have been damaged on the way.
    known = entry["kind"] in ("request", "response", "setup", "setup_response")
    if not known and (entry["direction"] == "out" or "pdu" not in members):
        return "is called a request, and has no PDU" if entry["request"] else None
    try:
        raw = bytes.fromhex(members["pdu"])
        if raw[0] != _PROTOCOL:
            raise ValueError
        shown = _fields(entry["direction"], raw)
    except (KeyError, TypeError, ValueError, IndexError, struct.error):
        return f"has no PDU but {members.get('pdu')!r}"
    if entry["direction"] == "in":
        setting_up = shown["service"] == "setup"
        shown |= {"kind": "setup" if setting_up else "request", "request": not setting_up}
    return difference(members, shown, "PDU")
