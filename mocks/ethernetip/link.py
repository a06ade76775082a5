"""One client of the controller: its TCP connection, its session, and the requests that it sends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pytest_otmcp.wire.ethernetip.asked import AskedFor, asked_for
from pytest_otmcp.wire.ethernetip.frames import (
    LIST_IDENTITY,
    LIST_INTERFACES,
    LIST_SERVICES,
    NOP,
    REGISTER,
    SEND_RR_DATA,
    SEND_UNIT_DATA,
    UNREGISTER,
    Frame,
    frame_length,
)
from pytest_otmcp.wire.ethernetip.messages import Reply, Request
from pytest_otmcp.wire.framing import MalformedError

from ..framed_connection import FramedConnection
from ..tcp_device import TcpDevice
from .answers import Answers, Asked
from .connections import misrouted
from .controller import Controller
from .faults import Rule
from .identity import identity_item, services_item
from .services import Router, named

__all__ = ["ClientLink"]

_UNKNOWN_COMMAND, _BAD_DATA, _BAD_SESSION, _BAD_LENGTH, _BAD_VERSION = 0x01, 0x03, 0x64, 0x65, 0x69
_LARGEST_UNCONNECTED = 504
_COUNT = 2
"""Bytes of the sequence count before a message on a connection."""


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
            self.received(raw)
            self.transport.close()
        elif frame.command == LIST_IDENTITY:
            self._list_identity(frame, raw)
        elif frame.command != NOP:
            self._list(frame, raw)

    def _list(self, frame: Frame, raw: bytes) -> None:
        known = {LIST_SERVICES: services_item(), LIST_INTERFACES: b"\0\0"}
        asked = self.received(raw)
        data = known.get(frame.command)
        status = _UNKNOWN_COMMAND if data is None else 0
        self.send(replace(frame, data=data or b"", status=status).encoded(), asked)

    def _list_identity(self, frame: Frame, raw: bytes) -> None:
        fields: dict[str, Any] = {"service": "list_identity", "items": [{"asks": "list_identity"}]}
        rule = self._rule(fields)
        seq = self.received(raw, rule)
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        asked = Asked(seq=seq, kind="request", frame=frame, fields=fields)
        answer = replace(frame, data=identity_item(self._controller.address))
        self._answers.send(asked, rule, answer)

    def _register(self, frame: Frame, raw: bytes) -> None:
        fields: dict[str, Any] = {"service": "register", "items": [{"asks": "register"}]}
        rule = self._rule(fields)
        seq = self.received(raw, rule)
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
        try:
            asked = asked_for(frame)
        except MalformedError:
            self.received(raw)
            self.transport.write(replace(frame, data=b"", status=_BAD_DATA).encoded())
            return
        if not self._session or frame.session != self._session:
            self.send(replace(frame, data=b"", status=_BAD_SESSION).encoded(), self.received(raw))
        elif frame.command == SEND_UNIT_DATA:
            self._connected(frame, raw, asked)
        else:
            self._unconnected(frame, raw, asked)

    # -- requests ---------------------------------------------------------------------------------------------

    def _connected(self, frame: Frame, raw: bytes, asks: AskedFor) -> None:
        fields = asks.fields
        count = fields["sequence"]
        connection = self._controller.connections.open.get(fields["connection_id"])
        known = connection is not None and count != connection.count
        rule = self._rule(fields) if known else None
        seq = self.received(raw, rule)
        if connection is None:
            # No controller answers on a connection that it does not know (volume 1, 3-4.4).
            return
        size = len(asks.message) + _COUNT
        if size > connection.size:
            raise MalformedError(f"CIP: a message of {size} bytes, {connection.size} were agreed to")
        asked = Asked(seq=seq, kind="request", frame=frame, fields=fields, connection=connection, count=count)
        if not known:
            # The transport repeats what it has answered already (volume 1, 3-4.4.2): nothing is executed.
            if connection.last is not None:
                self._answers.reply(asked, None, connection.last)
            return
        connection.count, connection.last = count, None
        self._execute(asked, rule, asks, limit=connection.size - 2)

    def _unconnected(self, frame: Frame, raw: bytes, asks: AskedFor) -> None:
        rule = self._rule(asks.fields)
        seq = self.received(raw, rule)
        asked = Asked(seq=seq, kind=asks.kind, frame=frame, fields=asks.fields)
        if asks.fields["service"] in ("forward_open", "forward_close") and not asks.route:
            self._manage(asked, rule, asks.message)
        else:
            self._execute(asked, rule, asks, limit=_LARGEST_UNCONNECTED)

    def _rule(self, fields: Mapping[str, Any]) -> Rule | None:
        plant = self._controller.plant
        about = list(fields["items"])
        if fields["service"] == "multiple":
            about.append({"asks": "multiple"})
        return self._controller.faults.match([(item, named(plant, item)) for item in about])

    def _execute(self, asked: Asked, rule: Rule | None, asks: AskedFor, *, limit: int) -> None:
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        for bits in self._controller.restless:
            bits.move(self._controller.plant)
        message = asks.message
        reply = misrouted(asks.route)
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
