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

from ..datagrams import Datagrams
from ..device import Device
from ..endpoint import OpenEndpoint
from . import services
from .faults import FaultPlan, Rule
from .frames import (
    ABORT_SEGMENTATION,
    Apdu,
    BadFrameError,
    Frame,
    LinkMessage,
    NetworkMessage,
    PduType,
    frame_of,
    head_of,
    link_result,
    unicast,
)
from .names import Confirmed, Refusal, Unconfirmed
from .plant import DEVICE, Plant
from .pokes import poke
from .services import Answer, Asked, FailedWriteError, Rejected, asked_of, execute, read_answer
from .values import MalformedError, Value, encode

__all__ = ["BacnetDevice"]

_GARBAGE = b"\xde\xad\xbe\xef\xff\xff\x00\x01"
_LINK_REFUSALS = {1: 0x10, 2: 0x20, 5: 0x30, 6: 0x40, 8: 0x50, 9: 0x60}
"""Functions of the virtual link that only a broadcast management device has, and the result that refuses each (J.2.1)."""
_LINK_CHANGES = frozenset({1, 8})

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
        except BadFrameError as error:
            client.note("malformed", reason=str(error))
        except LinkMessage as message:
            client.link_message(message.function)
        except NetworkMessage as message:
            client.note("network-message", message=message.message)
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

    def note(self, kind: str, **fields: Any) -> int:
        """Record what arrived."""
        return self._device.journal.event(
            connection=self._number, direction="in", kind=kind, **fields, bytes=self._datagram.hex()
        )

    def link_message(self, function: int) -> None:
        """Answer a message of the virtual link: the device is no broadcast management device."""
        changes = function in _LINK_CHANGES
        asked = self.note("bvlc", function=function, request=function in _LINK_REFUSALS, state_changing=changes)
        if function in _LINK_REFUSALS:
            result = link_result(_LINK_REFUSALS[function])
            self._answer(asked, result, "bvlc", function=0)

    def apdu(self, frame: Frame, apdu: Apdu) -> None:
        """Execute and answer an APDU."""
        self._source = frame.source
        if apdu.kind == PduType.CONFIRMED_REQUEST:
            self._confirmed(apdu)
        elif apdu.kind == PduType.UNCONFIRMED_REQUEST:
            self._unconfirmed(apdu)
        else:
            named = {"service": apdu.service} if apdu.service is not None else {}
            self.note("message", pdu_type=apdu.kind, invoke_id=apdu.invoke_id, **named)

    # -- unconfirmed services ---------------------------------------------------------------------------------

    def _unconfirmed(self, apdu: Apdu) -> None:
        service = int(apdu.service or 0)
        fields: dict[str, Any] = {"pdu_type": apdu.kind, "service": service}
        reply: tuple[bytes, dict[str, Any]] | None = None
        try:
            if service == Unconfirmed.WHO_IS:
                bounds = services.who_is(apdu.data)
                fields |= bounds
                if services.is_for(bounds):
                    reply = services.i_am(), {"service": int(Unconfirmed.I_AM), "device": DEVICE}
            elif service == Unconfirmed.WHO_HAS:
                bounds, found = services.who_has(self._device.plant, apdu.data)
                fields |= bounds
                if found is not None:
                    reply = services.i_have(*found), {"service": int(Unconfirmed.I_HAVE), "device": DEVICE}
        except MalformedError as error:
            self.note("malformed", reason=str(error))
            return
        changes = service in services.STATE_CHANGING_UNCONFIRMED
        is_request = changes or service in (Unconfirmed.WHO_IS, Unconfirmed.WHO_HAS)
        rule = self._device.faults.match_discovery() if service == Unconfirmed.WHO_IS else None
        asked = self.note(
            "request" if is_request else "message",
            request=is_request,
            state_changing=changes,
            **fields,
            **_of(rule),
        )
        if reply is not None and (rule is None or not (rule.drop or rule.lose)):
            data, said = reply
            late = 0.0 if rule is None else rule.delay_s
            self._later(late, partial(self._send, asked, data, {"pdu_type": 1, **said}))

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
        asked = self.note(
            "request",
            request=True,
            state_changing=service in services.STATE_CHANGING,
            pdu_type=apdu.kind,
            service=service,
            invoke_id=invoke_id,
            **(asked_for.shown() if asked_for is not None else {}),
            **_of(rule),
        )
        if rule is not None and rule.lose:
            return
        reply_id = (invoke_id + (rule.invoke_id if rule is not None else 0)) & 0xFF
        if apdu.is_segmented:
            data, said = _abort(reply_id, ABORT_SEGMENTATION)
        elif refused is not None or asked_for is None:
            data, said = _reject(reply_id, refused.reason if refused is not None else 0)
        else:
            data, said = self._execute(rule, service, reply_id, asked_for)
            if len(data) > apdu.largest:
                data, said = _abort(reply_id, ABORT_SEGMENTATION)
        if rule is None or not rule.drop:
            late = 0.0 if rule is None else rule.delay_s
            self._later(late, partial(self._send, asked, data, {**said, "invoke_id": reply_id}, rule))

    def _execute(self, rule: Rule | None, service: int, reply_id: int, asked: Asked) -> tuple[bytes, dict[str, Any]]:
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
            return _error(reply_id, service, failure.refusal, failure.data())
        except Refusal as refusal:
            codes = b"".join(encode(Value(kind="enumerated", value=code)) for code in refusal.error)
            return _error(reply_id, service, refusal, codes)
        if rule is not None and service == Confirmed.READ_PROPERTY:
            answer = _falsified(rule, asked, answer)
        said: dict[str, Any]
        if answer.data is None:
            said = {"pdu_type": int(PduType.SIMPLE_ACK), "service": service}
            return bytes([PduType.SIMPLE_ACK << 4, reply_id, service]), said
        said = {"pdu_type": int(PduType.COMPLEX_ACK), "service": service, "results": list(answer.results)}
        return bytes([PduType.COMPLEX_ACK << 4, reply_id, service]) + answer.data, said

    # -- the way back -----------------------------------------------------------------------------------------

    def _later(self, delay_s: float, send: Callable[[], None]) -> None:
        if delay_s:
            asyncio.get_running_loop().call_later(delay_s, send)
        else:
            send()

    def _send(self, asked: int, apdu: bytes, said: Mapping[str, Any], rule: Rule | None = None) -> None:
        datagram = unicast(apdu, self._source)
        if rule is None:
            self._answer(asked, datagram, "response", **said)
        elif rule.garbage:
            # The entry answers no request: no client can tell which request the bytes are for.
            self._unrelated("garbage", _GARBAGE)
        elif rule.manner.mangle is not None:
            self._unrelated("mangled", rule.manner.mangle.applied(datagram))
        elif rule.truncate is not None:
            self._unrelated("mangled", datagram[: rule.truncate])
        else:
            for index in range(2 if rule.manner.duplicate else 1):
                self._answer(asked, datagram, "response", **said, **({"duplicate": True} if index else {}))

    def _answer(self, asked: int, datagram: bytes, kind: str, **said: Any) -> None:
        if self._device.network.carries():
            self._device.journal.event(
                connection=self._number, direction="out", kind=kind, answers=asked, **said, bytes=datagram.hex()
            )
            self._transmit(datagram)

    def _unrelated(self, kind: str, data: bytes) -> None:
        if self._device.network.carries():
            self._device.journal.event(connection=self._number, direction="out", kind=kind, bytes=data.hex())
            self._transmit(data)


def _of(rule: Rule | None) -> dict[str, Any]:
    return {} if rule is None else {"fault": rule.action}


def _error(invoke_id: int, service: int, refusal: Refusal, data: bytes) -> tuple[bytes, dict[str, Any]]:
    kind = PduType.ERROR
    said = {"pdu_type": int(kind), "service": service, "error": list(refusal.error)}
    return bytes([kind << 4, invoke_id, service]) + data, said


def _reject(invoke_id: int, reason: int) -> tuple[bytes, dict[str, Any]]:
    kind = PduType.REJECT
    return bytes([kind << 4, invoke_id, reason]), {"pdu_type": int(kind), "reject": reason}


def _abort(invoke_id: int, reason: int) -> tuple[bytes, dict[str, Any]]:
    kind = PduType.ABORT
    # The bit says that a server sends it.
    return bytes([kind << 4 | 1, invoke_id, reason]), {"pdu_type": int(kind), "abort": reason}


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
    values = [Value(kind=shown["type"], value=shown["value"]) for shown in answer.results[0]["values"]]
    return read_answer(
        one if rule.answer_instance is None else one.at(rule.answer_instance),
        values if rule.answer_values is None else rule.answer_values,
    )
