"""One client of the controller: its TCP connection, its session, and the requests that it sends."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..journal import Direction
from ..network import Link
from ..peer import process_of
from .answers import Answers, Asked, carried
from .connections import connects_data, route_of, unconnected_send
from .describe import describe
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
    IllegalFrame,
    frame_length,
    packet_items,
)
from .identity import identity_item, services_item
from .messages import Path, Refusal, Reply, Request
from .services import Router, named

if TYPE_CHECKING:
    from .device import EthernetIpDevice

__all__ = ["ClientLink"]

_UNKNOWN_COMMAND, _BAD_DATA, _BAD_SESSION, _BAD_LENGTH, _BAD_VERSION = 0x01, 0x03, 0x64, 0x65, 0x69
_CONNECTED = ((CONNECTED_ADDRESS, 4, 4), (CONNECTED_DATA, 4, 0xFFFF))
_UNCONNECTED = ((NULL_ADDRESS, 0, 0), (UNCONNECTED_DATA, 2, 0xFFFF))
"""The first items of a packet that carries a request: type, and least and most number of bytes."""
_UNCONNECTED_SEND = 0x52
_LARGEST_UNCONNECTED = 504
_MANAGER = 0x06


class ClientLink(asyncio.Protocol):
    """One client's TCP connection. Requests are answered in order; a segment may hold several, or a part of one."""

    def __init__(self, device: EthernetIpDevice) -> None:
        self._device = device
        self._buffer = bytearray()
        self._transport: Link
        self._answers: Answers
        self._session = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, Link)
        self._transport = transport
        self._device.links += 1
        self._number = transport.number = self._device.links
        peer = transport.get_extra_info("peername")[1]
        self._device.journal.connected(self._number, process_of(transport), peer=peer)
        self._answers = Answers(self._device.journal, transport)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._buffer:
            self._malformed("the connection ended inside a frame")
        self._device.sessions.discard(self._session)
        self._device.connections.ended(self._number)
        self._record("in", "DISCONNECTED")

    def pause_writing(self) -> None:
        # No more requests are read from a client that does not read its answers: the answers must not accumulate.
        self._transport.pause_reading()

    def resume_writing(self) -> None:
        self._transport.resume_reading()

    def _record(self, direction: Direction, kind: str, **fields: Any) -> int:
        return self._device.journal.append(connection=self._number, direction=direction, kind=kind, **fields)

    def _malformed(self, reason: str) -> None:
        self._record("in", "malformed", bytes=bytes(self._buffer[:300]).hex(), reason=reason)
        self._buffer.clear()

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        while self._buffer and not self._transport.is_closing():
            try:
                length = frame_length(self._buffer)
                if length is None or len(self._buffer) < length:
                    return
                self._frame(bytes(self._buffer[:length]))
            except IllegalFrame as fault:
                # A witness drops the connection, so that the frame is not overlooked.
                self._malformed(str(fault))
                self._transport.abort()
                return
            del self._buffer[:length]

    # -- encapsulation ----------------------------------------------------------------------------------------

    def _frame(self, raw: bytes) -> None:
        frame = Frame.parse(raw)
        if frame.command in (SEND_RR_DATA, SEND_UNIT_DATA):
            self._data(frame, raw)
        elif frame.command == REGISTER:
            self._register(frame, raw)
        elif frame.command == UNREGISTER:
            self._record("in", "unregister", frame=raw.hex())
            self._transport.close()
        elif frame.command == LIST_IDENTITY:
            self._list_identity(frame, raw)
        elif frame.command != NOP:
            self._list(frame, raw)

    def _list(self, frame: Frame, raw: bytes) -> None:
        known = {LIST_SERVICES: services_item(), LIST_INTERFACES: b"\0\0"}
        asked = self._record("in", "list", command=frame.command, frame=raw.hex())
        data = known.get(frame.command)
        status = _UNKNOWN_COMMAND if data is None else 0
        self._answers.write(
            asked, "list_response", replace(frame, data=data or b"", status=status), command=frame.command
        )

    def _list_identity(self, frame: Frame, raw: bytes) -> None:
        fields: dict[str, Any] = {"service": "list_identity", "items": [{"asks": "list_identity"}]}
        rule = self._rule(fields)
        seq = self._record("in", "request", request=True, **fields, frame=raw.hex(), **_shown(rule))
        if rule is not None and rule.manner.half_open:
            self._transport.die()
            return
        asked = Asked(seq=seq, kind="request", frame=frame, fields=fields)
        self._answers.send(asked, rule, replace(frame, data=identity_item(self._device.address)))

    def _register(self, frame: Frame, raw: bytes) -> None:
        fields: dict[str, Any] = {"service": "register", "items": [{"asks": "register"}]}
        rule = self._rule(fields)
        seq = self._record("in", "register", frame=raw.hex(), **_shown(rule))
        if rule is not None and rule.manner.half_open:
            self._transport.die()
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
            self._session = 0x4B000000 | self._number & 0xFFFFFF
            self._device.sessions.add(self._session)
        answer = replace(frame, session=self._session, status=status, data=b"\x01\0\0\0")
        self._answers.send(Asked(seq=seq, kind="register", frame=frame, fields=fields), rule, answer)

    def _data(self, frame: Frame, raw: bytes) -> None:
        items = packet_items(frame.data)
        connected = frame.command == SEND_UNIT_DATA
        wanted = _CONNECTED if connected else _UNCONNECTED
        problem = 0
        if not self._session or frame.session != self._session:
            problem = _BAD_SESSION
        elif items is None or not _fit(items, wanted):
            problem = _BAD_DATA
        if problem or items is None:
            asked = self._record("in", "refused", command=frame.command, frame=raw.hex())
            self._answers.write(asked, "refused_response", replace(frame, data=b"", status=problem), status=problem)
        elif connected:
            self._connected(frame, raw, int.from_bytes(items[0][1], "little"), items[1][1])
        else:
            self._unconnected(frame, raw, items[1][1])

    # -- requests ---------------------------------------------------------------------------------------------

    def _connected(self, frame: Frame, raw: bytes, own_id: int, content: bytes) -> None:
        connection = self._device.connections.open.get(own_id)
        if connection is None:
            # No controller answers on a connection that it does not know (volume 1, 3-4.4).
            self._record("in", "stray", connection_id=own_id, frame=raw.hex())
            return
        if len(content) > connection.size:
            raise IllegalFrame(f"CIP: a message of {len(content)} bytes, {connection.size} were agreed to")
        count, message = int.from_bytes(content[:2], "little"), content[2:]
        if count == connection.count:
            # The transport repeats what it has answered already (volume 1, 3-4.4.2): nothing is executed.
            seq = self._record("in", "repeated", sequence=count, frame=raw.hex())
            if connection.last:
                self._answers.write(seq, "repeated_response", carried(frame, connection, count, connection.last))
            return
        connection.count, connection.last = count, b""
        fields = describe(message)
        rule = self._rule(fields)
        seq = self._record("in", "request", request=True, **fields, sequence=count, frame=raw.hex(), **_shown(rule))
        asked = Asked(seq=seq, kind="request", frame=frame, fields=fields, connection=connection, count=count)
        self._execute(asked, rule, message, limit=connection.size - 2)

    def _unconnected(self, frame: Frame, raw: bytes, message: bytes) -> None:
        route = b""
        fields = describe(message)
        if (fields["items"][0].get("code"), fields["items"][0].get("class")) == (_UNCONNECTED_SEND, _MANAGER):
            try:
                message, route = unconnected_send(Request.parse(message).data)
                fields = {**describe(message), "route": route.hex()}
            except Refusal:
                # It is answered below, as a service that lacks data.
                pass
        service = fields["service"]
        connecting = service in ("forward_open", "forward_close") and not route
        data_wanted = (
            connecting and service == "forward_open" and connects_data(message[0], Request.parse(message).data)
        )
        if data_wanted:
            fields = {**fields, "state_changing": True}
        rule = self._rule(fields)
        kind = service if connecting and not data_wanted else "request"
        if kind != "request":
            fields = {name: value for name, value in fields.items() if name != "state_changing"}
        seq = self._record("in", kind, request=kind == "request", **fields, frame=raw.hex(), **_shown(rule))
        asked = Asked(seq=seq, kind=kind, frame=frame, fields=fields)
        if connecting:
            self._manage(asked, rule, message)
        else:
            self._execute(asked, rule, message, limit=_LARGEST_UNCONNECTED, route=route)

    def _rule(self, fields: Mapping[str, Any]) -> Rule | None:
        plant = self._device.plant
        about = list(fields["items"])
        if fields["service"] == "multiple":
            about.append({"asks": "multiple"})
        return self._device.faults.match([(item, named(plant, item)) for item in about])

    def _execute(self, asked: Asked, rule: Rule | None, message: bytes, *, limit: int, route: bytes = b"") -> None:
        if rule is not None and rule.manner.half_open:
            self._transport.die()
            return
        for bits in self._device.restless:
            bits.move(self._device.plant)
        reply = self._misrouted(message, route)
        if reply is None and (rule is None or rule.encapsulation is None):
            reply = Router(plant=self._device.plant, limit=limit, rule=rule).answer(message)
        self._answers.reply(asked, rule, reply or Reply(service=message[0]))

    @staticmethod
    def _misrouted(message: bytes, route: bytes) -> Reply | None:
        if not route:
            return None
        try:
            problem = route_of(Path.parse(route).ports)
        except Refusal:
            problem = 0x0315
        if problem is None:
            return None
        return Reply(service=_UNCONNECTED_SEND, status=0x01, extended=(problem,), data=b"\x01\0")

    def _manage(self, asked: Asked, rule: Rule | None, message: bytes) -> None:
        if rule is not None and rule.manner.half_open:
            self._transport.die()
            return
        request, connections = Request.parse(message), self._device.connections
        if rule is not None and rule.status is not None:
            extended = () if rule.extended is None else (rule.extended,)
            reply = Reply(service=request.service, status=rule.status, extended=extended)
        elif asked.fields["service"] == "forward_close":
            reply = connections.forward_close(request.service, request.data)
        else:
            limit = self._device.plant.connection_limit
            reply = connections.forward_open(request.service, request.data, self._number, limit)
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
