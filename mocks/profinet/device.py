"""The PROFINET IO device with journal and fault plan, at the device's end of a cable.

It takes frames as they are on the cable, and needs no stack of the system: it answers ARP for its own address, which DCP may change, and
reads the datagrams of remote procedure calls itself. Alarms, and cyclic data that are isochronous or faster than 32 ms, it does not have.
"""

from __future__ import annotations

import asyncio
import fcntl
import ipaddress
import os
import socket
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pytest_otmcp.wire.framing import MalformedError
from pytest_otmcp.wire.profinet import dcp
from pytest_otmcp.wire.profinet.blocks import APPLICATION_READY, OUTPUTS, PARAMETERS_END, Control, Record, blocks_of
from pytest_otmcp.wire.profinet.dcp import Dcp
from pytest_otmcp.wire.profinet.frames import ARP, IPV4, PROFINET, RPC_PORT, Datagram, Frame
from pytest_otmcp.wire.profinet.rpc import (
    CONNECT,
    CONTROL,
    CONTROLLER_INTERFACE,
    DEVICE_INTERFACE,
    READ,
    READ_IMPLICIT,
    RELEASE,
    WRITE,
    Kind,
    Rpc,
)
from pytest_otmcp.wire.profinet.rt import FRAME_IDS, RtFrame
from pytest_otmcp.wire.profinet.services import dcp_fields, rpc_fields

from ..cable import INTERFACE, CableEnd
from ..device import Device
from ..endpoint import OpenEndpoint
from ..frames import Frames
from .faults import FaultPlan, Rule
from .plant import Plant
from .pokes import poke
from .records import NO_RELATION, Refused, answer, is_for, read, status, write
from .relation import Cyclic, Denied, Relations

__all__ = ["ProfinetDevice"]

_GARBAGE = b"\xde\xad\xbe\xef\xff\xff\x00\x01"
_SET_ADDRESS = 0x8916
"""SIOCSIFADDR of netdevice(7)."""
_REFUSALS = {CONNECT: 0xDB, RELEASE: 0xDC, READ: 0xDE, READ_IMPLICIT: 0xDE, WRITE: 0xDF, CONTROL: 0xDD}
"""First byte of the PNIO status of a refused request."""
_READY, _ARP_REQUEST, _ARP_REPLY = 2, 1, 2
_ARP = struct.Struct(">HHBBH6s4s6s4s")


