"""Decoder of BACnet/IP for recorded datagrams; :mod:`pytest_otmcp.wire.bacnet` says what their bytes mean.

Requests are described as far as they can be read, also those that the device refuses.
"""

from __future__ import annotations

import contextlib
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ...wire.bacnet.frames import Apdu, LinkMessage, NetworkMessage, PduType, frame_of, head_of
from ...wire.bacnet.services import (
    STATE_CHANGING,
    STATE_CHANGING_UNCONFIRMED,
    Rejected,
    Unconfirmed,
    answer_fields,
    asked_of,
    who_has,
    who_is,
)
from ...wire.bacnet.values import Tags, value_of
from ...wire.framing import MalformedError
from ..conversation import Direction, Message, Outstanding

__all__ = ["BacnetConversation"]

_LINK_REQUESTS, _LINK_CHANGES = frozenset({1, 2, 5, 6, 8, 9}), frozenset({1, 8})
_ANSWERING = (PduType.SIMPLE_ACK, PduType.COMPLEX_ACK, PduType.ERROR, PduType.REJECT, PduType.ABORT)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Decoded:
    """A datagram as an entry shows it; ``key`` is what an answer shares with its request."""

    kind: str
    fields: Mapping[str, Any] = field(default_factory=dict)
    request: bool = False
    state_changing: bool = False
    key: Hashable = None


class BacnetConversation:
    """The datagrams of one client."""

    def __init__(self) -> None:
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one datagram, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; kinds are ``request``, ``response``,
        ``message`` for APDUs that ask and answer nothing, ``bvlc``, ``network-message`` and ``malformed``."""
        found = _decoded(direction, frame)
        answers = self._outstanding.take(found.key) if direction == "out" and found.key is not None else None
        message = Message(
            direction=direction,
            kind=found.kind,
            fields={**found.fields, "bytes": frame.hex()},
            request=found.request,
            state_changing=found.state_changing,
            answers=answers,
        )
        if found.request:
            self._outstanding.add(found.key, message)
        return [message]


def _decoded(direction: Direction, datagram: bytes) -> _Decoded:
    try:
        apdu = head_of(frame_of(datagram, answer=direction == "out").apdu)
        if apdu.kind == PduType.UNCONFIRMED_REQUEST:
            return _unconfirmed(direction, int(apdu.service or 0), apdu.data)
        return _confirmed(apdu) if direction == "in" else _answer(apdu)
    except LinkMessage as message:
        return _link(direction, message.function)
    except NetworkMessage as message:
        return _Decoded(kind="network-message", fields={"message": message.message})
    except MalformedError as error:
        return _Decoded(kind="malformed", fields={"reason": str(error)})


def _link(direction: Direction, function: int) -> _Decoded:
    asks = direction == "in" and function in _LINK_REQUESTS
    return _Decoded(
        kind="bvlc",
        fields={"function": function},
        request=asks,
        state_changing=asks and function in _LINK_CHANGES,
        key="bvlc" if asks or function == 0 else None,
    )


def _head(apdu: Apdu) -> dict[str, Any]:
    named = {} if apdu.service is None else {"service": apdu.service}
    return {"pdu_type": apdu.kind, **named, "invoke_id": apdu.invoke_id}


def _confirmed(apdu: Apdu) -> _Decoded:
    if apdu.kind != PduType.CONFIRMED_REQUEST:
        return _Decoded(kind="message", fields=_head(apdu))
    asked: dict[str, Any] = {}
    service = int(apdu.service or 0)
    if not apdu.is_segmented:
        # What cannot be read is not described.
        with contextlib.suppress(Rejected):
            asked = asked_of(service, apdu.data).shown()
    return _Decoded(
        kind="request",
        fields={**_head(apdu), **asked},
        request=True,
        state_changing=service in STATE_CHANGING,
        key=apdu.invoke_id,
    )


def _answer(apdu: Apdu) -> _Decoded:
    if apdu.kind not in _ANSWERING:
        return _Decoded(kind="message", fields=_head(apdu))
    said = answer_fields(apdu)
    if apdu.kind in (PduType.REJECT, PduType.ABORT):
        if not apdu.data:
            raise MalformedError("it ends before its reason")
        said = {"reject" if apdu.kind == PduType.REJECT else "abort": apdu.data[0]}
    return _Decoded(kind="response", fields={**_head(apdu), **said}, key=apdu.invoke_id)


def _unconfirmed(direction: Direction, service: int, data: bytes) -> _Decoded:
    fields: dict[str, Any] = {"pdu_type": int(PduType.UNCONFIRMED_REQUEST), "service": service}
    if direction == "out":
        if service not in (Unconfirmed.I_AM, Unconfirmed.I_HAVE):
            return _Decoded(kind="message", fields=fields)
        _, device = value_of("object-identifier", Tags(data).next().content).value
        key = "who-is" if service == Unconfirmed.I_AM else "who-has"
        return _Decoded(kind="response", fields={**fields, "device": device}, key=key)
    if service == Unconfirmed.WHO_IS:
        return _Decoded(kind="request", fields={**fields, **who_is(data)}, request=True, key="who-is")
    if service == Unconfirmed.WHO_HAS:
        return _Decoded(kind="request", fields={**fields, **who_has(data)}, request=True, key="who-has")
    changes = service in STATE_CHANGING_UNCONFIRMED
    return _Decoded(
        kind="request" if changes else "message", fields=fields, request=changes, state_changing=changes, key="other"
    )
