"""Decoder of EtherCAT frames; :mod:`pytest_otmcp.wire.ethercat` says what their bytes mean.

Whose outputs the bytes of process data are, and whether they change any, cannot be read in a frame: it depends on how the master has set its
slaves up. A mock knows, and says so.
"""

from __future__ import annotations

from ...wire.ethercat import (
    AL_STATUS,
    LOGICAL,
    MAILBOX_BYTES,
    MAILBOX_IN,
    READS,
    STATE_BITS,
    STATES,
    Datagram,
    fields_of,
    has_counter,
    parse,
    sdo_of,
)
from ...wire.framing import MalformedError
from ..conversation import Direction, Message

__all__ = ["EthercatConversation"]

_KEPT = 300


class EthercatConversation:
    """One cable: a frame comes back with the number that its datagram has, and the answer about an object in a later one."""

    def __init__(self) -> None:
        self._asked: dict[int, Message] = {}
        self._objects: dict[int, Message] = {}
        self._posted: dict[int, bytes] = {}

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request``, ``repeat``,
        ``cycle`` and ``response``."""
        try:
            datagrams = parse(frame)
        except MalformedError as error:
            told = {"bytes": frame[:_KEPT].hex(), "reason": str(error)}
            return [Message(direction=direction, kind="malformed", fields=told)]
        read = self._request if direction == "in" else self._answer
        return [message for one in datagrams if (message := read(one)) is not None]

    def _request(self, datagram: Datagram) -> Message | None:
        fields = fields_of(datagram)
        if fields is None:
            return None
        if cycle := datagram.command in LOGICAL:
            # Who does not know the slave believes nothing of it.
            fields = {**fields, "slave": None}
        if self._is_repeated(datagram, fields["service"]):
            return Message(direction="in", kind="repeat", fields=fields)
        message = Message(
            direction="in",
            kind="cycle" if cycle else "request",
            fields=fields,
            request=not cycle,
            state_changing=fields["service"] == "sdo_download",
            unsure=("kind", "request", "state_changing", "slave") if cycle else (),
        )
        self._asked[datagram.index] = message
        if fields["service"].startswith("sdo"):
            self._objects[datagram.position] = message
        return message

    def _is_repeated(self, datagram: Datagram, service: str) -> bool:
        """Tell whether a mailbox is sent once more, because the frame did not come back in time. It has the same counter then, by which
        the slave knows it (ETG.1000.4, 5.6); in INIT it forgets that."""
        if service == "state":
            self._posted.clear()
        if not service.startswith("sdo"):
            return False
        before, self._posted[datagram.position] = self._posted.get(datagram.position), datagram.data
        return before == datagram.data and has_counter(datagram.data)

    def _answer(self, datagram: Datagram) -> Message | None:
        if datagram.command in READS and datagram.covers(MAILBOX_IN + MAILBOX_BYTES - 1):
            sdo = sdo_of(datagram.data)
            if sdo is None:
                return None
            fields = {"station": datagram.position, "index": sdo.index, "subindex": sdo.subindex, "abort": sdo.abort}
            asked = self._objects.pop(datagram.position, None)
            more = {"service": sdo.service, "data": sdo.data.hex()}
            return Message(direction="out", kind="response", fields={**fields, **more}, answers=asked)
        asked = self._asked.pop(datagram.index, None)
        told: dict[str, object] = {"service": "other", "counter": datagram.counter, "data": datagram.data.hex()}
        if datagram.command in READS and datagram.covers(AL_STATUS):
            told["state"] = STATES.get(datagram.data[AL_STATUS - datagram.offset] & STATE_BITS, "none")
        if asked is not None:
            told["service"] = asked.fields["service"]
        return Message(direction="out", kind="response", fields=told, answers=asked)