class ProfinetDevice(Device):
    """The device and its neighbour."""

    protocol = "profinet"

    def __init__(self) -> None:
        super().__init__()
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.cable = Frames(self.journal, PROFINET, self._received, further=(IPV4, ARP))
        self.relations = Relations(lambda: self.plant, self._expired)
        self._mac = b""
        self._boot = int.from_bytes(os.urandom(3))
        self._answered: dict[bytes, tuple[int, Callable[[int, Rule | None], None]]] = {}
        """Activity to the number of its last call, and what sends the answer to that again."""
        self._sequence = 0

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        end = endpoints["profinet"]
        assert isinstance(end, CableEnd)
        self._mac = self.plant.device.mac = end.mac
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
            # The system would answer for this address, and say that there is no such port.
            nothing = INTERFACE.encode().ljust(16, b"\0") + struct.pack("=HH4s8x", socket.AF_INET, 0, bytes(4))
            fcntl.ioctl(any_socket, _SET_ADDRESS, nothing)
        self.cable.open(end)

    async def aclose(self) -> None:
        self.cable.close()

    def image(self) -> dict[str, Any]:
        """Return what :meth:`.plant.Plant.image` returns."""
        return self.plant.image()

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the device past the protocol: see :mod:`.pokes`, and :mod:`..frames` for ``{"network": …}``."""
        if not self.cable.poke(params):
            if "controller" in params:
                self.relations.end()
            poke(self.plant, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.faults = FaultPlan([])
        before, self.plant = self.plant, Plant()
        self.plant.device.mac = self._mac
        if self.relations.cyclic is not None:
            # A controller that is there repeats its outputs, and would only bring them back.
            self.plant.controlled_as(before)
        self.cable.become("open")

    async def tick(self) -> None:
        self.plant.tick()

    # -- what arrives -----------------------------------------------------------------------------------------

    def _received(self, number: int, raw: bytes) -> None:
        note = partial(self.journal.frame, raw, connection=number, direction="in")
        try:
            frame = Frame.parse(raw)
            if frame.ethertype == ARP:
                self._resolve(frame)
            elif frame.ethertype == IPV4:
                self._datagram(number, frame, note)
            elif int.from_bytes(frame.payload[:2]) in FRAME_IDS:
                self._cyclic(frame, note)
            else:
                self._discovery(number, frame, note)
        except MalformedError:
            note()

    def _resolve(self, frame: Frame) -> None:
        try:
            *kind, operation, mac, ip, _, wanted = _ARP.unpack_from(frame.payload)
        except struct.error:
            return
        own = ipaddress.IPv4Address(self.plant.device.ip).packed
        if operation == _ARP_REQUEST and wanted == own:
            payload = _ARP.pack(*kind, _ARP_REPLY, self._mac, own, mac, ip)
            self.cable.send(Frame(destination=mac, source=self._mac, ethertype=ARP, payload=payload).encoded())

    # -- DCP --------------------------------------------------------------------------------------------------

    def _discovery(self, number: int, frame: Frame, note: Callable[..., int]) -> None:
        asked = Dcp.parse(frame.payload)
        several = bool(frame.destination[0] & 1)
        there = [one for one in self.plant.stations if one.present and (several or frame.destination == one.mac)]
        if asked.kind != dcp.REQUEST or (several and asked.service != dcp.IDENTIFY):
            there = []
        elif asked.service == dcp.IDENTIFY:
            there = [one for one in there if is_for(one, asked)]
        service = dcp_fields(asked)["service"]
        rule = self.faults.match(service, changes=service == "set")
        record = note(**_of(rule))
        if rule is not None and rule.lose:
            return
        for station in there:
            reply = answer(
                self.plant, station, asked, apply=rule is None or not rule.ack_only, error=rule.error if rule else None
            )
            shifted = replace(reply, xid=reply.xid + (rule.answer_sequence if rule else 0) & 0xFFFFFFFF)
            back = partial(self._frame, frame.source, station.mac)
            self._answer(_Way(number, record, back), shifted.encoded(), rule)

    # -- remote procedure calls ---------------------------------------------------------------------------------

    def _datagram(self, number: int, frame: Frame, note: Callable[..., int]) -> None:
        try:
            datagram = Datagram.parse(frame.payload)
        except MalformedError:
            # Not every packet is a call.
            return
        if datagram.destination != (self.plant.device.ip, RPC_PORT) or frame.destination != self._mac:
            return
        call = Rpc.parse(datagram.data)
        if call.kind != Kind.REQUEST:
            note()
            return

        def packed(data: bytes) -> Frame:
            return self._packet(
                frame.source, Datagram(source=datagram.destination, destination=datagram.source, data=data)
            )

        fields = rpc_fields(call)
        rule = self.faults.match(
            fields["service"],
            slot=fields.get("slot"),
            index=fields.get("index"),
            changes=fields["service"] == "write",
        )
        last = self._answered.get(call.activity)
        repeated = last is not None and last[0] == call.sequence
        # A client that had no answer asks again with the same number: nothing is executed twice (C706, 9.5.3).
        record = note(
            **({"repeated": True, "request": False, "state_changing": False} if repeated else {}), **_of(rule)
        )
        if rule is not None and rule.lose:
            return
        if repeated and last is not None:
            last[1](record, rule)
            return
        try:
            reply = self._performed(call, number, frame.source, rule)
        except MalformedError:
            return
        shifted = replace(reply, sequence=reply.sequence + (rule.answer_sequence if rule else 0) & 0xFFFFFFFF)
        self._answered = {
            **dict(list(self._answered.items())[-15:]),
            call.activity: (
                call.sequence,
                lambda again, rule: self._answer(_Way(number, again, packed), reply.encoded(), rule),
            ),
        }
        self._answer(_Way(number, record, packed), shifted.encoded(), rule)
        if call.operation == CONTROL and reply.status == 0:
            self._get_ready(call, number, frame.source, datagram.source[0])

    def _performed(self, call: Rpc, number: int, client: bytes, rule: Rule | None) -> Rpc:
        if call.called != DEVICE_INTERFACE or call.operation not in _REFUSALS:
            return call.rejected()
        kind = _REFUSALS[call.operation]
        accesses = call.operation in (READ, READ_IMPLICIT, WRITE)
        if rule is not None and rule.error is not None and not accesses:
            return call.answered(b"", status(kind, 0x810000 | rule.error << 8), boot=self._boot)
        try:
            if accesses:
                return self._accessed(call, kind, rule)
            if call.operation == CONNECT:
                blocks = self.relations.connect(call, number, client, self._mac)
                return call.answered(blocks, boot=self._boot)
            control = Control.parse(blocks_of(call.blocks)[0][0])
            known = control.relation in self.relations.known
            if call.operation == RELEASE:
                self.relations.release(control.relation)
            return call.answered(control.done(), 0 if known else status(kind, NO_RELATION), boot=self._boot)
        except Denied as denied:
            return call.answered(b"", status(kind, denied.code), boot=self._boot)
        except IndexError:
            raise MalformedError("a request without a block") from None

    def _accessed(self, call: Rpc, kind: int, rule: Rule | None) -> Rpc:
        blocks, content = blocks_of(call.blocks)
        asked = Record.parse(blocks[0])
        code, found = 0, b""
        try:
            if rule is not None and rule.error is not None:
                raise Refused(rule.error)
            if call.operation != READ_IMPLICIT and asked.relation not in self.relations.known:
                code = status(kind, NO_RELATION)
            elif not asked.writes:
                found = read(self.plant, asked)
                if rule is not None and rule.answer_data is not None:
                    found = rule.answer_data
            else:
                write(self.plant, asked, content[: asked.length], apply=rule is None or not rule.ack_only)
        except Refused as refused:
            code = status(kind, refused.code)
        told = replace(asked, slot=asked.slot if rule is None or rule.answer_slot is None else rule.answer_slot)
        # An answer names the record also where it refuses.
        told = replace(told, length=len(content) if asked.writes else len(found))
        return call.answered(told.encoded(answer=True, status=code) + found, code, boot=self._boot)

    def _get_ready(self, call: Rpc, number: int, client: bytes, address: str) -> None:
        """Tell the controller that the application is ready, and begin to send inputs."""
        control = Control.parse(blocks_of(call.blocks)[0][0])
        cyclic = self.relations.cyclic
        if cyclic is None or control.relation != cyclic.relation.identifier or control.type != PARAMETERS_END:
            return
        ready = Control(type=APPLICATION_READY, relation=control.relation, key=control.key, command=_READY)
        self._sequence += 1
        said = Rpc(
            kind=Kind.REQUEST,
            operation=CONTROL,
            sequence=self._sequence,
            object=cyclic.relation.controller,
            interface=CONTROLLER_INTERFACE,
            activity=os.urandom(16),
            boot=self._boot,
            blocks=ready.encoded(),
        )
        datagram = Datagram(
            source=(self.plant.device.ip, RPC_PORT), destination=(address, RPC_PORT), data=said.encoded()
        )
        self._send(number, self._packet(client, datagram))
        if not cyclic.running:
            cyclic.running = True
            self._send_inputs(cyclic)

    # -- cyclic data --------------------------------------------------------------------------------------------

    def _cyclic(self, frame: Frame, note: Callable[..., int]) -> None:
        cyclic = self.relations.cyclic
        told = RtFrame.parse(frame.payload)
        if (
            frame.destination != self._mac
            or cyclic is None
            or cyclic.mac != frame.source
            or cyclic.agreed[OUTPUTS].frame_id != told.frame_id
        ):
            note(kind="cycle", request=False, state_changing=False)
            return
        outputs = cyclic.outputs(told)
        held = {place: bytes(self.plant.subslots[place].outputs) for place in outputs}
        # Who repeats what it sent last changes nothing, whether the device has taken that or not.
        changes = outputs not in (held, cyclic.sent)
        cyclic.sent = outputs
        rule = self.faults.match("outputs", changes=changes)
        # Outputs may come by another packet socket than the one by which the relation was made.
        subslots = {f"{slot}.{number}": content.hex() for (slot, number), content in outputs.items()}
        kind = "request" if changes else "cycle"
        note(kind=kind, request=changes, state_changing=changes, subslots=subslots, **_of(rule))
        if rule is None or not (rule.lose or rule.ack_only):
            self.relations.feed(cyclic.watchdog_s)
            for place, content_of in outputs.items():
                self.plant.subslots[place].outputs[:] = content_of

    def _send_inputs(self, cyclic: Cyclic) -> None:
        if self.relations.cyclic is not cyclic:
            return
        rule = self.faults.match("inputs")
        if rule is None or not (rule.drop or rule.lose):
            payload = cyclic.inputs(self.plant).encoded()
            frame = Frame(destination=cyclic.mac, source=self._mac, ethertype=PROFINET, payload=payload)
            self._send(cyclic.number, frame)
        seconds = next(iter(cyclic.agreed.values())).cycle_s
        asyncio.get_running_loop().call_later(seconds, self._send_inputs, cyclic)

    def _expired(self, cyclic: Cyclic) -> None:
        held = {
            f"{slot}.{number}": one.outputs.hex() for (slot, number), one in self.plant.subslots.items() if one.outputs
        }
        self.journal.event(connection=0, direction="out", kind="watchdog", origin="plant", outputs=held)

    # -- answers ----------------------------------------------------------------------------------------------

    def _frame(self, client: bytes, station: bytes, payload: bytes) -> Frame:
        return Frame(destination=client, source=station, ethertype=PROFINET, payload=payload)

    def _packet(self, client: bytes, datagram: Datagram) -> Frame:
        return Frame(destination=client, source=self._mac, ethertype=IPV4, payload=datagram.encoded())

    def _answer(self, way: _Way, data: bytes, rule: Rule | None) -> None:
        if rule is None:
            self._send(way.number, way.packed(data), answers=way.asked)
        elif rule.drop:
            return
        elif rule.delay_s:
            later = partial(self._answer, way, data, replace(rule, delay_s=0.0))
            asyncio.get_running_loop().call_later(rule.delay_s, later)
        elif rule.garbage:
            # The entry answers no request: no client can tell which request the bytes are for.
            self._unrelated(way, "garbage", _GARBAGE)
        elif rule.manner.mangle is not None:
            self._unrelated(way, "mangled", rule.manner.mangle.applied(data))
        elif rule.truncate is not None:
            self._unrelated(way, "mangled", data[: rule.truncate])
        else:
            self._send(way.number, way.packed(data), answers=way.asked)
            if rule.manner.duplicate:
                self._send(way.number, way.packed(data), answers=way.asked, duplicate=True)

    def _send(self, number: int, frame: Frame, **said: Any) -> None:
        if self.cable.carries():
            raw = frame.encoded()
            self.journal.frame(raw, connection=number, direction="out", **said)
            self.cable.send(raw)

    def _unrelated(self, way: _Way, kind: str, data: bytes) -> None:
        if self.cable.carries():
            self.journal.event(connection=way.number, direction="out", kind=kind, bytes=data.hex())
            self.cable.send(way.packed(data).encoded())


@dataclass(frozen=True, slots=True)
class _Way:
    """The way back to a client: its number, the record of what it asked, and what makes a frame of an answer."""

    number: int
    asked: int
    packed: Callable[[bytes], Frame]


def _of(rule: Rule | None) -> dict[str, Any]:
    return {} if rule is None else {"fault": rule.action}
