"""The execution of services on the controller. It handles messages and tags, no sockets.

Source: Rockwell 1756-PM020, "CIP services". Every service is answered, the refused ones by a general status.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pytest_otmcp.wire.ethernetip import cip
from pytest_otmcp.wire.ethernetip.describe import describe
from pytest_otmcp.wire.ethernetip.messages import (
    SUCCESS,
    TOO_LITTLE_DATA,
    Path,
    Refusal,
    Reply,
    Request,
    embedded,
    multiple_reply,
)

from .faults import Rule
from .identity import attribute, every_attribute, program_name
from .plant import STRUCTURES, Plant
from .symbols import symbol_list, template_attributes, template_part
from .tags import PRIVILEGE, Place
from .types import Elementary

__all__ = ["Router", "named"]

PARTIAL, UNSUPPORTED, TOO_LARGE, TOO_MUCH_DATA = 0x06, 0x08, 0x11, 0x15
BAD_VALUE = 0x03
NO_DESTINATION, BAD_ATTRIBUTE_VALUE, ATTRIBUTE_ERROR, NO_SUCH_ATTRIBUTE = 0x05, 0x09, 0x0A, 0x14
GENERAL, BEYOND, TOO_MANY, OTHER_TYPE = 0xFF, 0x2104, 0x2105, 0x2107

_CLASSES = frozenset(
    {
        cip.IDENTITY,
        cip.MESSAGE_ROUTER,
        cip.CONNECTION_MANAGER,
        cip.PROGRAM_NAME,
        cip.SYMBOL,
        cip.TEMPLATE,
        cip.WALL_CLOCK,
    }
)
_HEAD = 4
"""Bytes of an answer before its data."""
_CLOCK_US, _DAYLIGHT, _LOCAL_US = 6, 0x0A, 0x0B
_INTEGERS = frozenset({"SINT", "INT", "DINT", "LINT", "USINT", "UINT", "UDINT", "ULINT"})


def named(plant: Plant, item: Mapping[str, Any]) -> str | None:
    """Return the name of the tag that a described service is for, as the image has it; None where it is for none.

    Names are compared without regard to case, and a symbol instance stands for a name.
    """
    text: str | None = item.get("tag")
    if item.get("class") == cip.SYMBOL and "instance" in item:
        tag = next((tag for tag in plant.tags if tag.instance == item["instance"] and tag.program is None), None)
        text = None if tag is None else Path(steps=(tag.label, *item.get("steps", ()))).label()
    if text is None:
        return None
    for tag in plant.tags:
        if text.lower() == tag.label.lower() or text.lower().startswith(
            (f"{tag.label}[".lower(), f"{tag.label}.".lower())
        ):
            return tag.label + text[len(tag.label) :]
    return text


@dataclass(slots=True, kw_only=True)
class Router:
    """The message router of the controller, for one request.

    Attributes:
        limit: the answer is at most so many bytes long.
        rule: fault that applies to the request; None for none.
    """

    plant: Plant
    limit: int
    rule: Rule | None = None

    def answer(self, raw: bytes) -> Reply:
        """Execute a request and return its answer."""
        try:
            request = Request.parse(raw)
        except Refusal as refusal:
            return Reply(service=raw[0] if raw else 0, status=refusal.status, extended=refusal.extended)
        reply = self._one(request, raw)
        if self.rule is not None and self.rule.answer_service is not None:
            # The bit that marks an answer is set again where the answer is encoded.
            return replace(reply, service=self.rule.answer_service)
        return reply

    def _one(self, request: Request, raw: bytes) -> Reply:
        rule = self._rule_for(raw)
        if rule is not None and rule.status is not None:
            extended = () if rule.extended is None else (rule.extended,)
            return Reply(service=request.service, status=rule.status, extended=extended)
        try:
            path = request.path
            if (path.class_id, request.service) == (cip.MESSAGE_ROUTER, cip.MULTIPLE):
                return self._multiple(request)
            data, status = self._run(path, request, rule)
        except Refusal as refusal:
            return Reply(service=request.service, status=refusal.status, extended=refusal.extended)
        return Reply(service=request.service, status=status, data=data)

    def _rule_for(self, raw: bytes) -> Rule | None:
        """Return the rule, if this service is one that it is about."""
        described = describe(raw)
        about = described["items"] if described["service"] != "multiple" else [{"asks": "multiple"}]
        fits = self.rule is not None and any(self.rule.fits(item, named(self.plant, item)) for item in about)
        return self.rule if fits else None

    def _multiple(self, request: Request) -> Reply:
        parts = embedded(request.data)
        if parts is None:
            raise Refusal(TOO_LITTLE_DATA)
        left = self.limit - _HEAD - 2 - 2 * len(parts)
        replies = []
        for raw in parts:
            reply = self._embedded(raw, left)
            left -= len(reply.encoded())
            replies.append(reply)
        return multiple_reply(request.service, replies)

    def _embedded(self, raw: bytes, left: int) -> Reply:
        try:
            request = Request.parse(raw)
        except Refusal as refusal:
            return Reply(service=raw[0] if raw else 0, status=refusal.status)
        if request.service == cip.MULTIPLE:
            return Reply(service=request.service, status=UNSUPPORTED)
        reply = Router(plant=self.plant, limit=self.limit, rule=self.rule)._one(request, raw)
        if len(reply.encoded()) > left:
            return Reply(service=request.service, status=TOO_LARGE)
        return reply

    def _run(self, path: Path, request: Request, rule: Rule | None) -> tuple[bytes, int]:
        """Execute a service; return the data of its answer, and its status.

        Raises:
            Refusal: it is not carried out.
        """
        code, data = request.service, request.data
        most = self.limit - _HEAD
        if code in cip.TAG_SERVICES and path.class_id in (None, cip.SYMBOL):
            return self._access(self.plant.find(path), code, data, rule)
        if (path.class_id, code) == (cip.SYMBOL, cip.LIST_INSTANCES):
            return symbol_list(self.plant, path, data, most)
        if path.class_id == cip.TEMPLATE and path.instance in STRUCTURES and code in (cip.GET_LIST, cip.READ):
            structure = STRUCTURES[path.instance]
            if code == cip.READ:
                return template_part(structure, data, most)
            return template_attributes(structure, data)
        fixed: dict[tuple[int | None, int | None, int], Callable[[], bytes]] = {
            (cip.IDENTITY, 1, cip.GET_ALL): every_attribute,
            (cip.IDENTITY, 1, cip.GET_SINGLE): lambda: attribute(path.attribute),
            (cip.PROGRAM_NAME, 1, cip.GET_ALL): program_name,
            (cip.WALL_CLOCK, 1, cip.GET_LIST): lambda: self._clock(data),
            (cip.WALL_CLOCK, 1, cip.SET_LIST): lambda: self._set_clock(data, rule),
        }
        found = fixed.get((path.class_id, path.instance, code))
        if found is None:
            # An object that is not there is a path without destination; one that is there does not have the service.
            known = path.class_id is None or path.class_id in _CLASSES
            raise Refusal(UNSUPPORTED) if known else Refusal(NO_DESTINATION, 0)
        return found(), SUCCESS

    # -- tags -------------------------------------------------------------------------------------------------

    def _access(self, place: Place, code: int, data: bytes, rule: Rule | None) -> tuple[bytes, int]:
        if code in (cip.READ, cip.READ_FRAGMENT):
            return self._read(place, code, data, rule)
        if place.tag.access != "read_write":
            raise Refusal(PRIVILEGE)
        apply = rule is None or not rule.ack_only
        (_modify if code == cip.MODIFY else _write)(place, code, data, apply)
        return b"", SUCCESS

    def _read(self, place: Place, code: int, data: bytes, rule: Rule | None) -> tuple[bytes, int]:
        wanted = 2 if code == cip.READ else 6
        if len(data) != wanted:
            raise Refusal(TOO_LITTLE_DATA if len(data) < wanted else TOO_MUCH_DATA)
        (count,) = struct.unpack_from("<H", data)
        start = struct.unpack_from("<I", data, 2)[0] if wanted == 6 else 0
        _check_count(place, count)
        content = place.read(count)
        if start and start >= len(content):
            raise Refusal(GENERAL, BEYOND)
        head, status = place.kind.head, SUCCESS
        part = content[start:]
        if rule is not None and rule.answer_type is not None:
            head = struct.pack("<H", rule.answer_type)
        if rule is not None and rule.answer_data is not None:
            return head + rule.answer_data, status
        most = self.limit - _HEAD - len(head)
        if len(part) > most:
            # Elements are not torn; a structure may be.
            size = place.kind.size if isinstance(place.kind, Elementary) else 4
            part, status = part[: most - most % size], PARTIAL
        return head + part, status

    # -- the clock --------------------------------------------------------------------------------------------

    def _clock(self, data: bytes) -> bytes:
        numbers = _numbers(data)
        answer = struct.pack("<H", len(numbers))
        for number in numbers:
            if number in (_CLOCK_US, _LOCAL_US):
                answer += struct.pack("<HHQ", number, 0, self.plant.clock())
            elif number == _DAYLIGHT:
                answer += struct.pack("<HHB", number, 0, 0)
            else:
                answer += struct.pack("<HH", number, NO_SUCH_ATTRIBUTE)
        return answer

    def _set_clock(self, data: bytes, rule: Rule | None) -> bytes:
        if len(data) < 2:
            raise Refusal(TOO_LITTLE_DATA)
        (count,), rest = struct.unpack_from("<H", data), data[2:]
        answer, wanted = struct.pack("<H", count), None
        for _ in range(count):
            number = int.from_bytes(rest[:2], "little")
            size = {_CLOCK_US: 8, _LOCAL_US: 8, _DAYLIGHT: 1}.get(number)
            if len(rest) < 2 + (size or 0):
                raise Refusal(TOO_LITTLE_DATA)
            if size is None:
                # How long an unknown attribute is cannot be told, so nothing behind it can be read.
                raise Refusal(ATTRIBUTE_ERROR)
            if size == 8:
                wanted = int.from_bytes(rest[2:10], "little")
            answer += struct.pack("<HH", number, 0)
            rest = rest[2 + size :]
        if rest:
            raise Refusal(TOO_MUCH_DATA)
        if wanted is not None and (rule is None or not rule.ack_only):
            try:
                self.plant.set_clock(wanted)
            except ValueError:
                raise Refusal(BAD_ATTRIBUTE_VALUE) from None
        return answer


def _numbers(data: bytes) -> tuple[int, ...]:
    """Return the numbers of a list of attributes."""
    if len(data) < 2 or len(data) < 2 + 2 * int.from_bytes(data[:2], "little"):
        raise Refusal(TOO_LITTLE_DATA)
    return struct.unpack_from(f"<{int.from_bytes(data[:2], 'little')}H", data, 2)


def _check_count(place: Place, count: int) -> None:
    if count == 0:
        raise Refusal(BAD_VALUE)
    if count > place.count:
        raise Refusal(GENERAL, TOO_MANY)


def _write(place: Place, code: int, data: bytes, apply: bool) -> None:
    head = place.kind.head
    if len(data) < len(head) + 2:
        raise Refusal(TOO_LITTLE_DATA)
    if data[: len(head)] != head:
        raise Refusal(GENERAL, OTHER_TYPE)
    (count,) = struct.unpack_from("<H", data, len(head))
    _check_count(place, count)
    rest, whole = data[len(head) + 2 :], count * place.kind.size
    if code == cip.WRITE:
        if len(rest) < whole:
            raise Refusal(TOO_LITTLE_DATA)
        # More than was announced is left alone: pycomm3 sends it, and controllers are reported to take it.
        start, content = 0, rest[:whole]
    else:
        if len(rest) < 5:
            raise Refusal(TOO_LITTLE_DATA)
        start, content = int(struct.unpack_from("<I", rest)[0]), rest[4:]
        if start + len(content) > whole:
            raise Refusal(GENERAL, BEYOND)
    if apply:
        place.write(content, start)


def _modify(place: Place, code: int, data: bytes, apply: bool) -> None:
    if len(data) < 2:
        raise Refusal(TOO_LITTLE_DATA)
    (size,) = struct.unpack_from("<H", data)
    if place.kind.name not in _INTEGERS:
        raise Refusal(GENERAL, OTHER_TYPE)
    if size != place.kind.size:
        raise Refusal(BAD_VALUE)
    if len(data) < 2 + 2 * size:
        raise Refusal(TOO_LITTLE_DATA)
    set_bits, kept = (int.from_bytes(data[start : start + size], "little") for start in (2, 2 + size))
    held = int.from_bytes(place.read(1), "little")
    if apply:
        place.write(((held | set_bits) & kept).to_bytes(size, "little"))
