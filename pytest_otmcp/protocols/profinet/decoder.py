"""Decoder of PROFINET frames; :mod:`pytest_otmcp.wire.profinet` says what their bytes mean.

Whether a cyclic frame changes anything depends on the outputs before it, and which subslots it is about on the relation that it belongs to:
the conversation remembers both. What the outputs were before that, a mock knows better, and says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ...wire.framing import MalformedError
from ...wire.profinet import dcp
from ...wire.profinet.blocks import INPUTS, OUTPUTS, CyclicData, Place, Submodule, frame_ids
from ...wire.profinet.dcp import Dcp
from ...wire.profinet.frames import IPV4, PROFINET, Datagram, Frame
from ...wire.profinet.rpc import CONNECT, Kind, Rpc
from ...wire.profinet.rt import FRAME_IDS, RtFrame
from ...wire.profinet.services import agreed_of, dcp_fields, rpc_fields, subslots_of
from ..conversation import Direction, Message, Outstanding

__all__ = ["ProfinetConversation"]

_KEPT = 300


class ProfinetConversation:
    """All that one client and the stations of its cable say to one another."""

    def __init__(self) -> None:
        self._asked = Outstanding()
        self._agreed: dict[int, CyclicData] = {}
        self._expected: Mapping[Place, Submodule] = {}
        self._sent: dict[Place, bytes] | None = None

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request``, ``cycle``, ``inputs``,
        ``response``, ``message``."""
        try:
            ethernet = Frame.parse(frame)
            if ethernet.ethertype == IPV4:
                message = self._called(direction, Rpc.parse(Datagram.parse(ethernet.payload).data))
            elif ethernet.ethertype != PROFINET:
                raise MalformedError(f"a frame of the type {ethernet.ethertype:04X}")
            elif int.from_bytes(ethernet.payload[:2]) in FRAME_IDS:
                message = self._cyclic(direction, RtFrame.parse(ethernet.payload))
            else:
                message = self._discovered(direction, ethernet, Dcp.parse(ethernet.payload))
        except MalformedError as error:
            told = {"bytes": frame[:_KEPT].hex(), "reason": str(error)}
            message = Message(direction=direction, kind="malformed", fields=told)
        return [message]

    def _discovered(self, direction: Direction, frame: Frame, told: Dcp) -> Message:
        mac = frame.destination if direction == "in" else frame.source
        fields = {**dcp_fields(told), "mac": mac.hex(":")}
        if (direction == "in") != (told.kind == dcp.REQUEST):
            return Message(direction=direction, kind="message", fields=fields)
        if direction == "in":
            return self._request(fields, told.xid, changes=fields["service"] == "set")
        asked = self._asked.take(told.xid)
        if asked is not None:
            # Every station answers an Identify.
            self._asked.add(told.xid, asked)
            fields["service"] = asked.fields["service"]
        return Message(direction="out", kind="response", fields=fields, answers=asked)

    def _called(self, direction: Direction, call: Rpc) -> Message:
        fields = rpc_fields(call)
        key = call.activity, call.sequence
        if direction == "in" and call.kind == Kind.REQUEST:
            if call.operation == CONNECT and fields.get("cyclic"):
                self._agreed, self._expected = agreed_of(call)
                self._sent = None
            return self._request(fields, key, changes=fields["service"] == "write")
        if direction == "out" and call.kind in (Kind.RESPONSE, Kind.FAULT, Kind.REJECT):
            if call.operation == CONNECT:
                for kind, frame_id in frame_ids(call.blocks).items():
                    if kind in self._agreed:
                        self._agreed[kind] = replace(self._agreed[kind], frame_id=frame_id)
            return Message(direction="out", kind="response", fields=fields, answers=self._asked.take(key))
        return Message(direction=direction, kind="message", fields=fields)

    def _request(self, fields: dict[str, Any], key: object, *, changes: bool) -> Message:
        asked = Message(
            direction="in",
            kind="request",
            fields=fields,
            request=True,
            state_changing=changes,
            unsure=("request", "state_changing"),
        )
        self._asked.add(key, asked)
        return asked

    def _cyclic(self, direction: Direction, frame: RtFrame) -> Message:
        agreed = self._agreed.get(OUTPUTS if direction == "in" else INPUTS)
        known = agreed is not None and agreed.frame_id == frame.frame_id
        told = subslots_of(frame, agreed, self._expected) if agreed is not None and known else {}
        data = {f"{slot}.{subslot}": content.hex() for (slot, subslot), content in told.items()}
        fields = {"service": "outputs" if direction == "in" else "inputs", "subslots": data}
        if direction == "out":
            return Message(direction="out", kind="inputs", fields=fields)
        # Outputs are zero before a relation.
        before = self._sent if self._sent is not None else {place: bytes(len(one)) for place, one in told.items()}
        changes = told != before
        self._sent = told
        return Message(
            direction="in",
            kind="request" if changes else "cycle",
            fields=fields,
            request=changes,
            state_changing=changes,
            unsure=("kind", "request", "state_changing", "subslots"),
        )
