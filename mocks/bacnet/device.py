"""The BACnet/IP server (ASHRAE 135, annex J) with journal and fault plan.

It is not a library's server, because a reference must refuse what the standard refuses (bacpypes3's own server takes a write to an
analog input), and the journal needs the client and the bytes.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from pytest_otmcp.wire.bacnet.frames import (
    ABORT_SEGMENTATION,
    Apdu,
    Frame,
    LinkMessage,
    NetworkMessage,
    PduType,
    frame_of,
    head_of,
    link_result,
    unicast,
)
from pytest_otmcp.wire.bacnet.services import Asked, Confirmed, Rejected, Unconfirmed, asked_of, who_has, who_is
from pytest_otmcp.wire.bacnet.values import Value, encode
from pytest_otmcp.wire.framing import MalformedError

from ..datagrams import Datagrams
from ..device import Device
from ..endpoint import OpenEndpoint
from .faults import FaultPlan, Rule
from .names import Refusal
from .plant import DEVICE, Plant
from .pokes import poke
from .services import Answer, FailedWriteError, execute, i_am, i_have, is_for, object_asked_for, read_answer

__all__ = ["BacnetDevice"]

_GARBAGE = b"\xde\xad\xbe\xef\xff\xff\x00\x01"
_LINK_REFUSALS = {1: 0x10, 2: 0x20, 5: 0x30, 6: 0x40, 8: 0x50, 9: 0x60}
"""Functions of the virtual link that only a broadcast management device has, and the result that refuses each (J.2.1)."""

Send = Callable[[bytes], None]


class BacnetDevice(Device):
    """Device 12345 at one UDP port: what is not for it is not answered."""

    protocol = "bacnet"

    def __init__(self) -> None:
        super().__init__()
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.network = Datagrams(self.journal, self._received)

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        listener = endpoints["bacnet"]
        assert isinstance(listener, socket.socket)
        await asyncio.get_running_loop().create_datagram_endpoint(lambda: self.network, sock=listener)

    async def aclose(self) -> None:
        self.network.close()

    def image(self) -> dict[str, Any]:
        """Return ``device``, the instance of the device object; ``objects``: name and datatype of the present value by object; and
        ``points``, such as ``analog-output,1/present-value`` and ``analog-output,1/priority-array/8``."""
        objects = {
            one.label: {"name": one.name, "type": one.kind, "commandable": one.commandable}
            for one in self.plant.objects.values()
        }
        points: dict[str, Any] = {}
        for one in self.plant.objects.values():
            points |= one.points()
        return {"device": DEVICE, "objects": objects, "points": points}

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the device past the protocol: see :mod:`.pokes`, and :mod:`..datagrams` for ``{"network": …}``."""
        if not self.network.poke(params):
            poke(self.plant, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.network.become("open")

    async def tick(self) -> None:
        self.plant.tick()

    # -- what arrives -----------------------------------------------------------------------------------------

    def _received(self, number: int, datagram: bytes, send: Send) -> None:
        client = _Client(self, number, datagram, send)
        try:
            frame = frame_of(datagram)
            apdu = head_of(frame.apdu)
        except LinkMessage as message:
            client.link_message(message.function)
        except (MalformedError, NetworkMessage):
            client.note()
        else:
            client.apdu(frame, apdu)


class _Client:
    """One datagram of a client, and the way back to it."""

    def __init__(self, device: BacnetDevice, number: int, datagram: bytes, send: Send) -> None:
        self._device = device
        self._number = number
        self._datagram = datagram
        self._transmit = send
        self._source = b""

    def note(self, rule: Rule | None = None) -> int:
        """Record what arrived."""
        said: dict[str, Any] = {} if rule is None else {"fault": rule.action}
        return self._device.journal.frame(self._datagram, connection=self._number, direction="in", **said)

    def link_message(self, function: int) -> None:
        """Answer a message of the virtual link: the device is no broadcast management device."""
        asked = self.note()
        if function in _LINK_REFUSALS:
            self._answer(asked, link_result(_LINK_REFUSALS[function]))

    def apdu(self, frame: Frame, apdu: Apdu) -> None:
        """Execute and answer an APDU."""
        self._source = frame.source
        if apdu.kind == PduType.CONFIRMED_REQUEST:
            self._confirmed(apdu)
        elif apdu.kind == PduType.UNCONFIRMED_REQUEST:
            self._unconfirmed(apdu)
        else:
            self.note()

    # -- unconfirmed services ---------------------------------------------------------------------------------

    def _unconfirmed(self, apdu: Apdu) -> None:
        reply: bytes | None = None
        try:
            if apdu.service == Unconfirmed.WHO_IS:
                reply = i_am() if is_for(who_is(apdu.data)) else None
            elif apdu.service == Unconfirmed.WHO_HAS:
                found = object_asked_for(self._device.plant, who_has(apdu.data))
                reply = None if found is None else i_have(*found)
        except MalformedError:
            self.note()
            return
        rule = self._device.faults.match_discovery() if apdu.service == Unconfirmed.WHO_IS else None
        asked = self.note(rule)
        if reply is not None and (rule is None or not (rule.drop or rule.lose)):
            self._later(0.0 if rule is None else rule.delay_s, partial(self._send, asked, reply))

    # -- confirmed services -----------------------------------------------------------------------------------

    def _confirmed(self, apdu: Apdu) -> None:
        service, invoke_id = int(apdu.service or 0), int(apdu.invoke_id or 0)
        asked_for: Asked | None = None
        refused: Rejected | None = None
        if not apdu.is_segmented:
            try:
                asked_for = asked_of(service, apdu.data)
            except Rejected as error:
                refused = error
        rule = self._device.faults.match(service, asked_for.objects() if asked_for is not None else ())
        asked = self.note(rule)
        if rule is not None and rule.lose:
            return
        reply_id = (invoke_id + (rule.invoke_id if rule is not None else 0)) & 0xFF
        if apdu.is_segmented:
            data = _abort(reply_id, ABORT_SEGMENTATION)
        elif refused is not None or asked_for is None:
            data = _reject(reply_id, refused.reason if refused is not None else 0)
        else:
            data = self._execute(rule, service, reply_id, asked_for)
            if len(data) > apdu.largest:
                data = _abort(reply_id, ABORT_SEGMENTATION)
        if rule is None or not rule.drop:
            late = 0.0 if rule is None else rule.delay_s
            self._later(late, partial(self._send, asked, data, rule))

    def _execute(self, rule: Rule | None, service: int, reply_id: int, asked: Asked) -> bytes:
        if rule is not None and rule.reject is not None:
            return _reject(reply_id, rule.reject)
        if rule is not None and rule.abort is not None:
            return _abort(reply_id, rule.abort)
        plant = self._device.plant
        try:
            if rule is not None and rule.error is not None:
                refusal = Refusal(*rule.error)
                several = service == Confirmed.WRITE_PROPERTY_MULTIPLE
                raise FailedWriteError(refusal, asked.writes[0].to) if several else refusal
            answer = execute(
                plant,
                service,
                _clamped(rule, asked),
                apply=rule is None or not rule.ack_only,
                named=None if rule is None else rule.answer_instance,
            )
        except Rejected as error:
            return _reject(reply_id, error.reason)
        except FailedWriteError as failure:
            return _error(reply_id, service, failure.data())
        except Refusal as refusal:
            codes = b"".join(encode(Value(kind="enumerated", value=code)) for code in refusal.error)
            return _error(reply_id, service, codes)
        if rule is not None and service == Confirmed.READ_PROPERTY:
            answer = _falsified(rule, asked, answer)
        if answer.data is None:
            return bytes([PduType.SIMPLE_ACK << 4, reply_id, service])
        return bytes([PduType.COMPLEX_ACK << 4, reply_id, service]) + answer.data

    # -- the way back -----------------------------------------------------------------------------------------

    def _later(self, delay_s: float, send: Callable[[], None]) -> None:
        if delay_s:
            asyncio.get_running_loop().call_later(delay_s, send)
        else:
            send()

    def _send(self, asked: int, apdu: bytes, rule: Rule | None = None) -> None:
        datagram = unicast(apdu, self._source)
        if rule is None:
            self._answer(asked, datagram)
        elif rule.garbage:
            # The entry answers no request: no client can tell which request the bytes are for.
            self._unrelated("garbage", _GARBAGE)
        elif rule.manner.mangle is not None:
            self._unrelated("mangled", rule.manner.mangle.applied(datagram))
        elif rule.truncate is not None:
            self._unrelated("mangled", datagram[: rule.truncate])
        else:
            self._answer(asked, datagram)
            if rule.manner.duplicate:
                self._answer(asked, datagram, duplicate=True)

    def _answer(self, asked: int, datagram: bytes, **said: Any) -> None:
        if self._device.network.carries():
            self._device.journal.frame(datagram, connection=self._number, direction="out", answers=asked, **said)
            self._transmit(datagram)

    def _unrelated(self, kind: str, data: bytes) -> None:
        if self._device.network.carries():
            self._device.journal.event(connection=self._number, direction="out", kind=kind, bytes=data.hex())
            self._transmit(data)


def _error(invoke_id: int, service: int, data: bytes) -> bytes:
    return bytes([PduType.ERROR << 4, invoke_id, service]) + data


def _reject(invoke_id: int, reason: int) -> bytes:
    return bytes([PduType.REJECT << 4, invoke_id, reason])


def _abort(invoke_id: int, reason: int) -> bytes:
    # The bit says that a server sends it.
    return bytes([PduType.ABORT << 4 | 1, invoke_id, reason])


def _clamped(rule: Rule | None, asked: Asked) -> Asked:
    if rule is None or rule.clamp is None or not asked.writes:
        return asked
    low, high = rule.clamp

    def clamped(value: Value) -> Value:
        return Value(kind=value.kind, value=min(max(value.value, low), high)) if value.kind == "real" else value

    return Asked(writes=[replace(write, values=list(map(clamped, write.values))) for write in asked.writes])


def _falsified(rule: Rule, asked: Asked, answer: Answer) -> Answer:
    """Return the answer that a rule makes of a right answer to a ReadProperty."""
    if rule.answer_values is None and rule.answer_instance is None:
        return answer
    (one,) = asked.reads
    return read_answer(
        one if rule.answer_instance is None else one.at(rule.answer_instance),
        answer.values if rule.answer_values is None else rule.answer_values,
    )
