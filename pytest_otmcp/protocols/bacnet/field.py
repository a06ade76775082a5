"""What the kit may do at a real BACnet/IP device: read present values that are numbers. It writes nothing there.

What reaches more than this device does not pass, and neither does what the device keeps when its client has gone: a subscription that does
not end by itself, a foreign device, and an I-Am, by which it would take the client for a peer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ...core.finding import Finding
from ...wire.bacnet.frames import PduType, frame_of, head_of
from ...wire.bacnet.services import Confirmed, Unconfirmed, asked_of, who_has, who_is
from ...wire.bacnet.values import Tags
from ..exercise import Asked
from ..field import Field
from ..journal import Entries, Image
from .entries import PRESENT_VALUE, as_bacnet
from .oracle import read_from_device

__all__ = ["FIELD", "UNHEARD"]

_UNICAST, _REGISTER = 0x0A, 0x05
"""Functions of the virtual link: a message for this device alone, and the registration of a foreign device (J.2)."""
_PRIORITY, _EXPECTS_REPLY = 3, 4
"""Bits of a network layer without an address of another network and without a message of its own (clause 6.2.2)."""
_REQUESTS = (0x00, 0x02)
"""First byte of a confirmed request in one segment; an answer may have several, each of which the client acknowledges."""
_UNCONFIRMED, _SEGMENT_ACKS, _ABORT = 0x10, (0x40, 0x42), 0x70
"""First byte of what a client, not a server, sends (clause 20.1)."""
_READS = (Confirmed.READ_PROPERTY, Confirmed.READ_PROPERTY_MULTIPLE)
_SUBSCRIBE, _SUBSCRIPTIONS, _IDENTIFIER, _HOUR_S = 5, (5, 28, 30), 4, 3600
"""SubscribeCOV (clause 13.14); with SubscribeCOVProperty and SubscribeCOVPropertyMultiple; bytes of an object identifier."""
_APART = 3


def _harmless(frame: bytes) -> bool:
    if frame[1] != _UNICAST or frame[5] & ~(_PRIORITY | _EXPECTS_REPLY):
        return False
    apdu = frame_of(frame).apdu
    head = head_of(apdu)
    if apdu[0] in _REQUESTS and head.service == _SUBSCRIBE:
        return _ends_by_itself(head.data)
    if apdu[0] in _REQUESTS:
        return head.service in _READS and asked_of(head.service, head.data).rejected is None
    if apdu[0] == _UNCONFIRMED and head.service in _LOOKS:
        # It raises an error where this is no such request.
        _LOOKS[head.service](head.data)
        return True
    # What an answer in several segments takes, and the end of an exchange of the client's own.
    return (apdu[0] in _SEGMENT_ACKS and len(apdu) == 4) or (apdu[0] == _ABORT and len(apdu) == 3)


_LOOKS: dict[int, Callable[[bytes], object]] = {Unconfirmed.WHO_IS: who_is, Unconfirmed.WHO_HAS: who_has}


def _ends_by_itself(data: bytes) -> bool:
    """Tell whether a SubscribeCOV ends a subscription of the client's own, or asks for an hour at most, for what nobody has to confirm."""
    tags, found = Tags(data), []
    while not tags.at_end:
        found.append(tags.next())
    if any(not tag.is_context or tag.is_opening or tag.is_closing for tag in found):
        return False
    numbers = [tag.number for tag in found if tag.number != 1 or len(tag.content) == _IDENTIFIER]
    is_short = len(found) == 4 and found[2].content == b"\0" and 0 < int.from_bytes(found[3].content) <= _HOUR_S
    return numbers == [0, 1] or (numbers == [0, 1, 2, 3] and is_short)


def _unseen(frame: bytes) -> str | None:
    if frame[1] == _REGISTER:
        return "the adapter registers as a foreign device, which the device would keep when the run is over"
    head = head_of(frame_of(frame).apdu)
    if head.kind == PduType.UNCONFIRMED_REQUEST and head.service in _LOOKS:
        return (
            "the adapter looks for devices, and what it or the device broadcasts for that does not pass the tap: "
            "give the adapter a launch that knows the device's address"
        )
    if head.kind != PduType.CONFIRMED_REQUEST:
        return None
    if head.service in _SUBSCRIPTIONS:
        return "the adapter subscribes to values for longer than an hour, for notifications that are confirmed, or by another service than SubscribeCOV"
    if head.is_segmented and head.service in _READS:
        return "the adapter sends a request in several segments, and the tap sees into those in one alone"
    return None


def _place(point: str) -> dict[str, object]:
    """Return the inputs of the call that reads a point such as ``12345/analog-input,1``."""
    device, _, target = point.partition("/")
    kind, _, instance = target.partition(",")
    return {"device": int(device), "type": kind, "instance": int(instance)}


def _reads(image: Image, claims: Callable[[str], bool]) -> list[Asked]:
    first_with: dict[object, str] = {}
    for point, value in image["points"].items():
        first_with.setdefault(value, point)
    chosen = list(first_with.items())[:_APART] if claims("read") else []
    return [
        Asked(operation="read", inputs=_place(point), outputs={"value": value}, points={point: value})
        for value, point in chosen
    ]


def _beyond(image: Image, claims: Callable[[str], bool]) -> Asked | None:
    missing = image["beyond"].get("point")
    return Asked(operation="read", inputs=_place(missing)) if missing is not None and claims("read") else None


def _was_read(entries: Entries, asked: Asked) -> list[Finding]:
    return read_from_device(entries, (str(asked.inputs["type"]), int(asked.inputs["instance"])))


def _sent(entries: Entries) -> list[object]:
    results = (one for entry in entries if entry["kind"] == "response" for one in as_bacnet(entry).get("results", []))
    return [value["value"] for one in results if one["property"] == PRESENT_VALUE for value in one.get("values", [])]


FIELD = Field(harmless=_harmless, reads=_reads, beyond=_beyond, was_read=_was_read, sent=_sent, unseen=_unseen)

UNHEARD = replace(
    FIELD, harmless=lambda frame: _harmless(frame) and head_of(frame_of(frame).apdu).kind != PduType.UNCONFIRMED_REQUEST
)
"""For a device whose answers to a Who-Is do not come back to who asked: an honest adapter that looks for it would find nothing."""
