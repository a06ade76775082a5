"""The tags of the controller, and the dynamics of the plant behind it.

==========================  =====================================================================================
plant's                     MotorSpeed, Temperature, TankLevel REAL, AlarmHigh BOOL; Program:MainProgram.MotorSpeed REAL
clients'                    ValvePosition 50, HeaterPower 30, FanSpeed 40, ConveyorSpeed 60, BatchTarget 7 DINT, PumpEnabled BOOL,
                            Levels REAL[10], Counts INT[64], Flags DINT, Message STRING, Recipe (Name STRING, Rate REAL,
                            Count DINT, Enabled BOOL); Program:MainProgram.Tank_Levels REAL[3], .Step DINT
by external access          Locked DINT (read only), Hidden DINT (none: in no list)
of every type               FreeBool, FreeSint, …, FreeLreal, FreeString: nothing else uses them
==========================  =====================================================================================

The plant moves its own tags and no other. It is deterministic: the same ticks and writes give the same values. Speeds are in
revolutions per minute, temperatures in degrees Celsius, positions, powers and levels in percent.
"""

from __future__ import annotations

import math
import time
from datetime import UTC, datetime
from typing import Any

from pytest_otmcp.wire.ethernetip.cip import SYMBOL
from pytest_otmcp.wire.ethernetip.messages import BAD_PATH, Path, Refusal

from .tags import NO_SUCH_PLACE, Place, Tag, located, shown, store, walk
from .types import ELEMENTARY, RECIPE, STRING, Elementary, Structure

__all__ = ["PROGRAM", "STRUCTURES", "Plant"]

PROGRAM = "MainProgram"
STRUCTURES: dict[int, Structure] = {one.template: one for one in (STRING, RECIPE)}
"""Structures by the instance of their template."""

_SCOPE = "Program:"
_AMBIENT = 20.0
_ALARM_LIMIT = 90.0

_TAGS: tuple[tuple[str, str, int, Any], ...] = (
    ("MotorSpeed", "REAL", 0, 1450.0),
    ("Temperature", "REAL", 0, 25.0),
    ("TankLevel", "REAL", 0, 40.0),
    ("AlarmHigh", "BOOL", 0, False),
    ("ValvePosition", "DINT", 0, 50),
    ("HeaterPower", "DINT", 0, 30),
    ("FanSpeed", "DINT", 0, 40),
    ("ConveyorSpeed", "DINT", 0, 60),
    ("BatchTarget", "DINT", 0, 7),
    ("PumpEnabled", "BOOL", 0, True),
    ("Levels", "REAL", 10, None),
    ("Counts", "INT", 64, None),
    ("Flags", "DINT", 0, 0),
    ("Message", "STRING", 0, "ready"),
    ("Recipe", "Recipe", 0, None),
    ("Locked", "DINT", 0, 4711),
    ("Hidden", "DINT", 0, 13),
    *((f"Free{name.capitalize()}", name, 0, None) for name in (*ELEMENTARY, "STRING")),
)
_PROGRAM_TAGS: tuple[tuple[str, str, int, Any], ...] = (
    ("MotorSpeed", "REAL", 0, 1450.0),
    ("Tank_Levels", "REAL", 3, None),
    ("Step", "DINT", 0, 0),
)
_ACCESS = {"Locked": "read_only", "Hidden": "none"}


def _tags(rows: tuple[tuple[str, str, int, Any], ...], first: int, program: str | None) -> list[Tag]:
    kinds: dict[str, Elementary | Structure] = {**ELEMENTARY, "STRING": STRING, "Recipe": RECIPE}
    found = []
    # Instances have gaps, as in a controller whose program has been edited.
    for number, (name, kind, dimension, value) in enumerate(rows):
        tag = Tag(
            name=name,
            instance=first + 3 * number,
            kind=kinds[kind],
            dimension=dimension,
            access=_ACCESS.get(name, "read_write"),
            program=program,
        )
        if value is not None:
            store(tag.whole(), value)
        found.append(tag)
    return found


