"""The outstation on TCP, with journal and fault plan.

It is not a library's server, because a reference must be strict: what a master sends is told from its bytes, and what is wrong with
them ends the connection, so that it is not overlooked.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from pytest_otmcp.wire.dnp3.application import BROADCASTS, CONFIRM, DIRECT_OPERATE_NR, READ, Request
from pytest_otmcp.wire.dnp3.link import (
    ACK,
    CONFIRMED_USER_DATA,
    LINK_STATUS,
    NOT_SUPPORTED,
    REQUEST_LINK_STATUS,
    RESET_LINK_STATES,
    TEST_LINK_STATES,
    UNCONFIRMED_USER_DATA,
    LinkFrame,
    Reassembly,
    link_length,
    segments,
)
from pytest_otmcp.wire.framing import MalformedError

from ..framed_connection import FramedConnection
from ..tcp_device import TcpDevice
from .faults import FaultPlan, Rule
from .outstation import Answer, Session, execute, unsolicited
from .plant import Event, Plant
from .pokes import CLASSES, poke
from .tampering import altered, falsified

__all__ = ["ADDRESS", "Dnp3Device"]

ADDRESS = 10
"""Link address of the outstation."""
_CONFIRMED_WITHIN_S = 1.0
"""Seconds for which the confirmation of an unsolicited response is waited for."""


def _now_ms() -> int:
    return time.time_ns() // 1_000_000


class Dnp3Device(TcpDevice):
    """An outstation with the link address 10, for masters of any address."""

    protocol = "dnp3"

    def __init__(self) -> None:
        super().__init__()
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.open: set[_Connection] = set()

    def connection(self) -> asyncio.Protocol:
        return _Connection(self)

    def image(self) -> dict[str, Any]:
        """Return what :meth:`.plant.Plant.image` returns."""
        return self.plant.image()

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the outstation past the protocol: see :mod:`.pokes`, and :mod:`..network` for ``{"network": …}``."""
        if self.network.poke(params):
            return
        if "unsolicited" in params:
            if not CLASSES.accepts(params["unsolicited"]):
                raise ValueError(f"unsolicited: expected {CLASSES.expected}, found {params['unsolicited']!r}")
            for connection in list(self.open):
                connection.tell(set(params["unsolicited"]))
            return
        poke(self.plant, params, _now_ms())
        self._report()

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.plant = Plant()
        self.faults = FaultPlan([])
        for connection in self.open:
            connection.session.unconfirmed.clear()
        self.network.restored()

    async def tick(self) -> None:
        self.plant.tick(_now_ms())
        self._report()

    def _report(self) -> None:
        """Send what waits to the masters that want it unasked."""
        for connection in list(self.open):
            connection.report()


