"""The slaves of an EtherCAT segment with journal and fault plan, at the other end of one cable.

A frame passes all slaves in their order and comes back. What is new in it has an entry in the journal: requests for objects and their
answers, changes of states and of outputs, what a master asks to find its slaves. How a master sets its slaves up (addresses, EEPROM,
sync managers, FMMUs) is no matter of the journal.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from pytest_otmcp.wire.ethercat import (
    ADDRESS_OF,
    ETHERTYPE,
    LOGICAL,
    MAILBOX_BYTES,
    MAILBOX_IN,
    READS,
    Datagram,
    Sdo,
    encoded,
    fields_of,
    parse,
    sdo_of,
)
from pytest_otmcp.wire.framing import MalformedError

from ..cable import CableEnd
from ..device import Device
from ..endpoint import OpenEndpoint
from ..frames import Frames
from .faults import FaultPlan, Rule
from .plant import Plant
from .pokes import poke
from .slave import OP, WATCHDOG, Slave

__all__ = ["EthercatDevice"]

_SHOWN = 300
_SDO = ("sdo_upload", "sdo_download")
_NO_FAULT = Rule()
_NONE: Mapping[int, int] = {}


@dataclass(slots=True, kw_only=True)
class _Asked:
    """What a frame asks for that is of note.

    Attributes:
        service: as the journal has it.
        slave: position of the slave; None for all, or for one that is not there.
        changes: it changes an object or outputs.
        told: what the device says of it beside its bytes.
    """

    service: str
    slave: int | None
    changes: bool
    told: dict[str, Any] = field(default_factory=dict)


def _alone(frame: bytes, datagrams: Sequence[Datagram], at: int) -> bytes:
    """Return a frame as it would be with this datagram alone."""
    return frame if len(datagrams) == 1 else encoded(frame, [datagrams[at]])


class EthercatDevice(Device):
    """One segment: each frame passes the slaves one after the other."""

    protocol = "ethercat"

    def __init__(self) -> None:
        super().__init__()
        self.plant = Plant(self._posted)
        self.faults = FaultPlan([])
        self.cable = Frames(self.journal, ETHERTYPE, self._received)
        self._rule, self._number = _NO_FAULT, 0
        self._picked: dict[int, int] = {}
        """Datagrams of the frame that take an answer out of a mailbox to the record of its request."""
        self._answers: dict[int, int] = {}
        """Slaves with an answer in their mailbox to the record of its request."""
        self._shown: dict[int, tuple[list[bytes], int]] = {}
        """Number of a client to its last frame with process data that has an entry, and how often the journal had been read."""
        self._late: set[asyncio.TimerHandle] = set()
        """Answers that a fault holds back."""
        self._watchdogs: dict[int, asyncio.TimerHandle] = {}

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        end = endpoints["ethercat"]
        assert isinstance(end, CableEnd)
        self.cable.open(end)

    async def aclose(self) -> None:
        self.cable.close()

    def image(self) -> dict[str, Any]:
        """Return what :meth:`.plant.Plant.image` returns."""
        return self.plant.image()

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the segment past the protocol: see :mod:`.pokes`, and :mod:`..frames` for ``{"network": …}``."""
        if not self.cable.poke(params):
            poke(self.plant, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        """See :class:`~..device.Device`. A master that has set the slaves up need not do so again; those in OP leave it."""
        self.faults = FaultPlan([])
        old, self.plant = self.plant, Plant(self._posted)
        for before, slave in zip(old.slaves, self.plant.slaves, strict=True):
            slave.take_over(before)
        for late in self._late:
            late.cancel()
        self._late.clear()
        self._answers.clear()
        self._shown.clear()
        self._watch(())
        self.cable.become("open")

    async def tick(self) -> None:
        self.plant.tick()

    # -- frames -----------------------------------------------------------------------------------------------

    def _received(self, client: int, raw: bytes) -> None:
        try:
            datagrams = parse(raw)
        except MalformedError as error:
            shown = raw[:_SHOWN].hex()
            self.journal.event(connection=client, direction="in", kind="malformed", bytes=shown, reason=str(error))
            return
        found = [(at, asked) for at, one in enumerate(datagrams) if (asked := self._asked(one)) is not None]
        rule = next(
            (
                hit
                for _, one in found
                if (hit := self.faults.match(one.service, one.slave, changes=one.changes)) is not None
            ),
            None,
        )
        if rule is None and found and all(one.service == "process_data" and not one.changes for _, one in found):
            self._cycle(client, raw, datagrams, found[0])
            return
        fault: dict[str, Any] = {} if rule is None else {"fault": rule.action}
        self._rule = rule or _NO_FAULT
        # A frame may have several datagrams: each that is of note has an entry of its own, as if it had come alone.
        answers = {
            at: self.journal.frame(_alone(raw, datagrams, at), connection=client, direction="in", **one.told, **fault)
            for at, one in found
        }
        if self._rule.lose:
            return
        self._pass(datagrams, answers)
        is_sdo = bool(found) and all(one.service in _SDO for _, one in found)
        if self._rule.counter is not None:
            for one in datagrams:
                one.counter = self._rule.counter
        # What is asked of an object is answered by the frame that takes the answer out of the mailbox.
        answered = {at: answers[at] for at, asked in found if asked.service not in _SDO} | self._picked
        send = partial(self._send, client, raw, datagrams, answered)
        if self._rule.manner.mangle is not None and not is_sdo and self.cable.carries():
            frame = self._rule.manner.mangle.applied(encoded(raw, datagrams))
            self.journal.event(connection=client, direction="out", kind="mangled", bytes=frame.hex())
            send = partial(self.cable.send, frame)
        if is_sdo or not (self._rule.drop or self._rule.delay_s):
            send()
        elif self._rule.delay_s:
            asyncio.get_running_loop().call_later(self._rule.delay_s, send)

    def _send(self, client: int, raw: bytes, datagrams: Sequence[Datagram], answers: Mapping[int, int]) -> None:
        frame = encoded(raw, datagrams)
        # A slave controller marks what has passed it, and leaves what a short frame is filled up with.
        frame = frame[:6] + bytes([frame[6] | 0x02]) + frame[7:] + raw[len(frame) :]
        if self.cable.carries():
            for at, number in sorted(answers.items()):
                alone = _alone(frame, datagrams, at)
                self.journal.frame(alone, connection=client, direction="out", answers=number)
        self.cable.send(frame)

    def _cycle(self, client: int, raw: bytes, datagrams: Sequence[Datagram], found: tuple[int, _Asked]) -> None:
        """Pass process data that changes no outputs. A master sends a hundred of those frames a second: what is new in the answer has an
        entry, and the first frame after each reading of the journal, so that who reads it before and after a call sees whether there
        was an exchange in it."""
        self._rule = _NO_FAULT
        self._pass(datagrams)
        shown = [one.data for one in datagrams], self.journal.reads
        answers: dict[int, int] = {}
        if self._shown.get(client) != shown:
            self._shown[client] = shown
            at, asked = found
            answers[at] = self.journal.frame(
                _alone(raw, datagrams, at), connection=client, direction="in", **asked.told
            )
        self._send(client, raw, datagrams, answers)

    def _pass(self, datagrams: Sequence[Datagram], records: Mapping[int, int] = _NONE) -> None:
        fed: set[int] = set()
        self._picked = {}
        for at, datagram in enumerate(datagrams):
            self._number = records.get(at, 0)
            if (picked := self._picked_by(datagram)) is not None:
                self._picked[at] = picked
            for number, slave in self._present():
                if slave.state == OP and slave.drives(datagram):
                    fed.add(number)
                if self._rule.ack_only and slave.drives(datagram):
                    held = slave.outputs
                    slave.serve(datagram)
                    slave.outputs = held
                else:
                    slave.serve(datagram)
                if datagram.command in (1, 2, 3, 7, 8, 9):
                    datagram.position = datagram.position + 1 & 0xFFFF
        self._watch(fed)

    def _present(self) -> list[tuple[int, Slave]]:
        """Return the slaves that a frame passes: behind one that is off the line there is nobody."""
        found: list[tuple[int, Slave]] = []
        for number, slave in enumerate(self.plant.slaves):
            if not slave.present:
                break
            found.append((number, slave))
        return found

    # -- what is of note --------------------------------------------------------------------------------------

    def _asked(self, datagram: Datagram) -> _Asked | None:
        """Return what is of note in a datagram, before any slave has got it."""
        for number, slave in self._present():
            if (after := slave.sent(datagram)) != slave.outputs:
                told = {"kind": "request", "request": True, "state_changing": True, "slave": number}
                return _Asked(service="process_data", slave=number, changes=True, told={**told, "outputs": after.hex()})
        fields = fields_of(datagram)
        if fields is None:
            return None
        slaves = [number for number, slave in self._present() if slave.at(datagram, number)]
        if datagram.command in LOGICAL or datagram.command not in ADDRESS_OF or ADDRESS_OF[datagram.command] == "all":
            slaves = []
        slave_number = slaves[0] if slaves else None
        service = fields["service"]
        told = {} if slave_number is None else {"slave": slave_number}
        return _Asked(service=service, slave=slave_number, changes=service == "sdo_download", told=told)

    def _picked_by(self, datagram: Datagram) -> int | None:
        """Return the record of the request whose answer a datagram takes out of a mailbox."""
        if datagram.command not in READS or not datagram.covers(MAILBOX_IN + MAILBOX_BYTES - 1):
            return None
        slaves = (number for number, slave in self._present() if slave.at(datagram, number))
        return next((self._answers.pop(number) for number in slaves if number in self._answers), None)

    # -- objects ----------------------------------------------------------------------------------------------

    def _posted(self, number: int, mailbox: bytes) -> None:
        """Do what a master asks of an object, and put the answer into the mailbox."""
        asked, rule = sdo_of(mailbox), self._rule
        if asked is None or asked.service not in _SDO:
            return
        objects = self.plant.slaves[number].objects
        written = asked.data if asked.service == "sdo_download" else None
        abort = rule.abort or objects.refusal(asked.index, asked.subindex, written)
        data = b""
        if abort is None:
            held = objects[asked.index, asked.subindex]
            if written is not None and not rule.ack_only:
                held.data = written
            data = b"" if written is not None else held.data
        answer = Sdo(
            service=asked.service,
            index=asked.index if rule.answer_index is None else rule.answer_index,
            subindex=asked.subindex,
            data=data if rule.answer_data is None or written is not None else rule.answer_data,
            abort=abort,
            counter=asked.counter,
        )
        if rule.drop:
            return
        mailbox = answer.mailbox()
        if rule.manner.mangle is not None:
            mailbox = rule.manner.mangle.applied(mailbox)[:MAILBOX_BYTES]
        post = partial(self._post, number, mailbox, self._number)
        if rule.delay_s:
            self._late.add(asyncio.get_running_loop().call_later(rule.delay_s, post))
        else:
            post()

    def _post(self, number: int, mailbox: bytes, asked: int) -> None:
        self.plant.slaves[number].answer(mailbox)
        self._answers[number] = asked

    # -- watchdogs --------------------------------------------------------------------------------------------

    def _watch(self, fed: Sequence[int] | set[int]) -> None:
        """Start the watchdogs of slaves anew that were sent outputs, and end those of slaves that are not in OP any more."""
        for number, slave in enumerate(self.plant.slaves):
            if slave.state == OP and number not in fed:
                continue
            if (running := self._watchdogs.pop(number, None)) is not None:
                running.cancel()
            if slave.state == OP and slave.watchdog_s is not None:
                loop = asyncio.get_running_loop()
                self._watchdogs[number] = loop.call_later(slave.watchdog_s, self._expired, number)

    def _expired(self, number: int) -> None:
        self._watchdogs.pop(number, None)
        slave = self.plant.slaves[number]
        held = slave.outputs.hex()
        self.journal.event(connection=0, direction="out", kind="watchdog", origin="plant", slave=number, outputs=held)
        slave.fall(WATCHDOG)
