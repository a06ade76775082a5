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

from pytest_otmcp.wire.framing import MalformedError
from pytest_otmcp.wire.s7 import (
    CONNECT_REQUEST,
    DATA,
    DISCONNECT_REQUEST,
    JOB,
    USER_DATA,
    Connect,
    Pdu,
    confirm,
    data_frame,
    refuse,
    request_fields,
    tpkt_length,
)

from ..framed_connection import FramedConnection
from ..tcp_device import TcpDevice
from .faults import FaultPlan, Rule
from .image import Plant
from .jobs import Session, execute
from .pokes import Restless, poke, restless_bits

__all__ = ["S7Device"]

_RACK, _SLOT = 0, 1


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
        self.network.restored()

    async def tick(self) -> None:
        self.plant.tick()


class _Connection(FramedConnection[S7Device]):
    """One client's connection. Requests are answered in order."""

    def __init__(self, device: S7Device) -> None:
        super().__init__(device, tpkt_length)
        self._session: Session | None = None
        """None until the client has connected by COTP."""

    def frame(self, raw: bytes) -> None:
        tpdu = raw[4:]
        kind = tpdu[1]
        if kind == CONNECT_REQUEST and self._session is None:
            self._connect(raw, Connect.parse(tpdu))
        elif kind == DISCONNECT_REQUEST:
            self.received(raw)
            self.transport.close()
        elif kind != DATA or self._session is None:
            raise MalformedError(f"COTP: a TPDU {kind:02X} {'before' if self._session is None else 'after'} connecting")
        elif tpdu[0] != 2 or tpdu[2] != 0x80:
            raise MalformedError("COTP: a TPDU that is no whole PDU")
        else:
            self._request(self._session, raw, tpdu[3:])

    def _connect(self, raw: bytes, request: Connect) -> None:
        if len(request.called) != 2:
            raise MalformedError("COTP: a connection request without a called TSAP of two bytes")
        self.received(raw)
        accepted = (request.rack, request.slot) == (_RACK, _SLOT)
        self.send(confirm(request) if accepted else refuse(request), None)
        if accepted:
            self._session = Session()
        else:
            self.transport.close()

    def _request(self, session: Session, raw: bytes, pdu: bytes) -> None:
        request = Pdu.parse(pdu)
        if request.rosctr not in (JOB, USER_DATA) or not request.parameters:
            raise MalformedError("S7: no header of a job or of user data")
        fields = request_fields(request)
        setting_up = fields["service"] == "setup"
        if not session.pdu_size and not setting_up:
            raise MalformedError("S7: a request before the agreement on a PDU")
        if session.pdu_size and len(pdu) > session.pdu_size:
            raise MalformedError(f"S7: a PDU of {len(pdu)} bytes, {session.pdu_size} were agreed to")
        rule = self.device.faults.match(fields)
        asked = self.received(raw, rule)
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        if not setting_up:
            for bits in self.device.restless:
                bits.move(self.device.plant)
        answer = execute(self.device.plant, session, request, rule)
        if rule is None:
            self.send(data_frame(answer.encoded()), asked)
        else:
            self.misbehave(rule, partial(self._falsify, asked, _falsified(rule, answer), rule))

    def _falsify(self, asked: int, answer: Pdu, rule: Rule) -> None:
        """Send the answer that a rule has made to a request."""
        said: dict[str, Any] = {}
        frame = data_frame(answer.encoded())
        if rule.length:
            frame = frame[:2] + ((len(frame) + rule.length) & 0xFFFF).to_bytes(2) + frame[4:]
            said = {"length": rule.length}
        self.send(frame, asked, rule, **said)


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
