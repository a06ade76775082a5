"""The server of classic S7 communication (TPKT, COTP class 0, S7) with journal and fault plan.

It is not a library's server, because a reference must be strict: python-snap7's accepts what its own client sends, malformed
requests included.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from ..journal import Direction
from ..network import Link
from ..peer import process_of
from ..tcp_device import TcpDevice
from .faults import FaultPlan, Rule
from .image import Plant
from .jobs import Session, answer_fields, describe, execute
from .pokes import Restless, poke, restless_bits
from .wire import (
    CONNECT_REQUEST,
    DATA,
    DISCONNECT_REQUEST,
    Connect,
    IllegalFrame,
    Pdu,
    confirm,
    data_frame,
    frame_length,
    refuse,
)

__all__ = ["S7Device"]

_RACK, _SLOT = 0, 1
_GARBAGE = b"\xde\xad\xbe\xef\xff\xff\x00\x01"


class S7Device(TcpDevice):
    """A controller in rack 0, slot 1; a connection to another slot is refused."""

    protocol = "s7"

    def __init__(self) -> None:
        super().__init__()
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.restless: list[Restless] = []

    def connection(self) -> asyncio.Protocol:
        return _Connection(self)

    def image(self) -> dict[str, Any]:
        """Return what :meth:`.image.Plant.image` returns; with bits that turn by themselves also ``restless``."""
        image = self.plant.image()
        return image | ({"restless": [asdict(bits) for bits in self.restless]} if self.restless else {})

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the controller past the protocol: see :mod:`.pokes`, and :mod:`..network` for ``{"network": …}``."""
        if self.network.poke(params):
            return
        if "restless" in params:
            self.restless = restless_bits(self.plant, params["restless"])
        else:
            poke(self.plant, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.restless = []
        self.network.become("open")

    async def tick(self) -> None:
        self.plant.tick()


class _Connection(asyncio.Protocol):
    """One client's connection. Requests are answered in order; a segment may hold several, or a part of one."""

    def __init__(self, device: S7Device) -> None:
        self._device = device
        self._buffer = bytearray()
        self._transport: Link
        self._session: Session | None = None
        """None until the client has connected by COTP."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, Link)
        self._transport = transport
        self._device.connections += 1
        self._number = transport.number = self._device.connections
        peer = transport.get_extra_info("peername")[1]
        self._device.journal.connected(self._number, process_of(transport), peer=peer)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._buffer:
            self._malformed("the connection ended inside a frame")
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
                self._frame(bytes(self._buffer[4:length]))
            except IllegalFrame as fault:
                # A witness drops the connection, so that the frame is not overlooked.
                self._malformed(str(fault))
                self._transport.abort()
                return
            del self._buffer[:length]

    def _frame(self, tpdu: bytes) -> None:
        kind = tpdu[1]
        if kind == CONNECT_REQUEST and self._session is None:
            self._connect(Connect.parse(tpdu))
        elif kind == DISCONNECT_REQUEST:
            self._record("in", "disconnect_request")
            self._transport.close()
        elif kind != DATA or self._session is None:
            raise IllegalFrame(f"COTP: a TPDU {kind:02X} {'before' if self._session is None else 'after'} connecting")
        elif tpdu[0] != 2 or tpdu[2] != 0x80:
            raise IllegalFrame("COTP: a TPDU that is no whole PDU")
        else:
            self._request(self._session, tpdu[3:])

    def _connect(self, request: Connect) -> None:
        place = {"rack": request.rack, "slot": request.slot}
        self._record("in", "connect_request", called=request.called.hex(), calling=request.calling.hex(), **place)
        accepted = (request.rack, request.slot) == (_RACK, _SLOT)
        if self._transport.carries():
            self._record("out", "connect_confirm" if accepted else "connect_refused")
        self._transport.write(confirm(request) if accepted else refuse(request))
        if accepted:
            self._session = Session()
        else:
            self._transport.close()

    def _request(self, session: Session, raw: bytes) -> None:
        request = Pdu.parse(raw)
        fields = describe(request)
        setting_up = fields["service"] == "setup"
        if not session.pdu_size and not setting_up:
            raise IllegalFrame("S7: a request before the agreement on a PDU")
        if session.pdu_size and len(raw) > session.pdu_size:
            raise IllegalFrame(f"S7: a PDU of {len(raw)} bytes, {session.pdu_size} were agreed to")
        rule = self._device.faults.match(fields)
        asked = self._record(
            "in",
            "setup" if setting_up else "request",
            request=not setting_up,
            **fields,
            pdu=raw.hex(),
            **({} if rule is None else {"fault": rule.action}),
        )
        if rule is not None and rule.manner.half_open:
            self._transport.die()
            return
        if not setting_up:
            for bits in self._device.restless:
                bits.move(self._device.plant)
        answer = execute(self._device.plant, session, request, rule)
        if rule is None:
            self._send(asked, fields, answer)
        else:
            self._misbehave(rule, asked, fields, answer)

    def _send(self, asked: int, request: Mapping[str, Any], answer: Pdu, rule: Rule | None = None) -> None:
        """Answer the request that has the sequence number ``asked``, in the manner of a rule."""
        if self._transport.is_closing() or not self._transport.carries():
            return
        pdu = answer.encoded()
        frame = data_frame(pdu)
        fields = {**answer_fields(answer, request), "pdu": pdu.hex()}
        if rule is not None:
            changed = {"truncate": rule.truncate, "drip_s": rule.manner.drip_s or None, "length": rule.length or None}
            fields |= {name: value for name, value in changed.items() if value is not None}
            length = (len(frame) + rule.length) & 0xFFFF
            frame = frame[:2] + length.to_bytes(2) + frame[4:]
            frame = frame[: rule.truncate]
        kind = "setup_response" if request["service"] == "setup" else "response"
        if rule is None or rule.manner.mangle is None:
            self._record("out", kind, answers=asked, **fields)
        if rule is None:
            self._transport.write(frame)
            return
        with self._transport.sending(rule.manner):
            self._transport.write(frame)
        if rule.manner.duplicate:
            self._record("out", kind, answers=asked, **fields, duplicate=True)
            with self._transport.sending(rule.manner):
                self._transport.write(frame)

    def _misbehave(self, rule: Rule, asked: int, request: Mapping[str, Any], answer: Pdu) -> None:
        if rule.drop:
            return
        if rule.close:
            self._transport.close()
            return
        if rule.reset:
            self._transport.reset()
            return
        if rule.garbage:
            if self._transport.carries():
                # The entry answers no request: no client can tell which request the bytes are for.
                self._record("out", "garbage", bytes=_GARBAGE.hex())
                self._transport.write(_GARBAGE)
            return
        send = partial(self._send, asked, request, _falsified(rule, answer), rule)
        if rule.delay_s:
            asyncio.get_running_loop().call_later(rule.delay_s, send)
        else:
            send()


def _falsified(rule: Rule, answer: Pdu) -> Pdu:
    """Return the answer that a rule makes of a right one."""
    reference = (answer.reference + rule.reference) & 0xFFFF
    parameters = bytearray(answer.parameters)
    if rule.answer_function is not None and parameters:
        parameters[0] = rule.answer_function
    if rule.answer_count is not None and len(parameters) == 2:
        parameters[1] = rule.answer_count
    if rule.answer_reference is not None:
        reference = rule.answer_reference
    return replace(answer, reference=reference, parameters=bytes(parameters))
