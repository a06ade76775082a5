"""The services: what a request asks for, in words for the journal, and its execution on the plant.

ASHRAE 135, clauses 15.5 (ReadProperty), 15.7 (ReadPropertyMultiple), 15.9 (WriteProperty), 15.10 (WritePropertyMultiple), 16.9
(Who-Has), 16.10 (Who-Is); reject reasons of clause 18.9. Bytes and objects, no sockets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from .names import Confirmed, ObjectType, Refusal
from .objects import PRIORITIES, element_of
from .plant import DEVICE, MAX_APDU, NO_SEGMENTATION, VENDOR, Plant
from .values import KINDS, MalformedError, Tags, Value, context, enclosed, encode, value_of

__all__ = [
    "STATE_CHANGING",
    "STATE_CHANGING_UNCONFIRMED",
    "Answer",
    "Asked",
    "FailedWriteError",
    "Rejected",
    "Write",
    "asked_of",
    "execute",
    "i_am",
    "i_have",
    "is_for",
    "read_answer",
    "who_has",
    "who_is",
]

STATE_CHANGING = frozenset({0, 7, 8, 9, 10, 11, 15, 16, 17, 20, 27})
"""Confirmed services that may change the device: acknowledge alarm, write file, list elements, create and delete object, write
property (multiple), device communication control, reinitialize, life safety operation."""
STATE_CHANGING_UNCONFIRMED = frozenset({6, 9, 10, 12})
"""Time synchronization, UTC time synchronization, write group, you-are."""

INVALID_TAG, MISSING_PARAMETER, OUT_OF_RANGE, TOO_MANY_ARGUMENTS, UNRECOGNIZED_SERVICE = 4, 5, 6, 7, 9
_WILDCARD = 4194303
_MAX_ELEMENTS = 400


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
        """Return the reference for the journal."""
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
        """Return the write for the journal."""
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


class FailedWriteError(Exception):
    """The device refuses one of several writes: those before it are done, those behind it are not (clause 15.10.2)."""

    def __init__(self, refusal: Refusal, to: Reference) -> None:
        super().__init__(refusal, to)
        self.refusal, self.to = refusal, to

    def data(self) -> bytes:
        """Return the data of the Error PDU: the error, and which write is the first that failed."""
        codes = b"".join(encode(Value(kind="enumerated", value=code)) for code in self.refusal.error)
        return enclosed(0, codes) + enclosed(1, _named(self.to))


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What the device answers: the data of a complex acknowledgement, or None for a simple one; and what they say."""

    data: bytes | None
    results: Sequence[Mapping[str, Any]] = field(default_factory=list)


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
    found: list[Reference] = []
    while not tags.at_end:
        kind, instance = _identifier(tags)
        if not tags.is_next(1, opening=True):
            raise Rejected(MISSING_PARAMETER)
        tags.next()
        while tags.is_next(0):
            found.append(_reference(tags, kind, instance, 0))
        closing = tags.next()
        if not closing.is_closing or closing.number != 1:
            raise Rejected(INVALID_TAG)
    if not found:
        raise Rejected(MISSING_PARAMETER)
    return Asked(reads=found, rejected=TOO_MANY_ARGUMENTS if len(found) > _MAX_ELEMENTS else None)


def _write(tags: Tags) -> Asked:
    kind, instance = _identifier(tags)
    write = _written(tags, kind, instance, 1)
    return Asked(writes=[write], rejected=OUT_OF_RANGE if write.is_rejected else None)


def _write_multiple(tags: Tags) -> Asked:
    found: list[Write] = []
    while not tags.at_end:
        kind, instance = _identifier(tags)
        if not tags.is_next(1, opening=True):
            raise Rejected(MISSING_PARAMETER)
        tags.next()
        while tags.is_next(0):
            found.append(_written(tags, kind, instance, 0))
        closing = tags.next()
        if not closing.is_closing or closing.number != 1:
            raise Rejected(INVALID_TAG)
    if not found:
        raise Rejected(MISSING_PARAMETER)
    if len(found) > _MAX_ELEMENTS:
        return Asked(writes=found, rejected=TOO_MANY_ARGUMENTS)
    return Asked(writes=found, rejected=OUT_OF_RANGE if any(one.is_rejected for one in found) else None)


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


def execute(plant: Plant, service: int, asked: Asked, *, apply: bool = True, named: int | None = None) -> Answer:
    """Execute a request.

    Args:
        apply: False answers a write as if it had been done, without doing it.
        named: instance that the answer to a ReadPropertyMultiple names for each object, instead of the one that was asked for.

    Raises:
        Refusal, FailedWriteError: the error to answer with.
        Rejected: the reject reason to answer with.
    """
    if asked.rejected is not None:
        raise Rejected(asked.rejected)
    if asked.writes:
        for write in asked.writes:
            try:
                _execute_write(plant, write, apply=apply)
            except Refusal as refusal:
                if service == Confirmed.WRITE_PROPERTY:
                    raise
                raise FailedWriteError(refusal, write.to) from None
        return Answer(data=None)
    if service == Confirmed.READ_PROPERTY:
        one = _meant_device(asked.reads[0])
        values = element_of(plant.content(one.kind, one.instance, one.number), one.index)
        return read_answer(one, values)
    return _multiple_answer(plant, list(map(_meant_device, asked.reads)), named)