class _Connection(FramedConnection[Dnp3Device]):
    """One master's connection. Requests are answered in order."""

    def __init__(self, device: Dnp3Device) -> None:
        super().__init__(device, link_length)
        self._reassembly = Reassembly()
        self._segment = 0
        self._master = 1
        self._told_at = 0.0
        self.session = Session()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.device.open.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self.device.open.discard(self)
        super().connection_lost(exc)

    # -- link layer -------------------------------------------------------------------------------------------

    def frame(self, raw: bytes) -> None:
        frame = LinkFrame.parse(raw)
        if not frame.from_master:
            raise MalformedError("link: a frame with the direction of an outstation")
        if not frame.primary:
            self.received(raw)
            return
        if frame.function in (UNCONFIRMED_USER_DATA, CONFIRMED_USER_DATA):
            fragment = self._reassembly.take(frame.data)
            if fragment is not None:
                self._fragment(raw, Request.parse(fragment), frame)
                return
            self.received(raw)
            self._acknowledge(frame)
            return
        status = frame.function == REQUEST_LINK_STATUS
        rule = self.device.faults.match(None) if status and frame.destination == ADDRESS else None
        asked = self.received(raw, rule)
        if frame.destination != ADDRESS:
            return
        known = {RESET_LINK_STATES: ACK, TEST_LINK_STATES: ACK, REQUEST_LINK_STATUS: LINK_STATUS}
        answer = known.get(frame.function, NOT_SUPPORTED)
        if rule is None:
            self._link_answer(asked, answer, frame.source)
        elif rule.manner.half_open:
            self.transport.die()
        else:
            self.misbehave(rule, partial(self._link_answer, asked, answer, frame.source, rule))

    def _link_answer(self, asked: int | None, function: int, master: int, rule: Rule | None = None) -> None:
        frame = LinkFrame(function=function, primary=False, from_master=False, destination=master, source=ADDRESS)
        raw = frame.encoded()
        self.send(raw if rule is None else altered(rule, raw), asked, rule, frames=(raw,))

    def _acknowledge(self, frame: LinkFrame) -> None:
        if frame.function == CONFIRMED_USER_DATA and frame.destination == ADDRESS:
            self._link_answer(None, ACK, frame.source)

    # -- application layer --------------------------------------------------------------------------------------

    def _fragment(self, raw: bytes, request: Request, frame: LinkFrame) -> None:
        if request.function == CONFIRM:
            self.received(raw)
            self._acknowledge(frame)
            self._confirmed(request)
            return
        ours = frame.destination == ADDRESS
        repeated = ours and self.session.last is not None and self.session.last[0] == request.fragment
        rule = self.device.faults.match(request) if ours else None
        asked = self.received(raw, rule, **({"repeated": True} if repeated else {}))
        self._acknowledge(frame)
        if not ours and frame.destination not in BROADCASTS:
            return
        if rule is not None and rule.manner.half_open:
            self.transport.die()
            return
        self._master = frame.source
        if rule is not None and rule.unsolicited:
            self.tell({1})
        answer = self._executed(request, rule, repeated)
        if not ours:
            # Nobody answers what is for every outstation; the next answer says that it came.
            self.session.broadcast = True
            return
        if request.function == DIRECT_OPERATE_NR:
            return
        if rule is None:
            self._send(answer, asked)
        else:
            self.misbehave(rule, partial(self._send, falsified(rule, answer), asked, rule))

    def _executed(self, request: Request, rule: Rule | None, repeated: bool) -> Answer:
        """Return the answer to a request, which is executed unless it has been: a master that misses an answer sends the same request
        again (clause 4.2.2.4). A read is simply done again."""
        if repeated and request.function != READ and self.session.last is not None:
            return self.session.last[1]
        now = asyncio.get_running_loop().time()
        answer = execute(self.device.plant, self.session, request, rule, now, _now_ms(), self._being_told(now))
        self.session.last = request.fragment, answer
        return answer

    def _being_told(self, now: float) -> list[Event]:
        """Return the events of the last unsolicited response, as long as its confirmation may come: told twice, each would be two."""
        if now - self._told_at > _CONFIRMED_WITHIN_S:
            return []
        return [event for (_, unasked), events in self.session.unconfirmed.items() if unasked for event in events]

    def _confirmed(self, request: Request) -> None:
        events = self.session.unconfirmed.pop((request.sequence, request.unsolicited), None)
        if events is not None:
            self.device.plant.confirmed(events)
            self.report()

    def report(self) -> None:
        """Send the events that the master wants unasked, unless it has not confirmed the last ones yet."""
        waiting = self.device.plant.waiting(self.session.classes)
        if waiting and not any(unasked for _, unasked in self.session.unconfirmed):
            self.tell(self.session.classes)

    def tell(self, classes: set[int]) -> None:
        """Send an unsolicited response with the events of these classes, which may be none."""
        self._told_at = asyncio.get_running_loop().time()
        self._send(unsolicited(self.device.plant, self.session, classes), None)

    def _send(self, answer: Answer, asked: int | None, rule: Rule | None = None) -> None:
        """Send an answer to the request that has the sequence number ``asked``, in the manner of a rule."""
        if not self.carries():
            return
        if answer.confirm:
            key = answer.sequence, answer.unsolicited
            self.session.unconfirmed = {
                one: events for one, events in self.session.unconfirmed.items() if one[1] != answer.unsolicited
            } | {key: answer.events}
        fragment = answer.encoded()
        source = ADDRESS if rule is None or rule.answer_source is None else rule.answer_source
        parts = segments(fragment, self._segment)
        self._segment = (self._segment + len(parts)) & 0x3F
        frames = [
            LinkFrame(
                function=UNCONFIRMED_USER_DATA,
                primary=True,
                from_master=False,
                destination=self._master,
                source=source,
                data=part,
            ).encoded()
            for part in parts
        ]
        raw, said = b"".join(frames), {}
        if rule is not None:
            changed = {"length": rule.length or None, "source": rule.answer_source}
            said = {name: value for name, value in changed.items() if value is not None}
            raw = altered(rule, raw)
        self.send(raw, asked, rule, frames=frames, **said)
