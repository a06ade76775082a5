"""The services: what requests ask for and answers say, in words for journal entries.

ASHRAE 135, clauses 15.5 (ReadProperty), 15.7 (ReadPropertyMultiple), 15.9 (WriteProperty), 15.10 (WritePropertyMultiple), 16.9
(Who-Has), 16.10 (Who-Is); reject reasons of clause 18.9.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, TypeVar

from ..framing import MalformedError
from .frames import Apdu, PduType
from .values import KINDS, Tags, Value, value_of

__all__ = [
    "PRIORITIES",
    "STATE_CHANGING",
    "STATE_CHANGING_UNCONFIRMED",
    "Asked",
    "Confirmed",
    "Reference",
    "Rejected",
    "Unconfirmed",
    "Write",
    "answer_fields",
    "asked_of",
    "who_has",
    "who_is",
]

T = TypeVar("T")

PRIORITIES = 16
"""Slots of a priority array."""
STATE_CHANGING = frozenset({0, 7, 8, 9, 10, 11, 15, 16, 17, 20, 27})
"""Confirmed services that may change the device: acknowledge alarm, write file, list elements, create and delete object, write
property (multiple), device communication control, reinitialize, life safety operation."""
STATE_CHANGING_UNCONFIRMED = frozenset({6, 9, 10, 12})
"""Time synchronization, UTC time synchronization, write group, you-are."""

INVALID_TAG, MISSING_PARAMETER, OUT_OF_RANGE, TOO_MANY_ARGUMENTS, UNRECOGNIZED_SERVICE = 4, 5, 6, 7, 9
_MAX_ELEMENTS = 400


class Confirmed(IntEnum):
    """Confirmed services whose data are read here."""

    READ_PROPERTY = 12
    READ_PROPERTY_MULTIPLE = 14
    WRITE_PROPERTY = 15
    WRITE_PROPERTY_MULTIPLE = 16


class Unconfirmed(IntEnum):
    """Unconfirmed services whose data are read here."""

    I_AM = 0
    I_HAVE = 1
    WHO_HAS = 7
    WHO_IS = 8


class Rejected(Exception):
    """The request is answered with a Reject PDU; ``reason`` is its reason."""

    def __init__(self, reason: int) -> None:
        super().__init__(reason)
        self.reason = reason


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """A property of an object; ``index`` is None for the whole of it."""

    kind: int
    instance: int
    number: int
    index: int | None = None

    def at(self, instance: int) -> Reference:
        """Return the same property of another instance."""
        return replace(self, instance=instance)

    def shown(self) -> dict[str, Any]:
        """Return the reference for a journal entry."""
        index = {} if self.index is None else {"index": self.index}
        return {"object": [self.kind, self.instance], "property": self.number, **index}


@dataclass(frozen=True, slots=True, kw_only=True)
class Write:
    """What a request writes to a property; the priority is None where it names none."""

    to: Reference
    values: Sequence[Value]
    priority: int | None = None

    @property
    def is_rejected(self) -> bool:
        """There is no such priority."""
        return self.priority is not None and not 1 <= self.priority <= PRIORITIES

    def shown(self) -> dict[str, Any]:
        """Return the write for a journal entry."""
        priority = {} if self.priority is None else {"priority": self.priority}
        return {**self.to.shown(), "values": [one.shown() for one in self.values], **priority}


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """A request that was understood.

    Attributes:
        reads: what it asks for.
        writes: what it writes, in this order; none where it reads.
        rejected: reason why it is rejected although it could be read.
    """

    reads: Sequence[Reference] = ()
    writes: Sequence[Write] = ()
    rejected: int | None = None

    def shown(self) -> dict[str, Any]:
        """Return the members of the request's journal entry."""
        if self.writes:
            return {"writes": [one.shown() for one in self.writes]}
        return {"reads": [one.shown() for one in self.reads]}

    def objects(self) -> set[tuple[int, int]]:
        """Return the identifiers of the objects that it is about."""
        return {(one.kind, one.instance) for one in (*self.reads, *(write.to for write in self.writes))}


