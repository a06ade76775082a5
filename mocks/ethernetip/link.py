"""One client of the controller: its TCP connection, its session, and the requests that it sends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pytest_otmcp.wire.framing import MalformedError

from ..framed_connection import FramedConnection
from ..tcp_device import TcpDevice
from .answers import Answers, Asked
from .asked import AskedFor, connected_request, unconnected_request
from .connections import misrouted
from .controller import Controller
from .faults import Rule
from .frames import (
    CONNECTED_ADDRESS,
    CONNECTED_DATA,
    LIST_IDENTITY,
    LIST_INTERFACES,
    LIST_SERVICES,
    NOP,
    NULL_ADDRESS,
    REGISTER,
    SEND_RR_DATA,
    SEND_UNIT_DATA,
    UNCONNECTED_DATA,
    UNREGISTER,
    Frame,
    frame_length,
    packet_items,
)
from .identity import identity_item, services_item
from .messages import Reply, Request
from .services import Router, named

__all__ = ["ClientLink"]

_UNKNOWN_COMMAND, _BAD_DATA, _BAD_SESSION, _BAD_LENGTH, _BAD_VERSION = 0x01, 0x03, 0x64, 0x65, 0x69
_CONNECTED = ((CONNECTED_ADDRESS, 4, 4), (CONNECTED_DATA, 4, 0xFFFF))
_UNCONNECTED = ((NULL_ADDRESS, 0, 0), (UNCONNECTED_DATA, 2, 0xFFFF))
"""The first items of a packet that carries a request: type, and least and most number of bytes."""
_LARGEST_UNCONNECTED = 504


class ClientLink(FramedConnection[TcpDevice]):
    """One client's TCP connection. Requests are answered in order."""

    garbage = b"\xde\xad\x08\x00" + b"\xff\xff\x00\x01" * 7
    """As long as its length says, and no command."""

    def __init__(self, device: TcpDevice, controller: Controller) -> None:
        super().__init__(device, frame_length)
        self._controller = controller
        self._answers = Answers(self)
        self._session = 0

    def connection_lost(self, exc: Exception | None) -> None:
        self._controller.sessions.discard(self._session)
        self._controller.connections.ended(self.number)
        super().connection_lost(exc)

    # -- encapsulation ----------------------------------------------------------------------------------------

    def frame(self, raw: bytes) -> None:
        frame = Frame.parse(raw)
        if frame.command in (SEND_RR_DATA, SEND_UNIT_DATA):
            self._data(frame, raw)
        elif frame.command == REGISTER:
            self._register(frame, raw)
        elif frame.command == UNREGISTER:
            self.record("in", "unregister", frame=raw.hex())
            self.transport.close()
        elif frame.command == LIST_IDENTITY:
            self._list_identity(frame, raw)
        elif frame.command != NOP:
            self._list(frame, raw)

    def _list(self, frame: Frame, raw: bytes) -> None:
        known = {LIST_SERVICES: services_item(), LIST_INTERFACES: b"\0\0"}
        asked = self.record("in", "list", command=frame.command, frame=raw.hex())
        data = known.get(frame.command)
        status = _UNKNOWN_COMMAND if data is None else 0
        self._answers.write(asked, "list_response", replace(frame, data=data or b"", status=status))

    def _list_identity(self, frame: Frame, raw: bytes) -> None:
        fields: dict[str, Any] = {"service": "list_identity", "items": [{"asks": "list_identity"}]}
        rule = self._rule(fields)
        seq = self.record("in", "request", request=True, **fields, frame=raw.hex(), **_shown(rule))
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        asked = Asked(seq=seq, kind="request", frame=frame, fields=fields)
        answer = replace(frame, data=identity_item(self._controller.address))
        self._answers.send(asked, rule, answer, service="list_identity")

    def _register(self, frame: Frame, raw: bytes) -> None:
        fields: dict[str, Any] = {"service": "register", "items": [{"asks": "register"}]}
        rule = self._rule(fields)
        seq = self.record("in", "register", **fields, frame=raw.hex(), **_shown(rule))
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        status = 0
        if len(frame.data) != 4:
            status = _BAD_LENGTH
        elif frame.data != b"\x01\0\0\0":
            status = _BAD_VERSION
        elif self._session:
            status = _UNKNOWN_COMMAND
        else:
            # The number of the connection makes handles unique, and the rest makes them no small numbers.
            self._session = 0x4B000000 | self.number & 0xFFFFFF
            self._controller.sessions.add(self._session)
        answer = replace(frame, session=self._session, status=status, data=b"\x01\0\0\0")
        self._answers.send(Asked(seq=seq, kind="register", frame=frame, fields=fields), rule, answer)

    def _data(self, frame: Frame, raw: bytes) -> None:
        items = packet_items(frame.data)
        connected = frame.command == SEND_UNIT_DATA
        if items is None or not _fit(items, _CONNECTED if connected else _UNCONNECTED):
            reason = "encapsulation: no packet that carries a request"
            self.record("in", "malformed", bytes=raw[:300].hex(), reason=reason)
            self.transport.write(replace(frame, data=b"", status=_BAD_DATA).encoded())
            return
        content = items[1][1]
        if connected:
            asked_for = connected_request(int.from_bytes(items[0][1], "little"), content)
        else:
            asked_for = unconnected_request(content)
        if not self._session or frame.session != self._session:
            seq = self._enter(asked_for, raw, None)
            self._answers.write(
                seq, "response", replace(frame, data=b"", status=_BAD_SESSION), service=asked_for.fields["service"]
            )
        elif connected:
            self._connected(frame, raw, asked_for, len(content))
        else:
            self._unconnected(frame, raw, asked_for)

    def _enter(self, asked_for: AskedFor, raw: bytes, rule: Rule | None) -> int:
        is_request = asked_for.kind == "request"
        fields = {**asked_for.fields, "frame": raw.hex(), **_shown(rule)}
        return self.record("in", asked_for.kind, request=is_request, **fields)

    # -- requests ---------------------------------------------------------------------------------------------

    def _connected(self, frame: Frame, raw: bytes, asked_for: AskedFor, size: int) -> None:
        fields = asked_for.fields
        count = fields["sequence"]
        connection = self._controller.connections.open.get(fields["connection_id"])
        known = connection is not None and count != connection.count
        rule = self._rule(fields) if known else None
        seq = self._enter(asked_for, raw, rule)
        if connection is None:
            # No controller answers on a connection that it does not know (volume 1, 3-4.4).
            return
        if size > connection.size:
            raise MalformedError(f"CIP: a message of {size} bytes, {connection.size} were agreed to")
        asked = Asked(seq=seq, kind="request", frame=frame, fields=fields, connection=connection, count=count)
        if not known:
            # The transport repeats what it has answered already (volume 1, 3-4.4.2): nothing is executed.
            if connection.last is not None:
                self._answers.reply(asked, None, connection.last)
            return
        connection.count, connection.last = count, None
        self._execute(asked, rule, asked_for, limit=connection.size - 2)

    def _unconnected(self, frame: Frame, raw: bytes, asked_for: AskedFor) -> None:
        rule = self._rule(asked_for.fields)
        seq = self._enter(asked_for, raw, rule)
        asked = Asked(seq=seq, kind=asked_for.kind, frame=frame, fields=asked_for.fields)
        if asked_for.fields["service"] in ("forward_open", "forward_close") and not asked_for.route:
            self._manage(asked, rule, asked_for.message)
        else:
            self._execute(asked, rule, asked_for, limit=_LARGEST_UNCONNECTED)

    def _rule(self, fields: Mapping[str, Any]) -> Rule | None:
        plant = self._controller.plant
        about = list(fields["items"])
        if fields["service"] == "multiple":
            about.append({"asks": "multiple"})
        return self._controller.faults.match([(item, named(plant, item)) for item in about])

    def _execute(self, asked: Asked, rule: Rule | None, asked_for: AskedFor, *, limit: int) -> None:
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        for bits in self._controller.restless:
            bits.move(self._controller.plant)
        message = asked_for.message
        reply = misrouted(asked_for.route)
        if reply is None and (rule is None or rule.encapsulation is None):
            reply = Router(plant=self._controller.plant, limit=limit, rule=rule).answer(message)
        self._answers.reply(asked, rule, reply or Reply(service=message[0]))

    def _manage(self, asked: Asked, rule: Rule | None, message: bytes) -> None:
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        request, connections = Request.parse(message), self._controller.connections
        if rule is not None and rule.status is not None:
            extended = () if rule.extended is None else (rule.extended,)
            reply = Reply(service=request.service, status=rule.status, extended=extended)
        elif asked.fields["service"] == "forward_close":
            reply = connections.forward_close(request.service, request.data)
        else:
            limit = self._controller.plant.connection_limit
            reply = connections.forward_open(request.service, request.data, self.number, limit)
        self._answers.reply(asked, rule, reply)


def _fit(items: Sequence[tuple[int, bytes]], wanted: Sequence[tuple[int, int, int]]) -> bool:
    """Tell whether the first items of a packet are those of a request; others may follow (addresses of sockets)."""
    return len(items) >= len(wanted) and all(
        kind == expected and least <= len(content) <= most
        for (kind, content), (expected, least, most) in zip(items, wanted, strict=False)
    )


def _shown(rule: Rule | None) -> dict[str, Any]:
    """Return the member with which the journal says which fault applies to a request."""
    return {} if rule is None else {"fault": rule.action}
