"""The layers around an APDU: BACnet virtual link (annex J), network layer (clause 6.2), and the heads of APDUs (clause 20.1).

This file handles bytes, no objects and no sockets.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from ..framing import MalformedError

__all__ = [
    "ABORT_SEGMENTATION",
    "Apdu",
    "Frame",
    "LinkMessage",
    "NetworkMessage",
    "PduType",
    "frame_of",
    "head_of",
    "link_result",
    "unicast",
]

ABORT_SEGMENTATION = 4
"""Abort reason: segmentation is not supported."""

_BACNET_IP, _UNICAST, _BROADCAST, _FORWARDED = 0x81, 0x0A, 0x0B, 0x04
_EVERY_NETWORK = 0xFFFF
_MAX_RESPONSE = {0: 50, 1: 128, 2: 206, 3: 480, 4: 1024, 5: 1476}
_MAX_APDU = 1476


class PduType(IntEnum):
    """Types of APDUs (clause 20.1.1)."""

    CONFIRMED_REQUEST = 0
    UNCONFIRMED_REQUEST = 1
    SIMPLE_ACK = 2
    COMPLEX_ACK = 3
    SEGMENT_ACK = 4
    ERROR = 5
    REJECT = 6
    ABORT = 7


class LinkMessage(Exception):
    """The datagram is a message of the virtual link alone; ``function`` is its function."""

    def __init__(self, function: int) -> None:
        super().__init__(function)
        self.function = function


class NetworkMessage(Exception):
    """The datagram is a message of the network layer alone, or for another network; ``message`` is its type or None."""

    def __init__(self, message: int | None) -> None:
        super().__init__(message)
        self.message = message


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """An APDU and how it came.

    Attributes:
        source: network number and address of a sender on another network, as they are in the NPDU; empty for a sender on this one.
        expects_reply: the NPDU says that an answer is expected.
    """

    apdu: bytes
    source: bytes = b""
    expects_reply: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Apdu:
    """The head of an APDU.

    Attributes:
        kind: its type.
        invoke_id: None where the type has none.
        service: number of the service; None where the type has none.
        data: what follows the head.
        is_segmented: it is a part of a message.
        largest: bytes of the largest answer that the client takes.
    """

    kind: int
    invoke_id: int | None = None
    service: int | None = None
    data: bytes = b""
    is_segmented: bool = False
    largest: int = _MAX_APDU


def frame_of(datagram: bytes, *, answer: bool = False) -> Frame:
    """Return the APDU in a datagram.

    Args:
        answer: the device has sent it, so it may be for a client on another network.

    Raises:
        MalformedError: the datagram is none of BACnet/IP.
        LinkMessage, NetworkMessage: it has no APDU for this device.
    """
    if len(datagram) < 4 or datagram[0] != _BACNET_IP:
        raise MalformedError("it does not begin as BACnet/IP does")
    function = datagram[1]
    if int.from_bytes(datagram[2:4]) != len(datagram):
        raise MalformedError(f"its length field says {int.from_bytes(datagram[2:4])}, it has {len(datagram)} bytes")
    if function not in (_UNICAST, _BROADCAST, _FORWARDED):
        raise LinkMessage(function)
    npdu = datagram[10 if function == _FORWARDED else 4 :]
    if len(npdu) < 2 or npdu[0] != 1:
        raise MalformedError("its network layer is not version 1")
    control, at = npdu[1], 2
    destination = source = b""
    if control & 0x20:
        destination, at = _address(npdu, at)
    if control & 0x08:
        source, at = _address(npdu, at)
    if control & 0x20:
        at += 1  # hop count
    if control & 0x80:
        raise NetworkMessage(npdu[at] if len(npdu) > at else None)
    if destination and not answer and int.from_bytes(destination[:2]) != _EVERY_NETWORK:
        raise NetworkMessage(None)
    if len(npdu) <= at:
        raise MalformedError("it has no APDU")
    return Frame(apdu=npdu[at:], source=source, expects_reply=bool(control & 0x04))


def _address(npdu: bytes, at: int) -> tuple[bytes, int]:
    if len(npdu) < at + 3 or len(npdu) < at + 3 + npdu[at + 2]:
        raise MalformedError("it ends inside a network address")
    end = at + 3 + npdu[at + 2]
    return npdu[at:end], end


def head_of(apdu: bytes) -> Apdu:
    """Return the head of an APDU.

    Raises:
        MalformedError: it ends inside its head.
    """
    kind = apdu[0] >> 4
    try:
        if kind == PduType.CONFIRMED_REQUEST:
            is_segmented = bool(apdu[0] & 8)
            at = 5 if is_segmented else 3
            return Apdu(
                kind=kind,
                invoke_id=apdu[2],
                service=apdu[at],
                data=apdu[at + 1 :],
                is_segmented=is_segmented,
                largest=_MAX_RESPONSE.get(apdu[1] & 0x0F, _MAX_APDU),
            )
        if kind == PduType.UNCONFIRMED_REQUEST:
            return Apdu(kind=kind, service=apdu[1], data=apdu[2:])
        if kind in (PduType.SIMPLE_ACK, PduType.ERROR, PduType.COMPLEX_ACK):
            at = 4 if kind == PduType.COMPLEX_ACK and apdu[0] & 8 else 2
            return Apdu(kind=kind, invoke_id=apdu[1], service=apdu[at], data=apdu[at + 1 :])
        return Apdu(kind=kind, invoke_id=apdu[1], data=apdu[2:])
    except IndexError:
        raise MalformedError("it ends inside the head of its APDU") from None


def unicast(apdu: bytes, source: bytes = b"", *, expects_reply: bool = False) -> bytes:
    """Return the datagram of an answer or a request; ``source`` is that of the request which is answered, see :class:`Frame`."""
    control = 4 * expects_reply
    npdu = bytes([1, control]) if not source else bytes([1, control | 0x20]) + source + b"\xff"
    length = 4 + len(npdu) + len(apdu)
    return bytes([_BACNET_IP, _UNICAST]) + length.to_bytes(2) + npdu + apdu


def link_result(code: int) -> bytes:
    """Return the datagram of a BVLC-Result."""
    return bytes([_BACNET_IP, 0, 0, 6]) + code.to_bytes(2)