def asked_of(service: int, data: bytes) -> Asked:
    """Return what a confirmed request asks for.

    Raises:
        Rejected: the device does not know the service, or the data are not as the service has them.
    """
    parsers: Mapping[int, Callable[[Tags], Asked]] = {
        Confirmed.READ_PROPERTY: _read,
        Confirmed.READ_PROPERTY_MULTIPLE: _read_multiple,
        Confirmed.WRITE_PROPERTY: _write,
        Confirmed.WRITE_PROPERTY_MULTIPLE: _write_multiple,
    }
    if service not in parsers:
        raise Rejected(UNRECOGNIZED_SERVICE)
    tags = Tags(data)
    try:
        asked = parsers[service](tags)
    except MalformedError:
        raise Rejected(INVALID_TAG) from None
    return asked if tags.at_end else replace(asked, rejected=TOO_MANY_ARGUMENTS)


def _read(tags: Tags) -> Asked:
    kind, instance = _identifier(tags)
    return Asked(reads=[_reference(tags, kind, instance, 1)])


def _read_multiple(tags: Tags) -> Asked:
    found = _of_each_object(tags, _reference)
    return Asked(reads=found, rejected=TOO_MANY_ARGUMENTS if len(found) > _MAX_ELEMENTS else None)


def _write(tags: Tags) -> Asked:
    kind, instance = _identifier(tags)
    write = _written(tags, kind, instance, 1)
    return Asked(writes=[write], rejected=OUT_OF_RANGE if write.is_rejected else None)


def _write_multiple(tags: Tags) -> Asked:
    found = _of_each_object(tags, _written)
    if len(found) > _MAX_ELEMENTS:
        return Asked(writes=found, rejected=TOO_MANY_ARGUMENTS)
    return Asked(writes=found, rejected=OUT_OF_RANGE if any(one.is_rejected for one in found) else None)


def _of_each_object(tags: Tags, parsed: Callable[[Tags, int, int, int], T]) -> list[T]:
    """Return what ``parsed`` makes of each property in the list of each object.

    Raises:
        Rejected: there is none, or a list is not as the service has it.
    """
    found: list[T] = []
    while not tags.at_end:
        kind, instance = _identifier(tags)
        if not tags.is_next(1, opening=True):
            raise Rejected(MISSING_PARAMETER)
        tags.next()
        while tags.is_next(0):
            found.append(parsed(tags, kind, instance, 0))
        closing = tags.next()
        if not closing.is_closing or closing.number != 1:
            raise Rejected(INVALID_TAG)
    if not found:
        raise Rejected(MISSING_PARAMETER)
    return found


def _written(tags: Tags, kind: int, instance: int, first: int) -> Write:
    """Return the write whose property has this context tag; index, values and priority follow."""
    reference = _reference(tags, kind, instance, first)
    if not tags.is_next(first + 2, opening=True):
        raise Rejected(MISSING_PARAMETER)
    tags.next()
    values = []
    for tag in tags.inside(first + 2):
        if tag.is_context or tag.number >= len(KINDS):
            raise Rejected(INVALID_TAG)
        values.append(value_of(KINDS[tag.number], tag.content))
    priority = _unsigned(tags, first + 3) if tags.is_next(first + 3) else None
    return Write(to=reference, values=values, priority=priority)


def _identifier(tags: Tags) -> tuple[int, int]:
    if not tags.is_next(0):
        raise Rejected(MISSING_PARAMETER)
    kind, instance = value_of("object-identifier", tags.next().content).value
    return kind, instance


def _reference(tags: Tags, kind: int, instance: int, first: int) -> Reference:
    number = _unsigned(tags, first)
    index = _unsigned(tags, first + 1) if tags.is_next(first + 1) else None
    return Reference(kind=kind, instance=instance, number=number, index=index)


def _unsigned(tags: Tags, number: int) -> int:
    if not tags.is_next(number):
        raise Rejected(MISSING_PARAMETER)
    return int(value_of("unsigned", tags.next().content).value)