class Plant:
    """The tags and the settings of one controller.

    Attributes:
        tags: in the order of their instances; those of the controller before those of the program.
        program_instance: instance of the symbol that stands for the program.
        connection_limit: number of CIP connections that can be open at a time.
        clock_set: the time that a client has set last; None before.
    """

    def __init__(self) -> None:
        self.tags = [*_tags(_TAGS, 0x101, None), *_tags(_PROGRAM_TAGS, 0x11, PROGRAM)]
        self.program_instance = 0x81
        self.connection_limit = 32
        self.clock_set: datetime | None = None
        self._clock_ahead_us = 0
        self._seconds = 0
        for index in range(10):
            self.set(f"Levels[{index}]", 10.0 + 2.5 * index)
        for index in range(3):
            self.set(f"Program:{PROGRAM}.Tank_Levels[{index}]", 30.0 + index)
        self.set("Recipe.Name", "base")
        self.set("Recipe.Rate", 12.5)
        self.set("Recipe.Count", 3)

    def create(self, name: str) -> None:
        """Add a tag of the controller, a DINT."""
        instance = 3 + max(tag.instance for tag in self.tags)
        self.tags.append(Tag(name=name, instance=instance, kind=ELEMENTARY["DINT"]))

    def image(self) -> dict[str, Any]:
        """Return ``points``: each value by its name, and ``Clock``, the time that was set last; ``symbols``: the names of the
        controller's tags by their instances; and the settings."""
        points = {name: shown(place) for tag in self.tags for name, place in walk(tag.whole(), tag.label)}
        points["Clock"] = None if self.clock_set is None else self.clock_set.isoformat()
        return {
            "points": points,
            "symbols": {str(tag.instance): tag.name for tag in self.tags if tag.program is None},
            "external_access": {tag.label: tag.access for tag in self.tags if tag.access != "read_write"},
            "connection_limit": self.connection_limit,
        }

    def listed(self, program: str | None) -> list[Tag]:
        """Return the tags of a scope that clients may know of."""
        return [tag for tag in self.tags if tag.program == program and tag.access != "none"]

    def find(self, path: Path) -> Place:
        """Return the place that a path names, by symbol or by instance.

        Raises:
            Refusal: there is none, or clients may not know of it.
        """
        steps = list(path.names if path.class_id == SYMBOL else path.steps)
        program = None
        if steps and isinstance(steps[0], str) and steps[0].lower().startswith(_SCOPE.lower()):
            program = self.program(steps.pop(0))
        if path.class_id == SYMBOL:
            tag = next((one for one in self.listed(program) if one.instance == path.instance), None)
            if tag is None or steps:
                raise Refusal(NO_SUCH_PLACE, 0)
            return located(tag, path.steps)
        name = steps.pop(0) if steps else None
        if path.class_id is not None or not isinstance(name, str):
            raise Refusal(NO_SUCH_PLACE, 0)
        tag = next((one for one in self.listed(program) if one.name.lower() == name.lower()), None)
        if tag is None:
            raise Refusal(BAD_PATH, 0)
        return located(tag, steps)

    @staticmethod
    def program(name: object) -> str:
        """Return the program that a symbolic segment names.

        Raises:
            Refusal: there is none of this name.
        """
        if str(name).lower() != f"{_SCOPE}{PROGRAM}".lower():
            raise Refusal(BAD_PATH, 0)
        return PROGRAM

    def place(self, name: str) -> Place | None:
        """Return the place of a value by its name in the image; None if there is none."""
        for tag in self.tags:
            if name == tag.label or name.startswith((f"{tag.label}[", f"{tag.label}.")):
                return dict(walk(tag.whole(), tag.label)).get(name)
        return None

    def set(self, name: str, value: Any) -> None:
        """Set a value by its name in the image."""
        place = self.place(name)
        assert place is not None
        store(place, value)

    def value(self, name: str) -> Any:
        """Return a value by its name in the image."""
        place = self.place(name)
        assert place is not None
        return shown(place)

    def clock(self) -> int:
        """Return the time of the controller, in microseconds since 1970, UTC."""
        return time.time_ns() // 1000 + self._clock_ahead_us

    def set_clock(self, microseconds: int) -> None:
        """Set the time of the controller, in microseconds since 1970, UTC.

        Raises:
            ValueError: a calendar has no such time.
        """
        try:
            self.clock_set = datetime.fromtimestamp(microseconds / 1_000_000, UTC)
        except (OverflowError, OSError):
            raise ValueError from None
        self._clock_ahead_us = microseconds - time.time_ns() // 1000

    def tick(self) -> None:
        """Advance by one second: temperature (heater, fan), level (valve, pump), motor (conveyor)."""
        self._seconds += 1
        valve, heater, fan, conveyor = (
            min(max(self.value(name), 0), 100) for name in ("ValvePosition", "HeaterPower", "FanSpeed", "ConveyorSpeed")
        )
        temperature = _number(self.value("Temperature"), _AMBIENT)
        temperature += (_AMBIENT + heater * 0.8 - fan * 0.1 - temperature) * 0.05
        inflow = valve / 100 if self.value("PumpEnabled") else 0.0
        level = _number(self.value("TankLevel"), 0.0) + inflow - 0.4
        motor = 1450.0 * conveyor / 60 + math.sin(self._seconds / 10)
        self.set("Temperature", temperature)
        self.set("TankLevel", min(max(level, 0.0), 100.0))
        self.set("AlarmHigh", temperature > _ALARM_LIMIT)
        self.set("MotorSpeed", motor)
        self.set(f"Program:{PROGRAM}.MotorSpeed", motor)


def _number(value: Any, otherwise: float) -> float:
    """Return a value that a poke may have made no number."""
    return value if isinstance(value, float) and abs(value) < 1e6 else otherwise
