"""Points of answers: the objects of a response as values with flags and time. It handles bytes, no connection.

dnp3py finds the boundaries of the objects and knows their layouts; it decodes values only on their way to a handler, where the object
that they came from, a time that is relative to another object, and packed bits beyond the first octet are hard to tell.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from dnp3.application.fragment import ObjectBlock
from dnp3.application.qualifiers import RangeCode
from dnp3.objects.base import DNP3Object
from dnp3.objects.layout import PointKind, TimeKind, ValueCodec, WireLayout, layout_for
from dnp3.objects.registry import register

from ..core import BadReply, special_name

__all__ = ["Point", "flag_names", "points_of", "range_request"]

_STARTS = {RangeCode.UINT8_START_STOP: 1, RangeCode.UINT16_START_STOP: 2, RangeCode.UINT32_START_STOP: 4}
_COUNTS = {RangeCode.UINT8_COUNT: 1, RangeCode.UINT16_COUNT: 2, RangeCode.UINT32_COUNT: 4}
_PREFIXES = {1: 1, 2: 2, 3: 4}
_COMMON_TIMES = 51
_EVENTS = frozenset({2, 4, 11, 13, 22, 23, 32, 33, 42, 43, 111})
_DOUBLE_BITS = ("INTERMEDIATE", "OFF", "ON", "INDETERMINATE")
_FLAGS = ("ONLINE", "RESTART", "COMM_LOST", "REMOTE_FORCED", "LOCAL_FORCED")
_ANALOG = ("OVER_RANGE", "REFERENCE_ERR")
_COUNTER = ("ROLLOVER", "DISCONTINUITY")
_FURTHER_FLAGS = {
    PointKind.BINARY_INPUT: ("CHATTER_FILTER",),
    PointKind.DOUBLE_BIT_INPUT: ("CHATTER_FILTER",),
    PointKind.COUNTER: _COUNTER,
    PointKind.FROZEN_COUNTER: _COUNTER,
    PointKind.ANALOG_INPUT: _ANALOG,
    PointKind.FROZEN_ANALOG_INPUT: _ANALOG,
    PointKind.ANALOG_OUTPUT: _ANALOG,
}
_UNRELIABLE = frozenset({"RESTART", "COMM_LOST", *_ANALOG})
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@register
class TimeAndInterval(DNP3Object):
    """A time with an interval (g50v4), which opendnp3 has among its class 0 data and dnp3py does not know (0.6.0): the objects behind it
    could not be found. It is no point, so nothing is read from it."""

    GROUP, VARIATION, SIZE = 50, 4, 11


PlainValue = bool | int | float | str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A point as an object of a response tells it.

    Attributes:
        kind: of point: ``binary_input``, ``analog_input``, ….
        group: of the object.
        value: None for a number that JSON does not have, which ``special`` names then.
        special: NaN, Infinity or -Infinity.
        flags: names of the flags that are set; None where the object has none.
        time: of the outstation's clock; None where the object has none.
        content: bytes of the value.
    """

    kind: str
    group: int
    index: int
    value: PlainValue
    special: str | None
    flags: tuple[str, ...] | None
    time: datetime | None
    content: bytes

    @property
    def is_event(self) -> bool:
        """Whether the object tells a change, which the outstation forgets when it is confirmed."""
        return self.group in _EVENTS

    @property
    def is_reliable(self) -> bool:
        """Whether the outstation vouches for the value: the point is on line, and no flag says otherwise."""
        return self.flags is None or ("ONLINE" in self.flags and not _UNRELIABLE & set(self.flags))


def flag_names(kind: PointKind, flags: int) -> tuple[str, ...]:
    """Return the names of the flags that are set (IEEE 1815, clause 11.6); the state, which is among them for binary points, is none."""
    names = _FLAGS + _FURTHER_FLAGS.get(kind, ())
    return tuple(name for bit, name in enumerate(names) if flags >> bit & 1)


def range_request(group: int, variation: int, start: int, stop: int) -> bytes:
    """Return the object header that asks for the points from ``start`` to ``stop``, both included."""
    short = stop <= 0xFF
    return bytes([group, variation, not short]) + struct.pack("<BB" if short else "<HH", start, stop)


