"""The execution of services on the plant. Bytes and objects, no sockets; what requests ask for says :mod:`pytest_otmcp.wire.bacnet`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pytest_otmcp.wire.bacnet.services import Asked, Confirmed, Reference, Rejected, Write
from pytest_otmcp.wire.bacnet.values import Value, context, enclosed, encode

from .names import ObjectType, Refusal
from .objects import element_of
from .plant import DEVICE, MAX_APDU, NO_SEGMENTATION, VENDOR, Plant

__all__ = ["Answer", "FailedWriteError", "execute", "i_am", "i_have", "is_for", "object_asked_for", "read_answer"]

_WILDCARD = 4194303


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
    """What the device answers: the data of a complex acknowledgement, or None for a simple one; and the values of one property."""

    data: bytes | None
    values: Sequence[Value] = ()


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
    return Answer(data=_named(one) + enclosed(3, b"".join(map(encode, values))), values=values)


def _multiple_answer(plant: Plant, reads: Sequence[Reference], named: int | None) -> Answer:
    data, at = b"", 0
    while at < len(reads):
        first = reads[at]
        block = b""
        while at < len(reads) and (reads[at].kind, reads[at].instance) == (first.kind, first.instance):
            asked = reads[at]
            at += 1
            for one in _meant(plant, asked):
                block += _result(plant, one)
        told = first if named is None else first.at(named)
        data += context(0, "object-identifier", [told.kind, told.instance]) + enclosed(1, block)
    return Answer(data=data)


def _meant(plant: Plant, asked: Reference) -> list[Reference]:
    try:
        numbers = plant.named(asked.kind, asked.instance, asked.number)
    except Refusal:
        numbers = [asked.number]
    return [Reference(kind=asked.kind, instance=asked.instance, number=one, index=asked.index) for one in numbers]


def _result(plant: Plant, one: Reference) -> bytes:
    head = context(2, "enumerated", one.number)
    if one.index is not None:
        head += context(3, "unsigned", one.index)
    try:
        values = element_of(plant.content(one.kind, one.instance, one.number), one.index)
    except Refusal as refusal:
        codes = b"".join(encode(Value(kind="enumerated", value=code)) for code in refusal.error)
        return head + enclosed(5, codes)
    return head + enclosed(4, b"".join(map(encode, values)))


# -- finding devices and objects --------------------------------------------------------------------------------


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


def object_asked_for(plant: Plant, asked: Mapping[str, Any]) -> tuple[tuple[int, int], str] | None:
    """Return the identifier and name of the object that a Who-Has asks for, if this device is asked and has it."""
    wanted = asked.get("name"), tuple(asked.get("object", ()))
    found = ((one, name) for name, one in plant.names().items() if name == wanted[0] or one == wanted[1])
    return next(found, None) if is_for(asked) else None


def i_have(identifier: tuple[int, int], name: str) -> bytes:
    """Return the APDU of an I-Have."""
    values = [
        Value(kind="object-identifier", value=[int(ObjectType.DEVICE), DEVICE]),
        Value(kind="object-identifier", value=list(identifier)),
        Value(kind="character-string", value=name),
    ]
    return b"\x10\x01" + b"".join(map(encode, values))
