"""What the kit may do at a real DNP3 outstation: read static points. It writes nothing there, and takes no event away.

The tap judges each link frame by itself: a request passes when it is whole in one. A confirmation does not say what it confirms, and the
outstation removes confirmed events from its buffer (IEEE 1815-2012, clause 4.6.6), so the tap withholds what asks for events.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count, takewhile

from ...core.finding import Finding
from ...wire.dnp3.application import CONFIRM, READ, Request
from ...wire.dnp3.link import LinkFrame, link_length
from ..exercise import Asked
from ..field import Field
from ..journal import Entries, Image
from .entries import GROUPS, as_dnp3, objects
from .external import LAST_ADDRESS
from .oracle import read_from_device

__all__ = ["FIELD", "KINDS", "points"]

KINDS: Mapping[str, str] = {"read_analog": "analog_input", "read_binary": "binary_input"}
"""Operations to the kinds of points that they read; numbers first, which tell more than bits."""

_LINK_ALONE = frozenset({0xC0, 0xC9, 0xD2, 0xF2, 0x80, 0x81, 0x8B, 0x8F})
"""Control octets of a master's frames without user data (clause 9): reset, status and test of the link; answers to such frames."""
_USER_DATA = frozenset({0xC4, 0xD3, 0xF3})
"""Those of unconfirmed and confirmed user data. An outstation that finds another octet invalid may look for a frame within this one."""
_WHOLE = 0xC0
"""Transport and application header of what is first and final and asks for no confirmation, without its sequence number."""
_STATIC = frozenset({0, 1, 3, 10, 20, 21, 30, 31, 34, 40, 50, 101, 102, 110})
_CLASS_0 = (60, 1)
_APART, _BLOCK = 3, 4


def points(outstation: int, kind: str, found: Mapping[int, object]) -> Mapping[str, object]:
    """Return points of an outstation by name, with their values."""
    return {f"{outstation}/{kind}/{index}": value for index, value in found.items()}


def _place(point: str) -> tuple[int, str, int]:
    outstation, kind, index = point.split("/")
    return int(outstation), kind, int(index)


def _harmless(frame: bytes) -> bool:
    if link_length(frame) != len(frame):
        return False
    link, control = LinkFrame.parse(frame), frame[3]
    if link.destination > LAST_ADDRESS:
        return False
    if not link.data:
        return control in _LINK_ALONE
    fragment = link.data[1:]
    if control not in _USER_DATA or link.data[0] & _WHOLE != _WHOLE or fragment[0] & 0xF0 != _WHOLE:
        return False
    request = Request.parse(fragment)
    if request.function == CONFIRM:
        return len(fragment) == 2
    return _is_read(request) and not _asks_for_events(request)


def _is_read(request: Request) -> bool:
    return request.function == READ and bool(request.headers) and request.problem is None


def _asks_for_events(request: Request) -> bool:
    return any(one.group not in _STATIC and (one.group, one.variation) != _CLASS_0 for one in request.headers)


def _unanswered(frame: bytes) -> str | None:
    link = LinkFrame.parse(frame)
    if link.data and link.data[0] & _WHOLE != _WHOLE:
        return "the adapter sends a request in several segments, and the tap sees into those of one segment alone"
    request = Request.parse(link.data[1:])
    if request.function == CONFIRM:
        return "the outstation reports events unasked and forgets them once they are confirmed, so the tap withholds the confirmation"
    if _is_read(request) and _asks_for_events(request):
        return "the adapter asks for events, which the outstation forgets once they are confirmed, so the tap withholds the request"
    if request.function == READ or request.state_changing:
        return None
    return "the adapter writes the clock or the restart indication, or switches unsolicited responses, and the tap withholds the request"


def _reads(image: Image, claims: Callable[[str], bool]) -> list[Asked]:
    singles, blocks = [], []
    for operation, kind in KINDS.items():
        places = [(*_place(point), value) for point, value in image["points"].items()]
        found = {index: value for _, of, index, value in sorted(places) if of == kind}
        if not found or not claims(operation):
            continue
        outstation = places[0][0]
        first_with = {value: index for index, value in reversed(found.items())}
        chosen = sorted(first_with.values())[:_APART]
        run = list(takewhile(found.__contains__, count(chosen[0])))[:_BLOCK]
        singles += [_read(operation, outstation, {index: found[index]}) for index in chosen]
        blocks.append(_read(operation, outstation, {index: found[index] for index in run}))
    return [*singles, *blocks]


def _read(operation: str, outstation: int, found: Mapping[int, object]) -> Asked:
    return Asked(
        operation=operation,
        inputs={"outstation": outstation, "start": next(iter(found)), "count": len(found)},
        outputs={"values": list(found.values())},
        points=points(outstation, KINDS[operation], found),
    )


def _beyond(image: Image, claims: Callable[[str], bool]) -> Asked | None:
    for operation, kind in KINDS.items():
        if kind in image["beyond"] and claims(operation):
            outstation, index = image["beyond"][kind]
            return Asked(operation=operation, inputs={"outstation": outstation, "start": index, "count": 1})
    return None


def _was_read(entries: Entries, asked: Asked) -> list[Finding]:
    outstation, kind, start = _place(next(iter(asked.points)))
    here = [entry for entry in entries if as_dnp3(entry).get("destination", outstation) == outstation]
    return read_from_device(here, kind, start, len(asked.points))


def _sent(entries: Entries) -> list[object]:
    groups = [GROUPS[kind] for kind in KINDS.values()]
    told = (header for entry in entries if entry["kind"] == "response" for header in objects(entry))
    return [point["value"] for header in told if header["group"] in groups for point in header.get("points", [])]


FIELD = Field(
    harmless=_harmless,
    reads=_reads,
    beyond=_beyond,
    was_read=_was_read,
    sent=_sent,
    unanswered=_unanswered,
)
