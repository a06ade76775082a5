"""The slaves of a PROFIBUS DP segment with journal and fault plan, at the other end of one serial line.

There is one line and no token ring: every telegram of a master is taken at once, and bit times do not matter. A telegram that repeats
the frame count bit is a repetition, whatever it asks for: the last answer is sent again as it was, and nothing is executed
(IEC 61158-4-3, EN 50170 volume 2, part 4).
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from pytest_otmcp.wire.profibus import BROADCAST, NO_ACKNOWLEDGEMENT, SHORT_ACKNOWLEDGEMENT, TOKEN, Telegram, service_of

from ..device import Device
from ..endpoint import OpenEndpoint
from ..serial_line import SerialLine
from .faults import FaultPlan, Rule
from .plant import Plant
from .pokes import poke
from .receiver import Receiver
from .slave import Reply, Slave

__all__ = ["ProfibusDevice"]

_GARBAGE = b"\xde\xad\xbe\xef\xff\xff\x00\x01"
_SHOWN = 300
_CLEAR, _OPERATE = 0x02, 0x00


@dataclass(slots=True)
class _Last:
    """The last request that a slave executed; whether it told nothing new; what was answered."""

    request: Telegram
    cycle: bool
    reply: Reply


class ProfibusDevice(Device):
    """One segment: the slaves hear every telegram and answer those for them."""

    protocol = "profibus"

    def __init__(self) -> None:
        super().__init__()
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.line = SerialLine(self.journal, self._received)
        self.lines = (self.line,)
        self._receiver = Receiver(self._frame, self._malformed)
        self._client = 0
        self._last: dict[int, _Last] = {}
        self._sent: dict[tuple[int, int], bytes] = {}
        self._cycled: dict[int, tuple[Reply, int]] = {}
        self._driven: set[tuple[int, int, int]] = set()
        """Number of a client, its address as a master, and a station whose outputs it has set."""
        self._watchdogs: dict[int, asyncio.TimerHandle] = {}

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        master = endpoints["profibus"]
        assert isinstance(master, int)
        self.line.open(master)

    async def aclose(self) -> None:
        self.line.close()

    def image(self) -> dict[str, Any]:
        """Return what :meth:`.plant.Plant.image` returns."""
        return self.plant.image()

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the segment past the protocol: see :mod:`.pokes`, and :mod:`..serial_line` for ``{"network": …}``."""
        if not self.line.poke(params):
            poke(self.plant, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        for timer in self._watchdogs.values():
            timer.cancel()
        self.plant, self.faults = Plant(), FaultPlan([])
        self._last, self._sent, self._cycled, self._watchdogs = {}, {}, {}, {}
        self.line.become("open")

    async def tick(self) -> None:
        self.plant.tick()

    # -- from bytes to telegrams ------------------------------------------------------------------------------

    def _received(self, client: int, data: bytes) -> None:
        self._client = client
        self._receiver.feed(data)

    def _malformed(self, raw: bytes, reason: str) -> None:
        shown = raw[:_SHOWN].hex()
        self.journal.event(connection=self._client, direction="in", kind="malformed", bytes=shown, reason=reason)

    def _record(self, raw: bytes, **said: Any) -> int:
        return self.journal.frame(raw, connection=self._client, direction="in", **said)

    def _frame(self, raw: bytes) -> None:
        if raw[0] in (TOKEN, SHORT_ACKNOWLEDGEMENT):
            self._record(raw)
            return
        telegram = Telegram.parse(raw)
        if not telegram.is_request:
            self._record(raw)
        elif telegram.function in NO_ACKNOWLEDGEMENT:
            self._without_answer(telegram, raw)
        else:
            self._with_answer(telegram, raw)

    # -- requests ---------------------------------------------------------------------------------------------

    def _without_answer(self, request: Telegram, raw: bytes) -> None:
        """Execute a request that nobody answers: a global control."""
        service = service_of(request)
        addressed = {
            address: slave
            for address, slave in self.plant.slaves.items()
            if request.destination in (address, BROADCAST)
        }
        command = request.data[0] if len(request.data) == 2 else _OPERATE
        # A master that clears slaves which it has driven leaves them in order, whether it knows yet that they were restarted or not;
        # one that has driven none, or freezes, wants something of the plant.
        leaves = command == _CLEAR and any(
            (self._client, request.source, address) in self._driven for address in addressed
        )
        changes = service == "global_control" and command != _OPERATE and not leaves
        rule = self.faults.match(service, request.destination, changes=False)
        self._record(raw, state_changing=changes, **_of(rule))
        if service == "global_control" and (rule is None or not (rule.lose or rule.ack_only)):
            for slave in addressed.values():
                slave.control(request.source, command)
            self._feed(request.source)

    def _with_answer(self, request: Telegram, raw: bytes) -> None:
        slave = self.plant.slaves.get(request.destination)
        if slave is not None and not slave.present:
            slave = None
        service = service_of(request)
        last = self._last.get(request.destination)
        repeated = (
            slave is not None
            and last is not None
            and request.count_is_valid
            and (last.request.source, last.request.count) == (request.source, request.count)
        )
        cycles = self._repeats_outputs(slave, service, request)
        changes = not repeated and not cycles and _changes(slave, service, request)
        rule = self.faults.match(service, request.destination, changes=changes and service == "data_exchange")
        kind = "cycle" if cycles and not (repeated and last is not None and not last.cycle) else "request"
        # Which of the two it is, and whether it changes something, depends on what the slave holds.
        said = {"kind": kind, "request": kind == "request", "state_changing": changes}
        record = partial(self._record, raw, **said, **({"repeated": True} if repeated else {}), **_of(rule))
        if slave is None or (rule is not None and rule.lose):
            # Who repeats its outputs to a slave that is silent is told of once, by the first telegram without an answer.
            if kind != "cycle" or self._cycled.pop(request.destination, None) is not None:
                record()
            return
        if last is None or not repeated:
            if rule is not None and rule.error is not None:
                reply = Reply(function=rule.error)
            else:
                reply = slave.serve(service, request, apply=rule is None or not rule.ack_only)
            last = _Last(request, kind == "cycle", reply)
        self._last.pop(request.destination, None)
        if request.count or request.count_is_valid:
            # With both bits zero it is of no sequence: the next one cannot repeat it.
            self._last[request.destination] = last
        reply = last.reply
        self._watch(request.destination, slave, request.source)
        # A master may repeat the outputs a hundred times a second. What is new in that has an entry, and the first telegram after
        # each reading of the journal: who reads it before and after a call sees whether there was an exchange in it.
        cycled = reply, self.journal.reads
        if kind == "cycle" and rule is None and self._cycled.get(request.destination) == cycled:
            self.line.send(_encoded(last.request, reply))
            return
        if service == "data_exchange":
            self._cycled[request.destination] = cycled
            if slave.exchanges_with(request.source):
                self._driven.add((self._client, request.source, request.destination))
        self._answer(record(), last.request, reply, service, rule)

    def _repeats_outputs(self, slave: Slave | None, service: str, request: Telegram) -> bool:
        """Tell whether a Data_Exchange sends what the slave has from this master, or what the master sent it last."""
        place = request.destination, request.source
        if service == "chk_cfg":
            self._sent.pop(place, None)
        if service != "data_exchange":
            return False
        before, self._sent[place] = self._sent.get(place), request.data
        if slave is not None and slave.exchanges_with(request.source):
            return slave.outputs == request.data
        return before == request.data

    # -- watchdogs --------------------------------------------------------------------------------------------

    def _feed(self, master: int) -> None:
        for address, slave in self.plant.slaves.items():
            self._watch(address, slave, master)

    def _watch(self, address: int, slave: Slave, master: int) -> None:
        """Start a slave's watchdog again: its owner has spoken to it, or it has just got one."""
        if slave.owner == master or slave.owner is None:
            if (running := self._watchdogs.pop(address, None)) is not None:
                running.cancel()
            if slave.watchdog_s is not None:
                self._watchdogs[address] = asyncio.get_running_loop().call_later(
                    slave.watchdog_s, self._expired, address, slave
                )

    def _expired(self, address: int, slave: Slave) -> None:
        self._watchdogs.pop(address, None)
        # The slave may be another owner's meanwhile, who needs no watchdog.
        if slave.watchdog_s is None:
            return
        held = bytes(slave.outputs)
        self.journal.event(
            connection=0, direction="out", kind="watchdog", origin="plant", station=address, outputs=held.hex()
        )
        slave.leave()

    # -- answers ----------------------------------------------------------------------------------------------

    def _answer(self, asked: int, request: Telegram, reply: Reply, service: str, rule: Rule | None) -> None:
        if rule is None:
            self._send(asked, request, reply, service, None)
        elif rule.drop:
            return
        elif rule.garbage:
            # The entry answers no request: no client can tell which request the bytes are for.
            self._unrelated("garbage", _GARBAGE)
        elif rule.delay_s:
            send = partial(self._send, asked, request, reply, service, rule)
            asyncio.get_running_loop().call_later(rule.delay_s, send)
        else:
            self._send(asked, request, reply, service, rule)

    def _send(self, asked: int, request: Telegram, reply: Reply, service: str, rule: Rule | None) -> None:
        raw = _encoded(request, reply, rule)
        if rule is not None and rule.manner.mangle is not None:
            self._unrelated("mangled", rule.manner.mangle.applied(raw))
            return
        if rule is not None and rule.truncate is not None:
            self._unrelated("mangled", raw[: rule.truncate])
            return
        falsified = rule or Rule()
        said: dict[str, Any] = {}
        if rule is not None:
            # Other requests may have come meanwhile.
            said["service"] = service
            said["station"] = _either(falsified.answer_station, request.destination)
            said["master"] = _either(falsified.answer_master, request.source)
        for index in range(2 if falsified.manner.duplicate else 1):
            if self.line.carries():
                if index:
                    said["duplicate"] = True
                self.journal.frame(raw, connection=self._client, direction="out", answers=asked, **said)
                self.line.send(raw, falsified.manner.drip_s)

    def _unrelated(self, kind: str, data: bytes) -> None:
        if self.line.carries():
            self.journal.event(connection=self._client, direction="out", kind=kind, bytes=data.hex())
            self.line.send(data)


def _of(rule: Rule | None) -> dict[str, Any]:
    return {} if rule is None else {"fault": rule.action}


def _changes(slave: Slave | None, service: str, request: Telegram) -> bool:
    """Tell whether a request may change the plant. Parameters and configuration of a slave that nobody else owns do not: they come
    before the first outputs, which do."""
    if service == "set_slave_add":
        return True
    if slave is None or service not in ("data_exchange", "set_prm", "chk_cfg"):
        return False
    exchanges = service == "data_exchange" and slave.exchanges_with(request.source)
    return exchanges or slave.belongs_to_another(request.source)


def _either(falsified: int | None, right: int) -> int:
    return right if falsified is None else falsified


def _data(reply: Reply, rule: Rule | None) -> bytes:
    if rule is not None and rule.answer_data is not None and reply.data:
        return rule.answer_data
    return reply.data


def _encoded(request: Telegram, reply: Reply, rule: Rule | None = None) -> bytes:
    """Return the telegram of a reply, with what a rule falsifies in it."""
    if reply.function is None:
        return bytes([SHORT_ACKNOWLEDGEMENT])
    falsified = rule or Rule()
    data = _data(reply, rule)
    return Telegram(
        destination=_either(falsified.answer_master, request.source),
        source=_either(falsified.answer_station, request.destination),
        control=reply.function,
        # An answer without data has no access points.
        dsap=request.ssap if data else None,
        ssap=request.dsap if data else None,
        data=data,
    ).encoded()