def points_of(blocks: Sequence[ObjectBlock]) -> list[Point]:
    """Return the points of a response, in its order.

    Raises:
        BadReply: there is something that cannot be read.
    """
    found: list[Point] = []
    common: datetime | None = None
    for block in blocks:
        group, variation = block.header.group, block.header.variation
        layout = layout_for(group, variation)
        if (group, variation) == (TimeAndInterval.GROUP, TimeAndInterval.VARIATION):
            continue
        if layout is None:
            raise BadReply(f"it holds objects of group {group}, variation {variation}, which are not known")
        for index, content in _objects(block, layout):
            if group == _COMMON_TIMES:
                common = _moment(int.from_bytes(content, "little"))
            else:
                found.append(_point(group, layout, index, content, common))
    return found


def _objects(block: ObjectBlock, layout: WireLayout) -> Iterator[tuple[int, bytes]]:
    """Yield the index and the bytes of each object; of a packed one a byte with its bits alone."""
    code, data = block.header.range_code, block.data
    if code in _STARTS:
        size = _STARTS[code]
        first = int.from_bytes(data[:size], "little")
        count, data, prefix = int.from_bytes(data[size : 2 * size], "little") - first + 1, data[2 * size :], 0
    elif code in _COUNTS:
        size = _COUNTS[code]
        first, count, data = 0, int.from_bytes(data[:size], "little"), data[size:]
        prefix = _PREFIXES.get(block.header.prefix_code, 0)
        if not prefix and block.header.group != _COMMON_TIMES:
            raise BadReply("it holds objects without an index")
    else:
        if data:
            raise BadReply("it holds objects without a range")
        return
    if layout.is_packed:
        bits = int.from_bytes(data, "little")
        mask = (1 << layout.bits_per_point) - 1
        for number in range(count):
            yield first + number, bytes([bits >> number * layout.bits_per_point & mask])
        return
    width = prefix + layout.width
    for number in range(count):
        one = data[number * width : (number + 1) * width]
        yield int.from_bytes(one[:prefix], "little") if prefix else first + number, one[prefix:]


def _point(group: int, layout: WireLayout, index: int, content: bytes, common: datetime | None) -> Point:
    kind = layout.point_kind
    flags = flag_names(kind, content[0]) if layout.has_flags else None
    start, end = int(layout.has_flags), len(content) - layout.time.octets
    value, special = _value(kind, layout.codec, content[0] if layout.has_flags else 0, content[start:end])
    time = None
    if layout.time is TimeKind.ABSOLUTE:
        time = _moment(int.from_bytes(content[end:], "little"))
    elif layout.time is TimeKind.RELATIVE and common is not None:
        time = common + timedelta(milliseconds=int.from_bytes(content[end:], "little"))
    return Point(
        kind=kind.value,
        group=group,
        index=index,
        value=value,
        special=special,
        flags=flags,
        time=time,
        content=content[start:end],
    )


def _value(kind: PointKind, codec: ValueCodec, flags: int, content: bytes) -> tuple[PlainValue, str | None]:
    if codec is ValueCodec.PACKED or codec is ValueCodec.FLAG_STATE:
        if kind is PointKind.DOUBLE_BIT_INPUT:
            return _DOUBLE_BITS[content[0] if codec is ValueCodec.PACKED else flags >> 6], None
        return bool(content[0] if codec is ValueCodec.PACKED else flags >> 7), None
    if codec is ValueCodec.INT or codec is ValueCodec.UINT:
        return int.from_bytes(content, "little", signed=codec is ValueCodec.INT), None
    if codec is ValueCodec.FLOAT32 or codec is ValueCodec.FLOAT64:
        (number,) = struct.unpack("<f" if codec is ValueCodec.FLOAT32 else "<d", content)
        special = special_name(number)
        return (number, None) if special is None else (None, special)
    # What an event has to say of a command, or an octet string: nobody but its reader knows what it means.
    return content.hex(), None


def _moment(milliseconds: int) -> datetime | None:
    """Return a DNP3 time; None for one beyond the years that there are dates for."""
    try:
        return _EPOCH + timedelta(milliseconds=milliseconds)
    except OverflowError:
        return None
