"""What the kit may do at a real device of a protocol, and how it knows what such a device holds. Pure.

A mock is set and asked past the protocol. A real device is only read: once through the adapter, where the kit's tap sees the request, and
once by a second client of the kit's own, straight at the device. What would change it reaches it only as a :class:`Consent` allows.
"""

from __future__ import annotations

import datetime
import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.finding import Finding
from ..core.strict_json import same_json
from .exercise import LARGEST_FLOAT32, Asked
from .journal import Entries, Image

__all__ = ["Consent", "Field", "Writable", "agrees"]

_TARGET = re.compile(r"(.+/)(\d{1,9})(?:\.\.(\d{1,9}))?")
_NODE = re.compile(r"(?:ns=[1-9]\d*;)?(?:i=(?:0|[1-9]\d*)|s=.+)")
"""A node of OPC UA, as the kit writes it, is a point by itself."""
_MOST = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class Writable:
    """Points that may be written, and the numbers that may be written there; of a bit 0 and 1."""

    target: str
    lowest: float
    highest: float

    @property
    def points(self) -> tuple[str, ...]:
        """The points in the order of their numbers.

        Raises:
            ValueError: the target names none, or more than 256; one sentence.
        """
        if _NODE.fullmatch(self.target):
            return (self.target,)
        found = _TARGET.fullmatch(self.target)
        first, last = (int(found[2]), int(found[3] or found[2])) if found else (1, 0)
        if found is None or not 0 <= last - first < _MOST:
            raise ValueError(
                f"{self.target!r} names no points: expected a name that ends in a number, or in two such as 100..103, of at most {_MOST}, "
                "or a node such as ns=2;s=Name"
            )
        return tuple(f"{found[1]}{number}" for number in range(first, last + 1))

    def takes(self, value: object) -> bool:
        """Tell whether a value may be written."""
        return isinstance(value, int | float) and self.lowest <= value <= self.highest


@dataclass(frozen=True, slots=True, kw_only=True)
class Consent:
    """What a person allows to be written to one device, until the end of a day.

    Attributes:
        device: its URL.
        identity: what the device says of itself; None where it says nothing.
        name: of the person.
        date, expires: the first and the last day.
        writable: what may be written.
        stop, start: the words of the commands that take the device's power and give it back; none where it is not cut off.
    """

    device: str
    identity: str | None
    name: str
    date: datetime.date
    expires: datetime.date
    writable: tuple[Writable, ...]
    stop: tuple[str, ...] = ()
    start: tuple[str, ...] = ()

    def allows(self, written: Mapping[str, object]) -> bool:
        """Tell whether all of these points may get these values; a request that names none is not allowed."""
        return bool(written) and all(
            any(point in one.points and one.takes(value) for one in self.writable) for point, value in written.items()
        )

    def as_record(self) -> dict[str, Any]:
        """Return this as a run record has it."""
        return {
            "name": self.name,
            "date": self.date.isoformat(),
            "expires": self.expires.isoformat(),
            "writable": [{"target": one.target, "lowest": one.lowest, "highest": one.highest} for one in self.writable],
            **({"outage": True} if self.stop else {}),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """How a real device of a protocol is read, guarded and judged.

    An image of such a device has its ``points`` as the second client reads them; what can be asked ``beyond`` them, or None; and the
    ``writable`` points with their lowest and highest value.

    Attributes:
        harmless: tells of a whole frame to the device whether it can change nothing whatever the device makes of it. A frame that is
            not known to be so is not: what cannot be read changes something.
        reads: makes calls that read points of an image, by the operations that a subject claims; first those of one point each, which hold
            values that differ.
        beyond: makes the call for what is not there, as the device has told the second client; None where there is none.
        was_read: expects that the device was asked for what a call reads, and answered.
        sent: returns the values that the device sent, in order.
        written: returns the points that a frame writes, with their values; None of a frame that no consent can allow. This and the next
            two are left out where nothing may be written.
        write: makes the call that writes a value to a point; None where no operation does.
        was_written: expects that one request that changes the plant was seen: what a call writes.
        unseen: says of a frame that may not pass, in a clause, why nobody can see what it asks for; None where it can be seen.
        unanswered: says of a frame that may not pass, in a clause, why an honest adapter may get no further without an answer to it; None
            where it has no business to send it.
        led: returns a frame of the device with ``host:port`` of the tap in the place of the addresses by which it tells clients where
            it is, and None for one where it cannot take their place; None where devices tell none.
    """

    harmless: Callable[[bytes], bool]
    reads: Callable[[Image, Callable[[str], bool]], Sequence[Asked]]
    beyond: Callable[[Image, Callable[[str], bool]], Asked | None]
    was_read: Callable[[Entries, Asked], list[Finding]]
    sent: Callable[[Entries], Sequence[object]]
    written: Callable[[bytes], Mapping[str, object] | None] = lambda frame: None
    write: Callable[[str, object], Asked | None] = lambda point, value: None
    was_written: Callable[[Entries, Asked], list[Finding]] = lambda entries, asked: []
    unseen: Callable[[bytes], str | None] = lambda frame: None
    unanswered: Callable[[bytes], str | None] = lambda frame: None
    led: Callable[[bytes, str], bytes | None] | None = None


def agrees(value: object, told: object) -> bool:
    """Tell whether an adapter tells a value that the second client has read, or a list of such values.

    A number of 32 bits may be told with as many digits as tell it apart from its neighbours: 1.1 is 1.100000023841858.
    """
    if isinstance(value, list) and isinstance(told, list):
        return len(value) == len(told) and all(map(agrees, value, told))
    if isinstance(value, float) and isinstance(told, float) and math.isfinite(value) and abs(told) <= LARGEST_FLOAT32:
        return value in (told, struct.unpack("<f", struct.pack("<f", told))[0])
    return same_json(value, told)