def _execute_write(plant: Plant, write: Write, *, apply: bool) -> None:
    to = write.to
    if (to.kind, to.instance) == (ObjectType.DEVICE, DEVICE):
        plant.content(to.kind, to.instance, to.number)
        raise Refusal(2, 40)
    plant.at(to.kind, to.instance).write(to.number, to.index, write.values, write.priority, apply=apply)


def _meant_device(one: Reference) -> Reference:
    # Clause 15.5.1.1.1: this instance of a device object stands for the device that is asked.
    return one.at(DEVICE) if (one.kind, one.instance) == (ObjectType.DEVICE, _WILDCARD) else one


def _named(one: Reference) -> bytes:
    data = context(0, "object-identifier", [one.kind, one.instance]) + context(1, "enumerated", one.number)
    return data if one.index is None else data + context(2, "unsigned", one.index)


def read_answer(one: Reference, values: Sequence[Value]) -> Answer:
    """Return the answer to a ReadProperty that found these values."""
    shown = {**one.shown(), "values": [value.shown() for value in values]}
    return Answer(data=_named(one) + enclosed(3, b"".join(map(encode, values))), results=[shown])


def _multiple_answer(plant: Plant, reads: Sequence[Reference], named: int | None) -> Answer:
    data, results = b"", []
    at = 0
    while at < len(reads):
        first = reads[at]
        block = b""
        while at < len(reads) and (reads[at].kind, reads[at].instance) == (first.kind, first.instance):
            asked = reads[at]
            at += 1
            for one in _meant(plant, asked):
                encoded, shown = _result(plant, one, _told(one, named))
                block += encoded
                results.append(shown)
        told = _told(first, named)
        data += context(0, "object-identifier", [told.kind, told.instance]) + enclosed(1, block)
    return Answer(data=data, results=results)


def _told(one: Reference, named: int | None) -> Reference:
    return one if named is None else one.at(named)


def _meant(plant: Plant, asked: Reference) -> list[Reference]:
    try:
        numbers = plant.named(asked.kind, asked.instance, asked.number)
    except Refusal:
        numbers = [asked.number]
    return [Reference(kind=asked.kind, instance=asked.instance, number=one, index=asked.index) for one in numbers]


def _result(plant: Plant, one: Reference, told: Reference) -> tuple[bytes, dict[str, Any]]:
    head = context(2, "enumerated", one.number)
    if one.index is not None:
        head += context(3, "unsigned", one.index)
    try:
        values = element_of(plant.content(one.kind, one.instance, one.number), one.index)
    except Refusal as refusal:
        codes = b"".join(encode(Value(kind="enumerated", value=code)) for code in refusal.error)
        return head + enclosed(5, codes), {**told.shown(), "error": list(refusal.error)}
    shown = {**told.shown(), "values": [value.shown() for value in values]}
    return head + enclosed(4, b"".join(map(encode, values))), shown


# -- finding devices and objects --------------------------------------------------------------------------------


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


def is_for(bounds: Mapping[str, int]) -> bool:
    """Tell whether a Who-Is with these bounds asks this device."""
    return bounds.get("low", 0) <= DEVICE <= bounds.get("high", _WILDCARD)


def i_am() -> bytes:
    """Return the APDU of an I-Am."""
    values = [
        Value(kind="object-identifier", value=[int(ObjectType.DEVICE), DEVICE]),
        Value(kind="unsigned", value=MAX_APDU),
        Value(kind="enumerated", value=NO_SEGMENTATION),
        Value(kind="unsigned", value=VENDOR),
    ]
    return b"\x10\x00" + b"".join(map(encode, values))


def who_has(plant: Plant, data: bytes) -> tuple[dict[str, Any], tuple[tuple[int, int], str] | None]:
    """Return what a Who-Has asks for, and the identifier and name of the object if this device is asked and has it.

    Raises:
        MalformedError: this is no Who-Has.
    """
    tags = Tags(data)
    bounds: dict[str, Any] = {}
    try:
        if tags.is_next(0):
            bounds = {"low": _unsigned(tags, 0), "high": _unsigned(tags, 1)}
        names = plant.names()
        if tags.is_next(2):
            kind, instance = value_of("object-identifier", tags.next().content).value
            bounds["object"] = [kind, instance]
            found = next((((kind, instance), name) for name, one in names.items() if one == (kind, instance)), None)
        elif tags.is_next(3):
            name = str(value_of("character-string", tags.next().content).value)
            bounds["name"] = name
            found = (names[name], name) if name in names else None
        else:
            raise MalformedError("a Who-Has asks for an object")
    except Rejected:
        raise MalformedError("a Who-Has has two bounds or none") from None
    return bounds, found if is_for(bounds) else None


def i_have(identifier: tuple[int, int], name: str) -> bytes:
    """Return the APDU of an I-Have."""
    values = [
        Value(kind="object-identifier", value=[int(ObjectType.DEVICE), DEVICE]),
        Value(kind="object-identifier", value=list(identifier)),
        Value(kind="character-string", value=name),
    ]
    return b"\x10\x01" + b"".join(map(encode, values))
