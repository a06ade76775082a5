"""What the outstation holds: its points, the events that wait for a master, and the dynamics of the plant behind them.

=================  ===========================================================================================================
binary_input       0 to 15, alternating; 3 and 4 make events of class 1
analog_input       0 to 6 whole numbers, 6 without its flag ONLINE; 7 a double. 0 makes events of class 2, of which the newest is kept
counter            0 and 1
binary_output      0 to 4 latches; 5 is switched at the place; 6 takes pulses; 7 takes trip and close
analog_output      0 and 1 floats; 2 a float from 0 to 100; 3 a whole number
octet_string       0, a text
=================  ===========================================================================================================

The plant moves the analog input 0 and the counter 0; everything else belongs to the clients. It is deterministic: the same ticks and
writes give the same values.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from pytest_otmcp.wire.dnp3.objects import as_json

from .points import ONLINE, Point, converted, fits, flag_names

__all__ = ["HIGHEST", "LIMITED", "LOCAL", "PULSED", "TRIP_CLOSE", "Event", "Plant", "checked"]

LOCAL, PULSED, TRIP_CLOSE = 5, 6, 7
"""Binary outputs with a manner of their own."""
LIMITED, HIGHEST = 2, 100.0
"""The analog output that has limits, and the upper one; the lower one is 0."""

_COMM_LOST = 0x04
_MOST_EVENTS = 100
_TIME_MASK = (1 << 48) - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """A change that waits for a master.

    Attributes:
        time_ms: when, in milliseconds since 1970.
    """

    point: Point
    value: Any
    flags: int
    time_ms: int


def _points() -> Iterable[Point]:
    for index in range(16):
        classes = {3: 1, 4: 1}
        yield Point(
            type="binary_input", index=index, kind="bool", value=index % 2 == 0, event_class=classes.get(index, 0)
        )
    for index, value in enumerate((100, -20, 300, 40, -5000, 60, 7)):
        point = Point(type="analog_input", index=index, kind="int32", value=value, event_class=2 if index == 0 else 0)
        point.flags = _COMM_LOST if index == 6 else ONLINE
        yield point
    yield Point(type="analog_input", index=7, kind="double", value=1.5)
    for index in range(2):
        yield Point(type="counter", index=index, kind="uint32", value=1000 * index)
    for index in range(8):
        yield Point(type="binary_output", index=index, kind="bool", value=False)
    for index, setpoint in enumerate((50.0, 20.0, 10.0)):
        yield Point(type="analog_output", index=index, kind="float", value=setpoint)
    yield Point(type="analog_output", index=3, kind="int32", value=5)
    yield Point(type="octet_string", index=0, kind="octets", value=b"ready")


class Plant:
    """The points and the state of the outstation.

    Attributes:
        points: by name, such as ``analog_input/1``.
        events: that no master has confirmed, the oldest first.
        overflowed: events were lost because nobody fetched them (IIN2.3).
        restarted: the outstation has restarted since a master said that it knows (IIN1.7).
        needs_time: it wants a master to set its clock (IIN1.4).
        local: somebody has switched it to local control: no output can be operated (IIN1.5).
        trouble: it is not well (IIN1.6).
        pulses: how many pulses the output for pulses has given.
        select_timeout_s: for how long a selection holds.
    """

    def __init__(self) -> None:
        self.points = {point.name: point for point in _points()}
        self.events: list[Event] = []
        self.overflowed = False
        self.restarted = True
        self.needs_time = False
        self.local = False
        self.trouble = False
        self.pulses = 0
        self.select_timeout_s = 5.0
        self._seconds = 0

    def of(self, group: int) -> Sequence[Point]:
        """Return the points with static objects of a group, by their indexes."""
        return [point for point in self.points.values() if point.group == group]

    def image(self) -> dict[str, Any]:
        """Return ``points`` and ``flags`` of each, how many ``events`` wait in each class, and the state."""
        points = {
            name: point.value.decode("utf-8", "backslashreplace") if point.kind == "octets" else as_json(point.value)
            for name, point in self.points.items()
        }
        return {
            "points": {**points, f"binary_output/{PULSED}/pulses": self.pulses},
            "flags": {name: flag_names(point.flags) for name, point in self.points.items()},
            "events": {str(number): len(self.waiting({number})) for number in (1, 2, 3)},
            "restarted": self.restarted,
            "needs_time": self.needs_time,
            "local": self.local,
            "trouble": self.trouble,
            "select_timeout_s": self.select_timeout_s,
        }

    def waiting(self, classes: set[int]) -> list[Event]:
        """Return the events of these classes that no master has confirmed."""
        return [event for event in self.events if event.point.event_class in classes]

    def hold(self, point: Point, value: Any, time_ms: int) -> None:
        """Set the value of a point; where that has a class, its event waits from now on."""
        if point.kind == "float":
            value, _ = converted(float(value), "f", 0)
            (value,) = struct.unpack("<f", struct.pack("<f", value))
        elif point.kind == "double":
            value = float(value)
        point.value = value
        if not point.event_class:
            return
        if point.type == "analog_input":
            self.events = [event for event in self.events if event.point is not point]
        self.events.append(Event(point=point, value=value, flags=point.flags, time_ms=time_ms & _TIME_MASK))
        if len(self.events) > _MOST_EVENTS:
            del self.events[0]
            self.overflowed = True

    def confirmed(self, events: Sequence[Event]) -> None:
        """Forget events that a master has got."""
        self.events = [event for event in self.events if all(event is not one for one in events)]
        self.overflowed = self.overflowed and len(self.events) >= _MOST_EVENTS

    def tick(self, time_ms: int) -> None:
        """Advance by one second: the analog input 0 swings around the analog output 0 and the counter 0 counts."""
        self._seconds += 1
        setpoint = self.points["analog_output/0"].value
        around = min(max(setpoint, -1e6), 1e6) if math.isfinite(setpoint) else 0.0
        self.hold(self.points["analog_input/0"], round(2 * around + 10 * math.sin(self._seconds / 10)), time_ms)
        counter = self.points["counter/0"]
        counter.value = (counter.value + 1) % 2**32


def checked(point: Point, value: Any) -> Any:
    """Return a value as a point holds it, from the form that a poke has.

    Raises:
        ValueError: the point cannot hold it.
    """
    if point.kind == "octets" and isinstance(value, str):
        value = value.encode("utf-8", "surrogatepass")
    elif point.kind in ("float", "double") and value in ("NaN", "Infinity", "-Infinity"):
        value = float(value)
    if not fits(point.kind, value):
        raise ValueError(f"{point.name} holds values of the kind {point.kind}, not {value!r}")
    return value