def who_is(data: bytes) -> dict[str, int]:
    """Return the bounds of a Who-Is; empty where it asks every device.

    Raises:
        MalformedError: these are no bounds.
    """
    tags = Tags(data)
    if tags.at_end:
        return {}
    try:
        bounds = {"low": _unsigned(tags, 0), "high": _unsigned(tags, 1)}
    except Rejected:
        raise MalformedError("a Who-Is has two bounds or none") from None
    if not tags.at_end:
        raise MalformedError("a Who-Is has two bounds at most")
    return bounds


def who_has(data: bytes) -> dict[str, Any]:
    """Return the bounds of a Who-Has, if it has some, and the ``object`` or ``name`` that it asks for.

    Raises:
        MalformedError: this is no Who-Has.
    """
    tags = Tags(data)
    found: dict[str, Any] = {}
    try:
        if tags.is_next(0):
            found = {"low": _unsigned(tags, 0), "high": _unsigned(tags, 1)}
    except Rejected:
        raise MalformedError("a Who-Has has two bounds or none") from None
    if tags.is_next(2):
        found["object"] = value_of("object-identifier", tags.next().content).value
    elif tags.is_next(3):
        found["name"] = value_of("character-string", tags.next().content).value
    else:
        raise MalformedError("a Who-Has asks for an object")
    if not tags.at_end:
        raise MalformedError("a Who-Has asks for one object")
    return found


# -- answers ----------------------------------------------------------------------------------------------------


def answer_fields(apdu: Apdu) -> dict[str, Any]:
    """Return what the data of an acknowledgement or an error say.

    Raises:
        MalformedError: they are not as the service has them.
    """
    tags = Tags(apdu.data)
    try:
        if apdu.kind == PduType.ERROR:
            if apdu.service == Confirmed.WRITE_PROPERTY_MULTIPLE:
                return {"error": [one["value"] for one in _values(tags, 0)]}
            return {"error": [_value(tags)["value"], _value(tags)["value"]]}
        if apdu.kind != PduType.COMPLEX_ACK or apdu.is_segmented:
            return {}
        if apdu.service == Confirmed.READ_PROPERTY:
            kind, instance = _identifier(tags)
            found = _reference(tags, kind, instance, 1).shown()
            return {"results": [{**found, "values": _values(tags, 3)}]}
        if apdu.service == Confirmed.READ_PROPERTY_MULTIPLE:
            return {"results": _results(tags)}
    except Rejected:
        raise MalformedError("its data are not as the service has them") from None
    return {}


def _results(tags: Tags) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    while not tags.at_end:
        kind, instance = _identifier(tags)
        if not tags.is_next(1, opening=True):
            raise MalformedError("an object without its results")
        tags.next()
        while tags.is_next(2):
            one = _reference(tags, kind, instance, 2).shown()
            if tags.is_next(5, opening=True):
                one["error"] = [value["value"] for value in _values(tags, 5)]
            else:
                one["values"] = _values(tags, 4)
            found.append(one)
        _close(tags, 1)
    return found


def _values(tags: Tags, number: int) -> list[dict[str, Any]]:
    """Return the values between the opening and the closing tag of this number; what is no primitive value is ``constructed``."""
    if not tags.is_next(number, opening=True):
        raise MalformedError(f"tag {number} does not open")
    tags.next()
    found: list[dict[str, Any]] = []
    while (tag := tags.peek()) is None or not tag.is_closing:
        if tag is not None and tag.is_context:
            found.append({"type": "constructed", "value": tags.construction().hex()})
        else:
            found.append(_value(tags))
    _close(tags, number)
    return found


def _value(tags: Tags) -> dict[str, Any]:
    tag = tags.next()
    if tag.is_context or tag.number >= len(KINDS):
        raise MalformedError("it is no primitive value")
    return value_of(KINDS[tag.number], tag.content).shown()


def _close(tags: Tags, number: int) -> None:
    tag = tags.next()
    if not tag.is_closing or tag.number != number:
        raise MalformedError(f"tag {number} does not close")
